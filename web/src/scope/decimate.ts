// From samples to columns of pixels. Each column keeps its first, least, greatest and last value, so
// the picture is the same as if every sample were drawn: no spike is lost, however far out one zooms.

import type { Trace } from "./trace";

/** Columns of one channel; `count` of each array are used. */
export class Columns {
  count = 0;
  readonly time: Float64Array;
  readonly first: Float64Array;
  readonly min: Float64Array;
  readonly max: Float64Array;
  readonly last: Float64Array;
  /** 1 where the line from the column before must not be drawn: samples are missing between them. */
  readonly broken: Uint8Array;

  constructor(readonly room: number) {
    this.time = new Float64Array(room);
    this.first = new Float64Array(room);
    this.min = new Float64Array(room);
    this.max = new Float64Array(room);
    this.last = new Float64Array(room);
    this.broken = new Uint8Array(room);
  }
}

/**
 * Fills `out` with what is to be drawn between two times in seconds, a sample beyond either edge among
 * it. Columns begin at multiples of their width, so a curve that scrolls does not flicker. A line is
 * broken where the server reported a gap, and where two samples are more than `period_max` apart.
 */
export function decimate(
  trace: Trace,
  from: number,
  to: number,
  out: Columns,
  period_max: number,
): void {
  out.count = 0;
  const begin = Math.max(trace.seek(from) - 1, trace.first);
  const end = Math.min(trace.seek(to) + 1, trace.end);
  if (begin >= end || !(to > from)) return;
  const single = end - begin <= out.room;
  const width = (to - from) / (out.room - 4);
  const range = { min: 0, max: 0 };
  let gap = firstGap(trace, trace.time(begin));
  for (let i = begin, last = Number.NaN; i < end && out.count < out.room;) {
    const time = trace.time(i);
    let next = i + 1;
    let closed = Number.POSITIVE_INFINITY;
    if (!single) {
      closed = (Math.floor(time / width) + 1) * width;
      next = gallop(trace, i, end, closed);
    }
    trace.range(i, next, range);
    while (gap < trace.gaps.length && (trace.gaps[gap]?.to ?? 0) <= last) gap++;
    const at = trace.gaps[gap];
    const k = out.count++;
    out.time[k] = time;
    out.first[k] = trace.value(i);
    out.min[k] = range.min;
    out.max[k] = range.max;
    out.last[k] = trace.value(next - 1);
    const silent = time - last > period_max;
    const told = at !== undefined && at.from < time && at.to > last;
    out.broken[k] = k > 0 && (silent || told) ? 1 : 0;
    last = trace.time(next - 1);
    i = next;
  }
}

/** The first index behind `from` whose time is not before `closed`: near in most cases. */
function gallop(trace: Trace, from: number, end: number, closed: number): number {
  let step = 1;
  let low = from;
  while (low + step < end && trace.time(low + step) < closed) {
    low += step;
    step *= 2;
  }
  let high = Math.min(low + step, end);
  low++;
  while (low < high) {
    const middle = Math.floor((low + high) / 2);
    if (trace.time(middle) < closed) low = middle + 1;
    else high = middle;
  }
  return low;
}

function firstGap(trace: Trace, time: number): number {
  let at = trace.gaps.length;
  while (at > 0 && (trace.gaps[at - 1]?.to ?? 0) > time) at--;
  return at;
}
