import { describe, expect, it } from "vitest";
import { Trigger, type When } from "./trigger";

function first(when: When, level: number, values: number[], armed = 0): number | null {
  const trigger = new Trigger(when, level);
  trigger.arm(armed);
  values.forEach((value, time) => trigger.sample(time, value));
  return trigger.fired;
}

describe("trigger", () => {
  it("goes off at the selected edge, and at that alone", () => {
    expect(first("rising", 5, [9, 4, 6, 3, 7])).toBe(2);
    expect(first("falling", 5, [4, 6, 3, 7, 1])).toBe(2);
    expect(first("rising", 5, [9, 8, 7, 3, 2])).toBeNull();
    expect(first("rising", 5, [6])).toBeNull();
  });

  it("goes off at a level, whatever came before", () => {
    expect(first("above", 5, [6])).toBe(0);
    expect(first("below", 5, [6, 7, 2])).toBe(2);
    expect(first("off", 0, [1, -1, 1])).toBeNull();
  });

  it("goes off once until it is armed again, and not for what is older", () => {
    const trigger = new Trigger("rising", 0.5);
    trigger.arm(0);
    const pulse = (time: number): void => {
      trigger.sample(time, 0);
      trigger.sample(time + 0.1, 1);
    };
    pulse(1);
    pulse(2);
    expect(trigger.fired).toBe(1.1);
    trigger.arm(4);
    pulse(3);
    expect(trigger.fired).toBeNull();
    pulse(4);
    expect(trigger.fired).toBe(4.1);
  });

  it("goes off at faults, and shows a fifth of the picture before them", () => {
    const trigger = new Trigger("fault", 0);
    expect(trigger.sample(1, 100)).toBe(false);
    expect(trigger.fault(10)).toBe(true);
    expect(trigger.window(5)).toEqual([9, 14]);
    expect(new Trigger("rising", 0).fault(10)).toBe(false);
  });
});
