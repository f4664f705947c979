// Okabe and Ito's eight colours, which colour-blind people tell apart, darkened or lightened where a
// background would swallow them.

const LIGHT = [
  "#0072b2",
  "#d55e00",
  "#00795a",
  "#b3478a",
  "#a06c00",
  "#2289bd",
  "#5e4fa2",
  "#14202b",
];
const DARK = [
  "#56b4e9",
  "#e69f00",
  "#35c79d",
  "#e79bc6",
  "#f0e442",
  "#ff8458",
  "#a9b4ff",
  "#dfe7ec",
];

/** The colour of a curve; from the ninth on they come again, dashed. */
export function colour(index: number, dark: boolean): string {
  const all = dark ? DARK : LIGHT;
  return all[index % all.length] ?? "";
}

export function dashed(index: number): boolean {
  return index >= LIGHT.length;
}
