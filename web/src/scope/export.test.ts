import { describe, expect, it } from "vitest";
import { csv } from "./export";
import { Trace } from "./trace";

function trace(samples: [number, number][]): Trace {
  const made = new Trace(64);
  for (const [time, value] of samples) made.push(time, value);
  return made;
}

describe("CSV", () => {
  it("has a line for each moment, and empty cells for missing samples", () => {
    const a = trace([
      [0, 1],
      [1, 2],
      [2, 3],
    ]);
    const b = trace([
      [1, 20],
      [1.5, 25],
      [9, 99],
    ]);
    const text = csv(
      [
        { name: "x position", unit: "rad", trace: a },
        { name: "y", unit: "", trace: b },
      ],
      0.5,
      3,
    );
    expect(text).toBe("time [s],x position [rad],y\n1.000000,2,20\n1.500000,,25\n2.000000,3,\n");
  });

  it("lets no drive's name begin a formula or break a line", () => {
    const name = '=HYPERLINK("x"),\n';
    expect(csv([{ name, unit: "", trace: trace([]) }], 0, 1)).toBe(
      'time [s],"\'=HYPERLINK(""x""),\n"\n',
    );
  });
});
