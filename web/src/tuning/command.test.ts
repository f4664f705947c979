import { describe, expect, it } from "vitest";
import { positionCourse, speedCourse } from "./command";

describe("the commanded course", () => {
  it("is the step itself if no ramp is known", () => {
    const step = [
      [0, 1],
      [0, 5],
    ];
    expect(speedCourse(1, 5, {})).toEqual(step);
    expect(positionCourse(1, 5, { acceleration: 3 })).toEqual(step);
  });

  it("goes along the ramp that was commanded", () => {
    expect(speedCourse(10, -10, { acceleration: 40 }).at(-1)).toEqual([0.5, -10]);
    expect(positionCourse(0, 10, { velocity: 5 }).at(-1)).toEqual([2, 10]);
  });

  it("is a trapezoid of speed, or a triangle on a short way", () => {
    // 1 s up to 2, 4 s at 2, 1 s down: 10 in all.
    const long = positionCourse(5, -5, { velocity: 2, acceleration: 2 });
    expect(long.at(-1)).toEqual([6, -5]);
    expect(long.find(([time]) => time === 1)?.[1]).toBeCloseTo(4, 9);
    // Never faster than 2: 1 s up, 1 s down.
    const short = positionCourse(0, 2, { velocity: 100, acceleration: 2 });
    expect(short.at(-1)?.[0]).toBeCloseTo(2, 9);
    for (const course of [long, short]) {
      const times = course.map(([time]) => time);
      expect(times).toEqual([...times].sort((a, b) => a - b));
    }
  });
});
