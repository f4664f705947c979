import { parquetMetadata, parquetReadObjects } from "hyparquet";
import { describe, expect, it } from "vitest";
import { parquet } from "./parquet";
import { Trace } from "./trace";

const ZERO = "2026-01-02T03:04:05.000Z";

function trace(samples: [number, number][]): Trace {
  const made = new Trace(samples.length);
  for (const [time, value] of samples) made.push(time, value);
  return made;
}

describe("Parquet", () => {
  it("has a row for each moment, null without a sample, and units in its metadata", async () => {
    const file = parquet(
      [
        {
          name: "x position",
          unit: "rad",
          trace: trace([
            [0, 1],
            [1, -0],
            [2, 1e-300],
          ]),
        },
        {
          name: "y",
          unit: "",
          trace: trace([
            [1, 20],
            [1.5, 25],
            [9, 99],
          ]),
        },
      ],
      0.5,
      3,
      ZERO,
    );
    expect(await parquetReadObjects({ file })).toEqual([
      { time: 1, "x position": -0, y: 20 },
      { time: 1.5, "x position": null, y: 25 },
      { time: 2, "x position": 1e-300, y: null },
    ]);
    const said = Object.fromEntries(
      (parquetMetadata(file).key_value_metadata ?? []).map(({ key, value }) => [key, value]),
    );
    expect(JSON.parse(said.units ?? "")).toEqual({ time: "s", "x position": "rad", y: "" });
    expect(said.time_zero).toBe(ZERO);
  });

  it("keeps every row of more than one group, and both of two channels of one name", async () => {
    const many = trace(Array.from({ length: 70_000 }, (_, i) => [i / 1000, i % 7]));
    const file = parquet(
      [
        { name: "time", unit: "rad", trace: many },
        { name: "time", unit: "rad", trace: trace([]) },
      ],
      0,
      1e9,
      ZERO,
    );
    const { row_groups, num_rows } = parquetMetadata(file);
    expect([row_groups.length, Number(num_rows)]).toEqual([2, 70_000]);
    const read = await parquetReadObjects({ file, rowStart: 69_999, rowEnd: 70_000 });
    expect(read).toEqual([{ time: 69.999, "time 2": 69_999 % 7, "time 3": null }]);
  });

  it("is a valid file without samples, too", async () => {
    const file = parquet([{ name: "x", unit: "", trace: trace([]) }], 0, 1, ZERO);
    expect(await parquetReadObjects({ file })).toEqual([]);
  });
});
