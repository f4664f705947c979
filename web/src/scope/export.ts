// The picture's samples as a table: one row for each moment at which any channel has a sample. A channel
// that has none then is left empty: nothing is interpolated. Times are seconds since the server's start.

import type { Trace } from "./trace";

export interface Exported {
  name: string;
  unit: string;
  trace: Trace;
}

/** Gives the rows between two times to `take`, the same array each time, NaN where there is no sample. */
export function rows(
  channels: Exported[],
  from: number,
  to: number,
  take: (time: number, values: Float64Array) => void,
): void {
  const traces = channels.map((each) => each.trace);
  const at = traces.map((trace) => trace.seek(from));
  const values = new Float64Array(traces.length);
  for (;;) {
    let time = Number.POSITIVE_INFINITY;
    traces.forEach((trace, i) => {
      const index = at[i] ?? 0;
      if (index < trace.end) time = Math.min(time, trace.time(index));
    });
    if (!(time <= to)) return;
    traces.forEach((trace, i) => {
      const index = at[i] ?? 0;
      const has = index < trace.end && trace.time(index) === time;
      values[i] = has ? trace.value(index) : Number.NaN;
      if (has) at[i] = index + 1;
    });
    take(time, values);
  }
}

/** The rows as text for spreadsheets. */
export function csv(channels: Exported[], from: number, to: number): string {
  const head = [
    "time [s]",
    ...channels.map((each) => `${each.name}${each.unit && ` [${each.unit}]`}`),
  ];
  const lines = [head.map(cell).join(",")];
  rows(channels, from, to, (time, values) => {
    let line = time.toFixed(6);
    for (const value of values) line += Number.isNaN(value) ? "," : `,${value}`;
    lines.push(line);
  });
  return `${lines.join("\n")}\n`;
}

/** Quoted where it must be; names come from drives, so none may begin a formula. */
function cell(text: string): string {
  const safe = /^[=+\-@\t\r]/.test(text) ? `'${text}` : text;
  return /[",\n\r]/.test(safe) ? `"${safe.replaceAll('"', '""')}"` : safe;
}
