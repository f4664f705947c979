import { describe, expect, it } from "vitest";
import { Channels } from "./channels";
import type { ClientMessage } from "./message";

function block(channel: number, times: number[]) {
  const values = Float64Array.from(times, (time) => time * 2);
  return { channel, lost: 3, times: Float64Array.from(times), values };
}

describe("channels", () => {
  it("subscribes, takes samples of its own number alone, and unsubscribes", () => {
    const said: ClientMessage[] = [];
    const channels = new Channels((message) => said.push(message) > 0);
    const one = channels.open({ axis: 2, signal: "position" }, 100, 64);
    expect(said).toEqual([
      { type: "subscribe", channel: one.number, axis: 2, signal: "position", hz: 100 },
    ]);
    channels.telemetry(block(one.number, [1, 2]));
    channels.telemetry(block(one.number + 1, [3]));
    expect(one.trace.end).toBe(2);
    expect(one.lost).toBe(3);
    channels.close(one);
    expect(said.at(-1)).toEqual({ type: "unsubscribe", channel: one.number });
    expect(channels.telemetry(block(one.number, [9]))).toBeNull();
  });

  it("asks again on a new connection, and forgets traces of another server's clock", () => {
    const said: ClientMessage[] = [];
    const channels = new Channels((message) => said.push(message) > 0);
    const one = channels.open({ axis: 0, signal: "velocity" }, 10, 64);
    channels.telemetry(block(one.number, [1]));
    channels.again(true);
    expect(one.trace.end).toBe(1);
    channels.again(false);
    expect(one.trace.end).toBe(0);
    expect(said.length).toBe(3);
  });

  it("keeps rate, unit, gaps and refusals from the server", () => {
    const channels = new Channels(() => true);
    const one = channels.open({ axis: 0, signal: "velocity" }, 1000, 64);
    const channel = one.number;
    channels.told({ type: "subscribed", channel, hz: 400, source: "polled", unit: "rad/s" });
    channels.told({ type: "gap", channel, from_us: 1e6, to_us: 2e6, lost: 12 });
    expect([one.hz, one.pushed, one.unit]).toEqual([400, false, "rad/s"]);
    expect(one.trace.gaps).toEqual([{ from: 1, to: 2, lost: 12 }]);
    const error = { code: "E2", message: "no such signal", hint: "", executed: false };
    channels.told({ type: "error", about: "subscribe", subject: channel, error });
    expect(one.refused).toBe("no such signal");
  });

  it("applies a refusal without a channel to all unconfirmed channels", () => {
    const channels = new Channels(() => true);
    const [one, two] = ["position", "velocity"].map((signal) =>
      channels.open({ axis: 0, signal }, 10, 64),
    );
    channels.told({
      type: "subscribed",
      channel: one?.number ?? 0,
      hz: 10,
      source: "polled",
      unit: "rad",
    });
    const error = { code: "gateway.request", message: "not shown", hint: "", executed: false };
    channels.told({ type: "error", about: "subscribe", subject: null, error });
    expect([one?.refused, two?.refused]).toEqual(["", "not shown"]);
  });

  it("measures the real rate of samples", () => {
    const channels = new Channels(() => true);
    const one = channels.open({ axis: 0, signal: "velocity" }, 1000, 64);
    for (let i = 0; i <= 40; i++) channels.telemetry(block(one.number, [i / 20 + 100]));
    expect(one.rate).toBeCloseTo(20, 6);
  });

  it("does not mistake a slow wire for silence", () => {
    const channels = new Channels(() => true);
    const one = channels.open({ axis: 0, signal: "velocity" }, 100, 64);
    const channel = one.number;
    channels.told({ type: "subscribed", channel, hz: 100, source: "polled", unit: "rad/s" });
    expect(one.period_max).toBeCloseTo(0.1);
    channels.telemetry(
      block(
        channel,
        Array.from({ length: 40 }, (_, i) => i / 16),
      ),
    );
    expect(one.rate).toBeCloseTo(16, 0);
    expect(one.period_max).toBeCloseTo(5 / 16, 2);
  });

  it("does not mistake silence for a slow wire", () => {
    const channels = new Channels(() => true);
    const one = channels.open({ axis: 0, signal: "velocity" }, 16, 256);
    const channel = one.number;
    channels.told({ type: "subscribed", channel, hz: 16, source: "polled", unit: "rad/s" });
    const from = (start: number, n: number) => Array.from({ length: n }, (_, i) => start + i / 16);
    channels.telemetry(block(channel, from(0, 33)));
    for (const after of [3.9, 5.8, 7.7]) {
      channels.telemetry(block(channel, from(after, 1)));
      expect(one.period_max).toBeCloseTo(5 / 16, 2);
      expect(one.rate).toBeCloseTo(16, 0);
    }
    channels.telemetry(block(channel, from(9.6, 33)));
    expect(one.rate).toBeCloseTo(16, 0);
  });

  it("follows a wire that becomes slow, however slow", () => {
    const channels = new Channels(() => true);
    const one = channels.open({ axis: 0, signal: "velocity" }, 100, 256);
    const channel = one.number;
    channels.told({ type: "subscribed", channel, hz: 100, source: "polled", unit: "rad/s" });
    const every = (start: number, period: number, n: number) =>
      Array.from({ length: n }, (_, i) => start + i * period);
    channels.telemetry(block(channel, every(0, 0.01, 200)));
    expect(one.period_max).toBeCloseTo(0.1);
    channels.telemetry(block(channel, every(3, 3, 20)));
    expect(one.period_max).toBeCloseTo(15);
    expect(one.rate).toBeCloseTo(1 / 3);
  });
});
