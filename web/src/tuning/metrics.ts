// What a step response is judged by. Shares are of the step's height: from where it began to where it
// was sent.

export interface Metrics {
  /** Seconds from 10 % to 90 %; null where it did not come so far. */
  rise: number | null;
  /** How far beyond the target, as a share of the step. */
  overshoot: number;
  /** Seconds from the step until it stays within the tolerance; null where it does not. */
  settling: number | null;
  /** Seconds from the step to the greatest value. */
  peak: number;
  /** What is left between target and value at the end, in the signal's unit. */
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
    rise: low !== null && high !== null ? high - low : null,
    overshoot: Math.max(0, (shares[greatest] ?? 0) - 1),
    settling: settled(times, shares),
    peak: times[greatest] ?? 0,
    remaining: (1 - tail(shares)) * height,
  };
}

/** When a share is first reached, between samples by a straight line. */
function crossing(times: number[], shares: number[], share: number): number | null {
  const i = shares.findIndex((each) => each >= share);
  if (i < 0) return null;
  return i === 0 ? (times[0] ?? 0) : between(times, shares, i, share);
}

/** When it last came into the tolerance, to stay until the end of the record. */
function settled(times: number[], shares: number[]): number | null {
  const outside = (share: number): boolean => Math.abs(share - 1) > TOLERANCE;
  let i = shares.length;
  while (i > 0 && !outside(shares[i - 1] ?? 0)) i--;
  if (i === shares.length) return null;
  if (i === 0) return times[0] ?? 0;
  const edge = (shares[i - 1] ?? 0) > 1 ? 1 + TOLERANCE : 1 - TOLERANCE;
  return between(times, shares, i, edge);
}

/** When the line from sample `i - 1` to sample `i` crosses `share`. */
function between(times: number[], shares: number[], i: number, share: number): number {
  const [t0 = 0, t1 = 0] = [times[i - 1], times[i]];
  const [s0 = 0, s1 = 0] = [shares[i - 1], shares[i]];
  return s1 === s0 ? t1 : t0 + ((t1 - t0) * (share - s0)) / (s1 - s0);
}

function tail(shares: number[]): number {
  const count = Math.max(1, Math.round(shares.length * TAIL));
  return shares.slice(-count).reduce((sum, share) => sum + share, 0) / count;
}
