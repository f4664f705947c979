// A frame's raw text as bytes, and which field each of them belongs to.

import type { ExplainedField } from "../live/message";

export interface Raw {
  /** Text before the bytes: a CAN identifier. */
  id: string;
  bytes: string[];
}

/** `01 04 FF`, `0104FF` or, as on CAN, `30B#0104FF`. */
export function split(raw: string): Raw {
  const hash = raw.lastIndexOf("#");
  const digits = raw.slice(hash + 1).replace(/[^0-9a-fA-F]/g, "");
  return { id: hash < 0 ? "" : raw.slice(0, hash), bytes: digits.match(/../g) ?? [] };
}

/** The index of the field that a byte belongs to, the narrowest of them; -1 where there is none. */
export function fieldAt(fields: readonly ExplainedField[], byte: number): number {
  let best = -1;
  fields.forEach((field, i) => {
    if (byte < field.from || byte >= field.to) return;
    const known = fields[best];
    if (!known || field.to - field.from < known.to - known.from) best = i;
  });
  return best;
}
