// Trigger of the scope, which freezes the picture: at an edge, at a level, at a fault.

export type When = "off" | "rising" | "falling" | "above" | "below" | "fault";

/** The part of the picture that is before the trigger. */
export const BEFORE = 0.2;

export class Trigger {
  /** Seconds of what set it off; null while it waits. */
  fired: number | null = null;
  private last = Number.NaN;
  private open = 0;

  constructor(
    readonly when: When,
    readonly level: number,
  ) {}

  /** Waits for the next one, at or after `time`. */
  arm(time: number): void {
    this.fired = null;
    this.open = time;
    this.last = Number.NaN;
  }

  /** A sample of the watched channel, in order. True where it sets the trigger off. */
  sample(time: number, value: number): boolean {
    const last = this.last;
    this.last = value;
    return this.hit(last, value) && this.fire(time);
  }

  /** An axis became faulty. */
  fault(time: number): boolean {
    return this.when === "fault" && this.fire(time);
  }

  /** View after the trigger: from, to in seconds. */
  window(span: number): [number, number] | null {
    if (this.fired === null) return null;
    const from = this.fired - span * BEFORE;
    return [from, from + span];
  }

  private hit(last: number, value: number): boolean {
    switch (this.when) {
      case "rising":
        return last < this.level && value >= this.level;
      case "falling":
        return last > this.level && value <= this.level;
      case "above":
        return value > this.level;
      case "below":
        return value < this.level;
      default:
        return false;
    }
  }

  private fire(time: number): boolean {
    if (this.fired !== null || time < this.open) return false;
    this.fired = time;
    return true;
  }
}
