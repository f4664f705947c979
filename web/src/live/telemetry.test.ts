import { describe, expect, it } from "vitest";
import { decode } from "./telemetry";

function block(samples: [number, number][], version = 1): ArrayBuffer {
  const buffer = new ArrayBuffer(24 + samples.length * 12);
  const view = new DataView(buffer);
  view.setUint8(0, 1);
  view.setUint8(1, version);
  view.setUint16(2, 0x1234, true);
  view.setUint32(4, samples.length, true);
  view.setBigUint64(8, 5_000_000_000n, true);
  view.setBigUint64(16, 7n, true);
  samples.forEach(([dt, value], i) => {
    view.setUint32(24 + i * 12, dt, true);
    view.setFloat64(28 + i * 12, value, true);
  });
  return buffer;
}

describe("telemetry", () => {
  it("gives channel, losses, times in seconds and values", () => {
    const got = decode(
      block([
        [0, 1.5],
        [1000, -2.25],
      ]),
    );
    expect(got?.channel).toBe(0x1234);
    expect(got?.lost).toBe(7);
    expect([...(got?.times ?? [])]).toEqual([5000, 5000.001]);
    expect([...(got?.values ?? [])]).toEqual([1.5, -2.25]);
  });

  it("refuses data that are too short, too long, or of another version", () => {
    const whole = block([
      [0, 1],
      [1, 2],
    ]);
    expect(decode(whole.slice(0, 47))).toBeNull();
    expect(decode(whole.slice(0, 10))).toBeNull();
    expect(decode(new ArrayBuffer(0))).toBeNull();
    expect(decode(block([[0, 1]], 2))).toBeNull();
  });
});
