// Tables of stored paths: what is edited, and the curves of a run on the motor model.

import type { PathRow, PathTableMessage, PreviewPointMessage } from "../live/message";

/** Highest number of a path. */
export const PATH_MAX = 32;
export const KINDS = ["single", "auto", "speed", "none"] as const;
export const ENDS = ["absolute", "from-last-end", "from-here"] as const;

/** A path that a person begins with: nothing of it is meant but that it can run. */
export function newPath(number: number): PathRow {
  return {
    number,
    kind: "single",
    end: "absolute",
    position: 0,
    speed: 60,
    acceleration_ms: 200,
    deceleration_ms: 200,
    s_ms: 0,
    delay_ms: 0,
    next: 0,
    interrupts: false,
  };
}

/** The lowest number that no row has; null if there is none. */
export function freeNumber(rows: PathRow[]): number | null {
  for (let number = 1; number <= PATH_MAX; number++) {
    if (!rows.some((row) => row.number === number)) return number;
  }
  return null;
}

export function copyOf(table: PathTableMessage): PathTableMessage {
  return { ...table, paths: table.paths.map((row) => ({ ...row })) };
}

/** Least and greatest of values, with some room; a flat line is in the middle. */
export function range(values: number[]): [number, number] {
  const low = Math.min(...values);
  const high = Math.max(...values);
  const room = high > low ? (high - low) * 0.05 : 1;
  return [low - room, high + room];
}

/** Points of an SVG polyline of `width` by `height`, of values over time. */
export function polyline(
  points: PreviewPointMessage[],
  value: (point: PreviewPointMessage) => number,
  width: number,
  height: number,
): string {
  const end = points.at(-1)?.time || 1;
  const [low, high] = range(points.map(value));
  const place = (point: PreviewPointMessage): string => {
    const x = (point.time / end) * width;
    const y = height - ((value(point) - low) / (high - low)) * height;
    return `${x.toFixed(1)},${y.toFixed(1)}`;
  };
  return points.map(place).join(" ");
}
