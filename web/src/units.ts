// Formats of shown and typed numbers. The wire has SI alone; a technician reads degrees and rpm.

export type System = "shop" | "si";

interface Shown {
  unit: string;
  factor: number;
  /** Added after the factor: degrees Celsius. */
  zero: number;
}

const SHOP: Record<string, Shown> = {
  rad: { unit: "°", factor: 180 / Math.PI, zero: 0 },
  "rad/s": { unit: "rpm", factor: 30 / Math.PI, zero: 0 },
  "rad/s²": { unit: "rpm/s", factor: 30 / Math.PI, zero: 0 },
  "rad/s2": { unit: "rpm/s", factor: 30 / Math.PI, zero: 0 },
  m: { unit: "mm", factor: 1000, zero: 0 },
  "m/s": { unit: "mm/s", factor: 1000, zero: 0 },
  "m/s²": { unit: "mm/s²", factor: 1000, zero: 0 },
  "m/s2": { unit: "mm/s²", factor: 1000, zero: 0 },
};

/** Shown form of a unit of the wire. */
export function shown(unit: string, system: System): Shown {
  const shop = system === "shop" ? SHOP[unit] : undefined;
  return shop ?? { unit: unit.replace(/s2$/, "s²").replace(/^degC$/, "°C"), factor: 1, zero: 0 };
}

export function toShown(value: number, unit: string, system: System): number {
  const { factor, zero } = shown(unit, system);
  return value * factor + zero;
}

export function fromShown(value: number, unit: string, system: System): number {
  const { factor, zero } = shown(unit, system);
  return (value - zero) / factor;
}

/** A number with as many digits as help: five significant ones, none behind 100,000. */
export function digits(value: number): string {
  if (!Number.isFinite(value)) return "—";
  const size = Math.abs(value);
  if (size !== 0 && (size < 0.001 || size >= 1e7)) return value.toExponential(3);
  const behind = size >= 10_000 ? 0 : size >= 1000 ? 1 : size >= 100 ? 2 : 3;
  const text = value.toFixed(behind);
  return Number(text) === 0 ? text.replace("-", "") : text;
}

/** A value with its unit, as the page shows it. */
export function quantity(value: number | null, unit: string, system: System): string {
  if (value === null) return "—";
  const as = shown(unit, system);
  const text = digits(toShown(value, unit, system));
  if (!as.unit) return text.replace(/\.0+$/, "");
  return as.unit === "°" ? `${text}°` : `${text} ${as.unit}`;
}

/** A duration in whole seconds: `12 s`, `3 min 5 s`, `2 h 3 min`. */
export function elapsed(ms: number): string {
  const seconds = Math.max(0, Math.floor(ms / 1000));
  if (seconds < 60) return `${seconds} s`;
  const minutes = Math.floor(seconds / 60);
  if (minutes < 60) return `${minutes} min ${seconds % 60} s`;
  return `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}
