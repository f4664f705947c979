/** Flag of an address that names groups; the bits below it are a mask of them. */
const GROUP = 0x8000_0000;

/** The number of an axis as connection strings write it: `5.2` is the second axis of drive 5, `g1+3` are
 * groups 1 and 3, `g*` is everybody. */
export function axisNumber(number: number): string {
  if (number >= GROUP) {
    const groups = Array.from({ length: 31 }, (_, n) => n + 1).filter(
      (n) => (number >>> (n - 1)) & 1,
    );
    return groups.length > 0 ? `g${groups.join("+")}` : "g*";
  }
  const sub = number >> 16;
  return sub > 0 ? `${number & 0xffff}.${sub}` : `${number}`;
}
