import { describe, expect, it } from "vitest";
import { Columns, decimate } from "./decimate";
import { BLOCK, Trace } from "./trace";

function filled(count: number, value: (i: number) => number, room = 1024): Trace {
  const trace = new Trace(room);
  for (let i = 0; i < count; i++) trace.push(i / 1000, value(i));
  return trace;
}

/** A generator of numbers from a seed, so that a failure can be looked at again. */
function numbers(seed: number): () => number {
  let state = seed >>> 0;
  return () => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return state / 2 ** 32;
  };
}

describe("trace", () => {
  it("keeps the newest samples in memory that does not grow", () => {
    const trace = filled(10_000, (i) => i, 512);
    expect(trace.end - trace.first).toBe(trace.capacity);
    expect(trace.value(trace.end - 1)).toBe(9999);
    expect(trace.value(trace.first)).toBe(10_000 - trace.capacity);
  });

  it("leaves out samples that are not newer than the last", () => {
    const trace = new Trace(64);
    expect(trace.push(1, 1)).toBe(true);
    expect(trace.push(1, 2)).toBe(false);
    expect(trace.push(0.5, 2)).toBe(false);
    expect(trace.end).toBe(1);
  });

  it("finds times, and the sample nearest to one", () => {
    const trace = filled(2000, (i) => i);
    expect(trace.seek(1.5)).toBe(1500);
    expect(trace.seek(1.4999)).toBe(1500);
    expect(trace.near(1.5004)).toBe(1500);
    expect(trace.near(1.5006)).toBe(1501);
    expect(trace.near(99)).toBe(1999);
  });

  it("has the same least and greatest values as a look at each sample", () => {
    const next = numbers(7);
    const trace = filled(3000, () => next() - 0.5, 2000);
    for (let round = 0; round < 300; round++) {
      const from = trace.first + Math.floor(next() * (trace.capacity - 1));
      const to = from + 1 + Math.floor(next() * (trace.end - from - 1));
      const all = Array.from({ length: to - from }, (_, i) => trace.value(from + i));
      const range = { min: 0, max: 0 };
      trace.range(from, to, range);
      expect(range).toEqual({ min: Math.min(...all), max: Math.max(...all) });
    }
  });
});

describe("decimation", () => {
  it("keeps a spike of one sample, wherever it is and however wide the view", () => {
    for (const at of [0, 1, BLOCK - 1, BLOCK, 777, 99_998, 99_999]) {
      const trace = filled(100_000, (i) => (i === at ? 50 : Math.sin(i / 900)), 100_000);
      const out = new Columns(800);
      decimate(trace, 0, 100, out, 0.01);
      expect(Math.max(...out.max.subarray(0, out.count))).toBe(50);
      expect(out.count).toBeLessThanOrEqual(800);
    }
  });

  it("covers every sample of the view, to the last", () => {
    const next = numbers(3);
    const trace = filled(20_000, () => next(), 20_000);
    const out = new Columns(300);
    decimate(trace, 2, 19, out, 0.01);
    const whole = { min: 0, max: 0 };
    trace.range(2000, 19_001, whole);
    expect(Math.min(...out.min.subarray(0, out.count))).toBeLessThanOrEqual(whole.min);
    expect(Math.max(...out.max.subarray(0, out.count))).toBeGreaterThanOrEqual(whole.max);
    expect(out.last[out.count - 1]).toBe(trace.value(trace.seek(19)));
  });

  it("draws the same columns when the view moves on by some samples", () => {
    const next = numbers(5);
    const trace = filled(10_000, () => next(), 10_000);
    const one = new Columns(204);
    const two = new Columns(204);
    decimate(trace, 0, 8, one, 0.01);
    decimate(trace, 0.4, 8.4, two, 0.01);
    const first = new Map(Array.from({ length: one.count }, (_, i) => [one.time[i], one.max[i]]));
    let same = 0;
    for (let i = 2; i < two.count - 2; i++) {
      const before = first.get(two.time[i]);
      if (before === undefined) continue;
      expect(two.max[i]).toBe(before);
      same++;
    }
    expect(same).toBeGreaterThan(150);
  });

  it("shows single samples as they are", () => {
    const trace = filled(20, (i) => i * i);
    const out = new Columns(400);
    decimate(trace, 0.005, 0.0149, out, 0.01);
    expect([...out.first.subarray(0, out.count)]).toEqual(
      [4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15].map((i) => i * i),
    );
  });

  it("breaks the line at reported gaps and at long pauses", () => {
    const trace = new Trace(256);
    for (const t of [0, 1, 2, 3, 9, 10]) trace.push(t, t);
    trace.gap({ from: 1.2, to: 1.8, lost: 5 });
    const out = new Columns(100);
    decimate(trace, 0, 10, out, 2);
    expect([...out.broken.subarray(0, out.count)]).toEqual([0, 0, 1, 0, 1, 0]);
  });

  it("breaks it among columns of many samples too", () => {
    const trace = new Trace(20_000);
    for (let i = 0; i < 20_000; i++) if (i < 8000 || i >= 9000) trace.push(i / 1000, 1);
    trace.gap({ from: 8, to: 9, lost: 1000 });
    const out = new Columns(200);
    decimate(trace, 0, 20, out, 100);
    const broken = [...out.broken.subarray(0, out.count)].flatMap((b, i) =>
      b ? [out.time[i]] : [],
    );
    expect(broken).toEqual([9]);
  });

  it("finds nothing without samples", () => {
    const out = new Columns(100);
    decimate(new Trace(64), 0, 1, out, 1);
    expect(out.count).toBe(0);
  });
});
