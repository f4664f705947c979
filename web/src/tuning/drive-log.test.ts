import { describe, expect, it } from "vitest";
import { longest, recorded } from "./drive-log";

const view = (position: (number | null)[], target: number[]): Parameters<typeof recorded>[0] => ({
  interval_s: 0.001,
  variables: [
    { name: "actual position", unit: "rad", values: position },
    { name: "target position", unit: "rad", values: target },
  ],
  outcome: null,
});

describe("a recording in the drive", () => {
  it("has its step where the drive's target leaves its place", () => {
    const run = recorded(view([0, 0, 0, 0.5, 0.9, 1], [0, 0, 0, 0.6, 1, 1]));
    expect(run?.times[2]).toBe(0);
    expect(run?.times.at(-1)).toBeCloseTo(0.003);
    expect([run?.from, run?.to]).toEqual([0, 1]);
    expect(run?.course.map(([, value]) => value)).toEqual([0, 0.6, 1, 1]);
  });

  it("is no step without a change of the target", () => {
    expect(recorded(view([0, 0, 0], [0, 0, 0]))).toBeNull();
    expect(recorded({ interval_s: 1, variables: [], outcome: null })).toBeNull();
  });

  it("keeps a value of an unknown scale as a gap", () => {
    expect(recorded(view([0, null, 1], [0, 1, 1]))?.values[1]).toBeNaN();
  });

  it("fits into the drive's memory", () => {
    expect(longest(354, 1000)).toBe(0.354);
    expect(longest(354, 10_000)).toBe(0.035);
  });
});
