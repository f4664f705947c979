import { describe, expect, it } from "vitest";
import { report, type Words } from "./report";
import type { Run } from "./runs.svelte";

const KEYS = [
  "title",
  "run",
  "axis",
  "step",
  "rise",
  "overshoot",
  "settling",
  "peak",
  "remaining",
  "rate",
  "lost",
  "note",
  "legend",
] as const;
const texts = Object.fromEntries(KEYS.map((key) => [key, key])) as Record<
  (typeof KEYS)[number],
  string
>;
const words: Words = {
  ...texts,
  too_short: (time, interval) => `${time} of ${interval}: too short`,
};
const timed = (seconds: number, interval = 0.001) => ({ seconds, spread: interval, interval });

function run(count: number, values: (i: number) => number): Run {
  return {
    id: 1,
    at: 0,
    axis: "<script>alert(1)</script>",
    drive: 'a "drive" & more',
    signal: "velocity",
    unit: "rad/s",
    shown: { unit: "rpm", factor: 2 },
    from: 0,
    to: 10,
    rate: 1000,
    lost: 3,
    times: Float64Array.from({ length: count }, (_, i) => i / 1000),
    values: Float64Array.from({ length: count }, (_, i) => values(i)),
    course: [
      [0, 0],
      [0.005, 10],
    ],
    metrics: {
      rise: timed(0.0123),
      overshoot: 0.05,
      settling: null,
      peak: timed(0.02, 0.036),
      remaining: 0.5,
    },
    note: "",
  };
}

describe("the report", () => {
  it("escapes a drive's name, so that it is no script", () => {
    const text = report([run(10, (i) => i)], words, "en");
    expect(text).not.toContain("<script");
    expect(text).toContain("&#60;script&#62;");
    expect(text).toContain("a &#34;drive&#34; &#38; more");
  });

  it("has the metrics in the units that are shown, and loads nothing", () => {
    const text = report([run(10, (i) => i)], words, "en");
    expect(text).toContain("12 ± 1 ms");
    expect(text).toContain("20 of 36: too short");
    expect(text).toContain("5.0 %");
    expect(text).toContain("0.000 → 20.000 rpm");
    expect(text).toContain("<td>1.000 rpm</td>");
    expect(text).not.toMatch(/(src|href)=/);
  });

  it("keeps spikes though it keeps few points", () => {
    const text = report([run(100_000, (i) => (i === 51_234 ? 77 : 0))], words, "en");
    expect(text.length).toBeLessThan(80_000);
    expect(text).toContain(">154.00<");
  });

  it("shows the commanded course, and the band of the tolerance", () => {
    const text = report([run(10, (i) => i)], words, "en");
    expect(text).toMatch(/<polyline [^>]*stroke-dasharray="5 4" points="(\S+,\S+ ?){4}"/);
    expect(text.match(/<rect /g)?.length).toBe(1);
    expect(text).toContain("<p>legend</p>");
  });
});
