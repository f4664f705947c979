// One step response as it is kept and compared.

import type { Metrics } from "./metrics";

export interface Run {
  id: number;
  at: number;
  axis: string;
  drive: string;
  signal: string;
  /** Of the wire; `shown` is what people read. */
  unit: string;
  shown: { unit: string; factor: number };
  from: number;
  to: number;
  /** Samples a second, as they came. */
  rate: number;
  lost: number;
  /** Seconds, the step at 0. */
  times: Float64Array;
  values: Float64Array;
  metrics: Metrics | null;
  note: string;
}

export const RUNS_MAX = 8;
