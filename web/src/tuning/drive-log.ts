// A recording in the drive as a step response: the drive's own target tells when the step began.

import type { DriveLogView } from "../live/message";
import type { Course } from "./command";

export interface Recorded {
  /** Seconds, the step at 0. */
  times: Float64Array;
  values: Float64Array;
  /** The commanded course, as the drive had it. */
  course: Course;
  from: number;
  to: number;
}

/** The first variable is what was measured, the second its target. `null` where the target never changed. */
export function recorded({ interval_s, variables }: DriveLogView): Recorded | null {
  const [measured, target] = variables.map(({ values }) => values.map((value) => value ?? NaN));
  if (!measured || !target) return null;
  const changed = target.findIndex((value, i) => i > 0 && value !== target[0]);
  if (changed < 0) return null;
  // The point before: the target left its place between the two.
  const start = changed - 1;
  const at = (i: number): number => (i - start) * interval_s;
  return {
    times: Float64Array.from(measured, (_, i) => at(i)),
    values: Float64Array.from(measured),
    course: target.slice(start).map((value, i) => [at(start + i), value]),
    from: target[start] ?? NaN,
    to: target.at(-1) ?? NaN,
  };
}

/** Longest recording of that many points, s: rounded down, so that it fits. */
export function longest(points: number, rate: number): number {
  return Math.floor((points / rate) * 1000) / 1000;
}
