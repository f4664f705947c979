// Step responses as they are kept and compared, whatever panel is shown meanwhile.

import type { Course } from "./command";
import type { Metrics } from "./metrics";

export interface Run {
  id: number;
  at: number;
  axis: string;
  drive: string;
  signal: string;
  /** Unit on the wire; `shown` is the displayed one. */
  unit: string;
  shown: { unit: string; factor: number };
  from: number;
  to: number;
  /** The commanded course, if it is known. */
  course: Course;
  /** Samples a second, as they came. */
  rate: number;
  lost: number;
  /** Seconds, the step at 0. */
  times: Float64Array;
  values: Float64Array;
  metrics: Metrics | null;
  note: string;
}

const RUNS_MAX = 8;

class Runs {
  all = $state.raw<Run[]>([]);
  hidden = $state<Record<number, boolean>>({});
  private made = 0;

  get visible(): Run[] {
    return this.all.filter((run) => !this.hidden[run.id]);
  }

  keep(run: Omit<Run, "id">): void {
    this.all = [...this.all, { id: ++this.made, ...run }].slice(-RUNS_MAX);
  }

  drop(run: Run): void {
    this.all = this.all.filter((each) => each !== run);
  }
}

export const runs = new Runs();
