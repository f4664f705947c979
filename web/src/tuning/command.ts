// The course that a step commands, as far as it is known: without a ramp it is the step itself.

/** Times in seconds from the step, and values. */
export type Course = [number, number][];

/** Parts that the parabola of an acceleration is drawn in. */
const PARTS = 16;

export interface Limits {
  velocity?: number;
  acceleration?: number;
}

/** A step of speed: along the ramp of its acceleration. */
export function speedCourse(from: number, to: number, { acceleration }: Limits): Course {
  const ramp = acceleration ? Math.abs(to - from) / acceleration : 0;
  return [
    [0, from],
    [ramp, to],
  ];
}

/** A step of position: a trapezoid of speed, a triangle where the way is too short for it. */
export function positionCourse(from: number, to: number, limits: Limits): Course {
  const way = Math.abs(to - from);
  const sign = Math.sign(to - from);
  const { velocity, acceleration } = limits;
  if (!velocity || !acceleration) {
    const seconds = velocity && !acceleration ? way / velocity : 0;
    return [
      [0, from],
      [seconds, to],
    ];
  }
  const top = Math.min(velocity, Math.sqrt(way * acceleration));
  const ramp = top / acceleration;
  const total = way / top + ramp;
  const at = (time: number): number => (acceleration * time ** 2) / 2;
  const parts = Array.from({ length: PARTS + 1 }, (_, i) => (ramp * i) / PARTS);
  const up: Course = parts.map((time) => [time, from + sign * at(time)]);
  const down: Course = parts
    .toReversed()
    .map((time) => [total - time, from + sign * (way - at(time))]);
  return [...up, ...down];
}
