// The view as text behind the URL's `#`, so that a view can be kept and sent on.

import type { When } from "./scope/trigger";

export const CHANNELS_MAX = 16;

export interface ChannelChoice {
  axis: number;
  signal: string;
}

export interface View {
  axis: number;
  upper: "scope" | "tuning";
  lower: "frames" | "simulation" | "log";
  channels: ChannelChoice[];
  /** Seconds across the scope. */
  span: number;
  hz: number;
  when: When;
  /** The channel that the trigger watches, an index into `channels`. */
  watched: number;
  level: number;
  once: boolean;
  filter: string;
}

export const SPANS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 60, 120];
export const RATES = [10, 50, 100, 200, 500, 1000];
const WHENS: When[] = ["off", "rising", "falling", "above", "below", "fault"];

export function blank(): View {
  return {
    axis: 0,
    upper: "scope",
    lower: "frames",
    channels: [],
    span: 10,
    hz: 100,
    when: "off",
    watched: 0,
    level: 0,
    once: false,
    filter: "",
  };
}

/** The text for a view; what is as usual is left out. */
export function write(view: View): string {
  const usual = blank();
  const query = new URLSearchParams();
  for (const key of Object.keys(usual) as (keyof View)[]) {
    if (key === "channels" || view[key] === usual[key]) continue;
    query.set(key, String(view[key]));
  }
  if (view.channels.length) {
    query.set("ch", view.channels.map((each) => `${each.axis}.${each.signal}`).join(","));
  }
  return query.toString();
}

/** The view of a text; what cannot be is left as usual. */
export function parse(text: string): View {
  const query = new URLSearchParams(text.replace(/^#/, ""));
  const view = blank();
  view.axis = whole(query.get("axis")) ?? view.axis;
  view.upper = among(query.get("upper"), ["scope", "tuning"]) ?? view.upper;
  view.lower = among(query.get("lower"), ["frames", "simulation", "log"]) ?? view.lower;
  view.span = among(Number(query.get("span")), SPANS) ?? view.span;
  view.hz = among(Number(query.get("hz")), RATES) ?? view.hz;
  view.when = among(query.get("when"), WHENS) ?? view.when;
  view.watched = whole(query.get("watched")) ?? view.watched;
  const level = Number(query.get("level") ?? Number.NaN);
  if (Number.isFinite(level)) view.level = level;
  view.once = query.get("once") === "true";
  view.filter = query.get("filter") ?? "";
  view.channels = channels(query.get("ch") ?? "");
  return view;
}

function channels(text: string): ChannelChoice[] {
  return text
    .split(",")
    .flatMap((each) => {
      const [, axis = "", signal = ""] = /^(\d{1,5})\.([\w -]+)$/.exec(each) ?? [];
      return signal ? [{ axis: Number(axis), signal }] : [];
    })
    .slice(0, CHANNELS_MAX);
}

function among<T>(value: unknown, all: readonly T[]): T | undefined {
  return all.find((each) => each === value);
}

function whole(text: string | null): number | undefined {
  return text !== null && /^\d{1,5}$/.test(text) ? Number(text) : undefined;
}
