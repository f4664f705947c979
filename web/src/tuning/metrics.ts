// Metrics of a step response. Shares are of the step's height: from where it began to where it
// was sent.

/** A time that was found between samples. */
export interface Timed {
  seconds: number;
  /** The true time is within so many seconds of it. */
  spread: number;
  /** Seconds between the samples that it was found between, the greater where there are two. */
  interval: number;
}

export interface Metrics {
  /** From 10 % to 90 %; null where it did not come so far. */
  rise: Timed | null;
  /** Overshoot beyond the target, as a share of the step. */
  overshoot: number;
  /** From the step until it stays within the tolerance; null where it does not. */
  settling: Timed | null;
  /** From the step to the greatest value. */
  peak: Timed;
  /** Difference between target and value at the end, in the signal's unit. */
  remaining: number;
}

export interface Response {
  /** Seconds, the step at 0. */
  times: ArrayLike<number>;
  values: ArrayLike<number>;
  from: number;
  to: number;
}

/** The share of the step within which it counts as settled. */
export const TOLERANCE = 0.02;
/** The end of the record that the remaining error is averaged over. */
const TAIL = 0.1;

/** Null where there is no step, or nothing was recorded behind it. */
export function metrics(response: Response): Metrics | null {
  const { from, to } = response;
  const height = to - from;
  if (!Number.isFinite(height) || height === 0) return null;
  const times: number[] = [];
  const shares: number[] = [];
  for (let i = 0; i < response.times.length; i++) {
    const time = response.times[i] ?? Number.NaN;
    const value = response.values[i] ?? Number.NaN;
    if (time < 0 || !Number.isFinite(value)) continue;
    times.push(time);
    shares.push((value - from) / height);
  }
  if (times.length < 2) return null;
  const low = crossing(times, shares, 0.1);
  const high = crossing(times, shares, 0.9);
  const greatest = shares.reduce((best, share, i) => (share > (shares[best] ?? 0) ? i : best), 0);
  return {
    rise: low && high && difference(low, high),
    overshoot: Math.max(0, (shares[greatest] ?? 0) - 1),
    settling: settled(times, shares),
    peak: top(times, greatest),
    remaining: (1 - tail(shares)) * height,
  };
}

/** Fewer than two intervals of the samples say nothing of a time between them. */
export function isMeasurable(time: Timed): boolean {
  return time.seconds >= 2 * time.interval;
}

/** When a share is first reached, between samples by a straight line. */
function crossing(times: number[], shares: number[], share: number): Timed | null {
  const i = shares.findIndex((each) => each >= share);
  return i < 0 ? null : between(times, shares, i, share);
}

/** When it last came into the tolerance, to stay until the end of the record. */
function settled(times: number[], shares: number[]): Timed | null {
  const outside = (share: number): boolean => Math.abs(share - 1) > TOLERANCE;
  let i = shares.length;
  while (i > 0 && !outside(shares[i - 1] ?? 0)) i--;
  if (i === shares.length) return null;
  const edge = (shares[i - 1] ?? 0) > 1 ? 1 + TOLERANCE : 1 - TOLERANCE;
  return between(times, shares, i, edge);
}

/** When the line from sample `i - 1` to sample `i` crosses `share`. */
function between(times: number[], shares: number[], i: number, share: number): Timed {
  // The step itself is exact.
  const [t0 = 0, t1 = 0] = [i === 0 ? 0 : times[i - 1], times[i]];
  const [s0 = 0, s1 = 0] = [i === 0 ? 0 : shares[i - 1], shares[i]];
  const seconds = s1 === s0 ? t1 : t0 + ((t1 - t0) * (share - s0)) / (s1 - s0);
  const clamped = Math.min(Math.max(seconds, t0), t1);
  // The curve between the samples is not known: it may have crossed at either.
  return { seconds: clamped, spread: Math.max(clamped - t0, t1 - clamped), interval: t1 - t0 };
}

function difference(from: Timed, to: Timed): Timed {
  return {
    seconds: to.seconds - from.seconds,
    spread: from.spread + to.spread,
    interval: Math.max(from.interval, to.interval),
  };
}

/** The greatest value is between the samples beside it. */
function top(times: number[], i: number): Timed {
  const seconds = times[i] ?? 0;
  const before = seconds - (times[i - 1] ?? seconds);
  const behind = (times[i + 1] ?? seconds) - seconds;
  const interval = Math.max(before, behind);
  return { seconds, spread: interval, interval };
}

/** Milliseconds with the digits that the samples carry. */
export function milliseconds({ seconds, spread }: Timed): string {
  return `${rounded(seconds, spread)} ± ${rounded(spread, spread)} ms`;
}

/** A time in milliseconds without digits that an uncertainty of so much does not carry. */
export function rounded(seconds: number, spread: number): string {
  return (seconds * 1000).toFixed(spread >= 0.001 ? 0 : spread >= 0.0001 ? 1 : 2);
}

function tail(shares: number[]): number {
  const count = Math.max(1, Math.round(shares.length * TAIL));
  return shares.slice(-count).reduce((sum, share) => sum + share, 0) / count;
}
