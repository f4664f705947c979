import { describe, expect, it } from "vitest";
import { isMeasurable, metrics, milliseconds, type Response } from "./metrics";

/** A second-order system's answer to a step, from its textbook formula. */
function secondOrder(damping: number, omega: number, seconds: number, from = 0, to = 1): Response {
  const times = Array.from({ length: seconds * 10_000 }, (_, i) => i / 10_000);
  const damped = omega * Math.sqrt(1 - damping ** 2);
  const values = times.map((t) => {
    const swing =
      Math.cos(damped * t) + (damping / Math.sqrt(1 - damping ** 2)) * Math.sin(damped * t);
    return from + (to - from) * (1 - Math.exp(-damping * omega * t) * swing);
  });
  return { times, values, from, to };
}

describe("step metrics", () => {
  it("agree with the formulas of a second-order system", () => {
    for (const [damping, omega] of [
      [0.3, 20],
      [0.5, 50],
      [0.7, 8],
    ] as const) {
      const got = metrics(secondOrder(damping, omega, 5));
      const root = Math.sqrt(1 - damping ** 2);
      expect(got?.overshoot).toBeCloseTo(Math.exp((-damping * Math.PI) / root), 4);
      expect(got?.peak.seconds).toBeCloseTo(Math.PI / (omega * root), 3);
      expect(got?.remaining).toBeCloseTo(0, 4);
    }
    // Rise time of a first-order system: ln 9 time constants; it settles to 2 % in ln 50 of them.
    const times = Array.from({ length: 20_000 }, (_, i) => i / 10_000);
    const values = times.map((t) => 1 - Math.exp(-t / 0.1));
    const first = metrics({ times, values, from: 0, to: 1 });
    expect(first?.rise?.seconds).toBeCloseTo(0.1 * Math.log(9), 4);
    expect(first?.settling?.seconds).toBeCloseTo(0.1 * Math.log(50), 4);
    expect(first?.overshoot).toBe(0);
  });

  it("are the same for a step down, and in any unit", () => {
    const up = metrics(secondOrder(0.4, 30, 3));
    const down = metrics(secondOrder(0.4, 30, 3, 100, -300));
    expect(down?.rise?.seconds).toBeCloseTo(up?.rise?.seconds ?? 0, 9);
    expect(down?.overshoot).toBeCloseTo(up?.overshoot ?? 0, 9);
    expect(down?.settling?.seconds).toBeCloseTo(up?.settling?.seconds ?? 0, 9);
  });

  it("report what did not happen", () => {
    const half = { times: [0, 1, 2, 3], values: [0, 0.2, 0.5, 0.5], from: 0, to: 1 };
    expect(metrics(half)).toMatchObject({ rise: null, settling: null, remaining: 0.5 });
    expect(metrics({ ...half, to: 0 })).toBeNull();
    expect(metrics({ ...half, times: [-3, -2, -1, 0] })).toBeNull();
  });

  it("do not count as settled what left the tolerance again", () => {
    const times = [0, 1, 2, 3, 4];
    expect(metrics({ times, values: [0, 1, 1, 1, 1.5], from: 0, to: 1 })?.settling).toBeNull();
    const late = metrics({ times, values: [0, 1, 1.2, 1, 1], from: 0, to: 1 })?.settling;
    expect(late?.seconds).toBeCloseTo(2.9, 9);
  });

  it("leave out samples before the step and values that are no numbers", () => {
    const times = [-1, 0, 1, 2, 3];
    const values = [9, 0, 1, Number.NaN, 1];
    expect(metrics({ times, values, from: 0, to: 1 })?.overshoot).toBe(0);
  });

  it("are no more exact than the samples", () => {
    // A first-order system that rises in 46 ms, looked at every 36 ms, at any moment.
    const constant = 0.046 / Math.log(9);
    for (let phase = 0; phase < 0.036; phase += 0.003) {
      const times = Array.from({ length: 40 }, (_, i) => phase + i * 0.036);
      const values = times.map((t) => 1 - Math.exp(-t / constant));
      const rise = metrics({ times, values, from: 0, to: 1 })?.rise;
      expect(rise).toBeTruthy();
      if (!rise) continue;
      expect(isMeasurable(rise)).toBe(false);
      expect(Math.abs(rise.seconds - 0.046)).toBeLessThanOrEqual(rise.spread);
    }
    // One that rises in 460 ms is measurable at this rate, and the true value is within the reported bounds.
    for (let phase = 0; phase < 0.036; phase += 0.003) {
      const times = Array.from({ length: 80 }, (_, i) => phase + i * 0.036);
      const values = times.map((t) => 1 - Math.exp((-t * Math.log(9)) / 0.46));
      const got = metrics({ times, values, from: 0, to: 1 });
      const [rise, settling] = [got?.rise, got?.settling];
      expect(rise && isMeasurable(rise) && settling && isMeasurable(settling)).toBe(true);
      if (!rise || !settling) continue;
      expect(Math.abs(rise.seconds - 0.46)).toBeLessThanOrEqual(rise.spread);
      const truth = (0.46 / Math.log(9)) * Math.log(50);
      expect(Math.abs(settling.seconds - truth)).toBeLessThanOrEqual(settling.spread);
      expect(milliseconds(rise)).toMatch(/^\d{3} ± \d\d ms$/);
    }
  });
});
