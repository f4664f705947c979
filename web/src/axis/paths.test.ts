import { describe, expect, it } from "vitest";
import { copyOf, freeNumber, newPath, polyline, range } from "./paths";

describe("paths", () => {
  it("gives the lowest free number", () => {
    expect(freeNumber([])).toBe(1);
    expect(freeNumber([newPath(1), newPath(3)])).toBe(2);
    expect(freeNumber(Array.from({ length: 32 }, (_, n) => newPath(n + 1)))).toBeNull();
  });

  it("edits a copy", () => {
    const table = { motor_turns: 1, travel: 360, unit: "deg", paths: [newPath(1)] };
    const copy = copyOf(table);
    copy.paths.forEach((row) => (row.speed = 5));
    expect(table.paths[0]?.speed).toBe(60);
  });

  it("draws from the first to the last point", () => {
    const points = [
      { time: 0, position: 0, speed: 0 },
      { time: 2, position: 90, speed: 0 },
    ];
    expect(polyline(points, (point) => point.position, 100, 50)).toBe("0.0,47.7 100.0,2.3");
    expect(range([3, 3])).toEqual([2, 4]);
  });
});
