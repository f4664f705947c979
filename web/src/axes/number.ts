/** The number of an axis as connection strings write it: `5.2` is the second axis of drive 5. */
export function axisNumber(number: number): string {
  const sub = number >> 16;
  return sub > 0 ? `${number & 0xffff}.${sub}` : `${number}`;
}
