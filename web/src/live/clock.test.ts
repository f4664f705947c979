import { describe, expect, it } from "vitest";
import { Clock } from "./clock";

describe("clock", () => {
  it("trusts the quickest round trip", () => {
    const clock = new Clock();
    clock.pong(1000, 6100, 1200);
    clock.pong(2000, 7001, 2002);
    clock.pong(3000, 8300, 3400);
    expect(clock.offset).toBe(5000);
    expect(clock.round).toBe(2);
  });

  it("has a guess before the first round trip, and forgets it for a measurement", () => {
    const clock = new Clock();
    expect(clock.offset).toBe(0);
    clock.guess(10_000, 4000);
    expect(clock.offset).toBe(6000);
    expect(clock.round).toBeNull();
    clock.pong(5000, 11_050, 5100);
    expect(clock.offset).toBe(6000);
    expect(clock.round).toBe(100);
  });

  it("forgets old measurements, as clocks drift", () => {
    const clock = new Clock();
    clock.pong(0, 500, 0);
    for (let i = 1; i <= 8; i++) clock.pong(i * 1000, i * 1000 + 605, i * 1000 + 10);
    expect(clock.offset).toBe(600);
  });
});
