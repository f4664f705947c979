// Memory of one channel of the scope: a ring of samples, with the least and greatest value of
// each block of it, so that minutes at 1 kHz are drawn without looking at every sample.

export const BLOCK = 64;
const GAPS_MAX = 256;

export interface Gap {
  from: number;
  to: number;
  lost: number;
}

export class Trace {
  readonly capacity: number;
  readonly gaps: Gap[] = [];
  private readonly times: Float64Array;
  private readonly values: Float64Array;
  private readonly least: Float64Array;
  private readonly greatest: Float64Array;
  private total = 0;

  /** Room for at least `capacity` samples; memory never grows after this. */
  constructor(capacity: number) {
    const blocks = Math.ceil(capacity / BLOCK) + 1;
    this.capacity = blocks * BLOCK;
    this.times = new Float64Array(this.capacity);
    this.values = new Float64Array(this.capacity);
    this.least = new Float64Array(blocks);
    this.greatest = new Float64Array(blocks);
  }

  /** The index of the oldest sample that is still there; indices only ever grow. */
  get first(): number {
    return Math.max(0, this.total - this.capacity);
  }

  /** The index behind the newest sample. */
  get end(): number {
    return this.total;
  }

  time(index: number): number {
    return this.times[index % this.capacity] ?? Number.NaN;
  }

  value(index: number): number {
    return this.values[index % this.capacity] ?? Number.NaN;
  }

  /** The newest sample's time in seconds, or null. */
  get newest(): number | null {
    return this.total ? this.time(this.total - 1) : null;
  }

  /** One more sample. One that is not newer than the last is left out, and false returned. */
  push(time: number, value: number): boolean {
    if (this.total && !(time > this.time(this.total - 1))) return false;
    const at = this.total % this.capacity;
    const block = Math.floor(at / BLOCK);
    this.times[at] = time;
    this.values[at] = value;
    if (at % BLOCK === 0) {
      this.least[block] = value;
      this.greatest[block] = value;
    } else {
      this.least[block] = Math.min(this.least[block] ?? value, value);
      this.greatest[block] = Math.max(this.greatest[block] ?? value, value);
    }
    this.total++;
    return true;
  }

  /** Samples that never came, between two times. */
  gap(gap: Gap): void {
    this.gaps.push(gap);
    if (this.gaps.length > GAPS_MAX) this.gaps.shift();
  }

  /** The index of the first sample at or after `time`. */
  seek(time: number): number {
    let low = this.first;
    let high = this.total;
    while (low < high) {
      const middle = Math.floor((low + high) / 2);
      if (this.time(middle) < time) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** The least and greatest value from index `from` to before `to`, which must not be empty. */
  range(from: number, to: number, into: { min: number; max: number }): void {
    let min = Number.POSITIVE_INFINITY;
    let max = Number.NEGATIVE_INFINITY;
    for (let i = from; i < to;) {
      if (i % BLOCK === 0 && i + BLOCK <= to) {
        const block = (i % this.capacity) / BLOCK;
        min = Math.min(min, this.least[block] ?? min);
        max = Math.max(max, this.greatest[block] ?? max);
        i += BLOCK;
      } else {
        const value = this.value(i);
        if (value < min) min = value;
        if (value > max) max = value;
        i++;
      }
    }
    into.min = min;
    into.max = max;
  }

  /** The sample nearest to `time`, or null where there is none. */
  near(time: number): number | null {
    if (!this.total) return null;
    const after = Math.min(this.seek(time), this.total - 1);
    const before = Math.max(after - 1, this.first);
    return time - this.time(before) < this.time(after) - time ? before : after;
  }

  clear(): void {
    this.total = 0;
    this.gaps.length = 0;
  }
}
