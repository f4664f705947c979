// The picture's samples as a table for spreadsheets.

import type { Trace } from "./trace";

export interface Exported {
  name: string;
  unit: string;
  trace: Trace;
}

/**
 * One line for each moment at which any channel has a sample; a channel that has none then is left
 * empty: nothing is interpolated. Times are seconds since the server's start.
 */
export function csv(channels: Exported[], from: number, to: number): string {
  const head = [
    "time [s]",
    ...channels.map((each) => `${each.name}${each.unit && ` [${each.unit}]`}`),
  ];
  const lines = [head.map(cell).join(",")];
  const at = channels.map((each) => each.trace.seek(from));
  for (;;) {
    let time = Number.POSITIVE_INFINITY;
    channels.forEach(({ trace }, i) => {
      if ((at[i] ?? 0) < trace.end) time = Math.min(time, trace.time(at[i] ?? 0));
    });
    if (!(time <= to)) return `${lines.join("\n")}\n`;
    const values = channels.map(({ trace }, i) => {
      const index = at[i] ?? 0;
      if (index >= trace.end || trace.time(index) !== time) return "";
      at[i] = index + 1;
      return String(trace.value(index));
    });
    lines.push([time.toFixed(6), ...values].join(","));
  }
}

/** Quoted where it must be; names come from drives, so none may begin a formula. */
function cell(text: string): string {
  const safe = /^[=+\-@\t\r]/.test(text) ? `'${text}` : text;
  return /[",\n\r]/.test(safe) ? `"${safe.replaceAll('"', '""')}"` : safe;
}
