// Subscriptions: each channel is one signal of one axis, remembered as a trace. They are asked for
// again on every new connection; what went by meanwhile is a gap.

import { Trace } from "../scope/trace";
import type { ClientMessage, ServerMessage } from "./message";
import type { Block } from "./telemetry";

const RATE_OVER_S = 1;
/** A shorter pause after the last sample is no silence, s. */
const SILENCE_MIN_S = 0.1;
/** Spacings of samples whose median is the usual one; so many before there is one. */
const SPACINGS = 15;
const SPACINGS_MIN = 3;

export type Source = { axis: number; signal: string } | { axis: number; parameter: string };

export class Channel {
  readonly trace: Trace;
  /** As the server says it: how often a sample comes, where from, in which unit. */
  hz = 0;
  pushed = false;
  unit = "";
  /** Why there is nothing to see; empty while there is. */
  refused = "";
  lost = 0;
  /** Samples a second, as they really came. */
  rate = 0;
  private counted = 0;
  private since = Number.NaN;
  private last = Number.NaN;
  /** Between the last samples, s; the oldest is overwritten. */
  private readonly spacings: number[] = [];
  private oldest = 0;

  constructor(
    readonly number: number,
    readonly source: Source,
    readonly wanted: number,
    capacity: number,
  ) {
    this.trace = new Trace(capacity);
  }

  /** Takes samples in. The rate is that of their own times, however late they came. */
  take(block: Block): void {
    this.lost = block.lost;
    for (let i = 0; i < block.times.length; i++) {
      const time = block.times[i] ?? 0;
      if (this.trace.push(time, block.values[i] ?? 0)) this.count(time);
    }
  }

  private count(time: number): void {
    const spacing = time - this.last;
    this.last = time;
    // A silence is none of the rate; a clock that was set back begins anew.
    const goes_on = spacing > 0 && (spacing <= SILENCE_MIN_S || spacing <= this.period_max);
    if (spacing > 0) this.note(spacing);
    if (!goes_on) {
      this.since = time;
      this.counted = 0;
      return;
    }
    this.counted++;
    if (time - this.since < RATE_OVER_S) return;
    this.rate = this.counted / (time - this.since);
    this.since = time;
    this.counted = 0;
  }

  private note(spacing: number): void {
    this.spacings[this.oldest] = spacing;
    this.oldest = (this.oldest + 1) % SPACINGS;
  }

  /** Seconds between samples as they mostly come: one silence among them changes nothing. */
  private get usual(): number {
    if (this.spacings.length < SPACINGS_MIN) return 0;
    const sorted = this.spacings.toSorted((a, b) => a - b);
    return sorted[sorted.length >> 1] ?? 0;
  }

  /** Seconds after which silence is drawn as such: what is asked for comes as often as its wire lets it. */
  get period_max(): number {
    const period = Math.max(this.hz > 0 ? 1 / this.hz : 0, this.usual);
    return period > 0 ? Math.max(5 * period, SILENCE_MIN_S) : 1;
  }

  /** Subscription sent to the server. */
  get subscription(): ClientMessage {
    return { type: "subscribe", channel: this.number, ...this.source, hz: this.wanted };
  }
}

export class Channels {
  private readonly all = new Map<number, Channel>();
  private next = 1;

  constructor(private readonly send: (message: ClientMessage) => boolean) {}

  open(source: Source, hz: number, capacity: number): Channel {
    const channel = new Channel(this.free(), source, hz, capacity);
    this.all.set(channel.number, channel);
    this.send(channel.subscription);
    return channel;
  }

  close(channel: Channel): void {
    if (this.all.delete(channel.number)) {
      this.send({ type: "unsubscribe", channel: channel.number });
    }
  }

  /** Asks for all of them again: the connection is new. Its clock may be too. */
  again(sameServer: boolean): void {
    for (const channel of this.all.values()) {
      if (!sameServer) channel.trace.clear();
      this.send(channel.subscription);
    }
  }

  telemetry(block: Block): Channel | null {
    const channel = this.all.get(block.channel);
    channel?.take(block);
    return channel ?? null;
  }

  /** Handles a server message about a channel. Returns false for other messages. */
  told(message: ServerMessage): boolean {
    if (message.type === "subscribed") {
      const channel = this.all.get(message.channel);
      if (!channel) return true;
      channel.hz = message.hz;
      channel.pushed = message.source === "pushed";
      channel.unit = message.unit;
      channel.refused = "";
      return true;
    }
    if (message.type === "gap") {
      const { from_us, to_us, lost } = message;
      this.all.get(message.channel)?.trace.gap({ from: from_us / 1e6, to: to_us / 1e6, lost });
      return true;
    }
    if (message.type === "error" && message.about === "subscribe") {
      for (const channel of this.all.values()) {
        // A server that does not say which channel means each that it has not confirmed.
        const meant = message.subject === null ? !channel.hz : message.subject === channel.number;
        if (meant) channel.refused = message.error.message;
      }
      return true;
    }
    return false;
  }

  private free(): number {
    while (this.all.has(this.next)) this.next = (this.next % 0xffff) + 1;
    const number = this.next;
    this.next = (this.next % 0xffff) + 1;
    return number;
  }
}
