// Settings files, as `polepair config` writes and reads them.

export interface Settings {
  /** By name: a number in the parameter's unit, or text with a unit, or a word. */
  values: Record<string, number | string>;
  /** Lines that this page cannot take over: they are for `polepair config apply`. */
  left: string[];
}

export interface Kept {
  name: string;
  value: number;
  unit: string;
  word: string | null;
  symbol: string;
}

const SECTION = /^\[\s*axis\.(?:"([^"]+)"|([\w.-]+?))(\.settings)?\s*\]$/;
const LINE = /^(?:"([^"]+)"|([\w-]+))\s*=\s*(.+?)\s*(?:#.*)?$/;

/** The settings of axis `number`, or of the only axis that the file has. Null where there are none. */
export function parse(text: string, number: number): Settings | null {
  const axes = new Map<string, Settings>();
  let current: Settings | null = null;
  for (const raw of text.split(/\r?\n/)) {
    const line = raw.trim();
    const section = SECTION.exec(line);
    if (line.startsWith("[")) {
      current = section?.[3] ? { values: {}, left: [] } : null;
      if (current && section) axes.set(section[1] ?? section[2] ?? "", current);
    } else if (current && line && !line.startsWith("#")) {
      setting(line, current);
    }
  }
  const [only] = axes.size === 1 ? axes.values() : [];
  return axes.get(String(number)) ?? only ?? null;
}

/** A file of what was read, sorted by name. */
export function format(number: number, profile: string, kept: Kept[]): string {
  const lines = [...kept]
    .sort((a, b) => (a.name < b.name ? -1 : 1))
    .map((each) => `${JSON.stringify(each.name)} = ${written(each)}   # ${each.symbol}`);
  const head = [`[axis.${number}]`, `profile = ${JSON.stringify(profile)}`, ""];
  return [...head, `[axis.${number}.settings]`, ...lines, ""].join("\n");
}

function setting(line: string, into: Settings): void {
  const [, quoted, bare, value = ""] = LINE.exec(line) ?? [];
  const name = quoted ?? bare;
  const text = /^"((?:[^"\\]|\\.)*)"$/.exec(value);
  const number = Number(value.replaceAll("_", ""));
  if (name && text) into.values[name] = text[1] ?? "";
  else if (name && value && Number.isFinite(number)) into.values[name] = number;
  else into.left.push(line);
}

function written(each: Kept): string {
  if (each.word !== null) return JSON.stringify(each.word);
  return each.unit ? JSON.stringify(`${each.value} ${each.unit}`) : String(each.value);
}
