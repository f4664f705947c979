import { describe, expect, it } from "vitest";
import { digits, elapsed, fromShown, quantity, toShown } from "./units";

describe("units", () => {
  it("shows degrees and rpm in a shop, and SI on request", () => {
    expect(quantity(Math.PI / 2, "rad", "shop")).toBe("90.000°");
    expect(quantity((2 * Math.PI) / 60, "rad/s", "shop")).toBe("1.000 rpm");
    expect(quantity(1.5, "rad/s", "si")).toBe("1.500 rad/s");
    expect(quantity(1.25, "A", "shop")).toBe("1.250 A");
  });

  it("converts shown values back", () => {
    for (const unit of ["rad", "rad/s", "m", "A", ""]) {
      expect(fromShown(toShown(1.234, unit, "shop"), unit, "shop")).toBeCloseTo(1.234, 12);
    }
  });

  it("shows unknown values as unknown, and no negative zero", () => {
    expect(quantity(null, "rad", "shop")).toBe("—");
    expect(digits(Number.NaN)).toBe("—");
    expect(digits(-0.0001)).toBe("-1.000e-4");
    expect(digits(-0)).toBe("0.000");
  });

  it("keeps widths readable from thousandths to millions", () => {
    expect([0.5, 12.3456, 123.456, 1234.56, 123_456.7].map(digits)).toEqual([
      "0.500",
      "12.346",
      "123.46",
      "1234.6",
      "123457",
    ]);
  });

  it("shows flags and codes without decimals", () => {
    expect(quantity(3, "", "shop")).toBe("3");
  });

  it("shows durations as a clock does", () => {
    expect([-5, 999, 59_999, 60_000, 185_000, 7_384_000].map(elapsed)).toEqual([
      "0 s",
      "0 s",
      "59 s",
      "1 min 0 s",
      "3 min 5 s",
      "2 h 3 min",
    ]);
  });
});
