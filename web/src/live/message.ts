// What the server and the page say to each other. Values are SI, with the unit's word beside them;
// a value that is not known is null.

export type Scope = "read" | "stop" | "move" | "configure" | "raw";

export interface Refused {
  code: string;
  message: string;
  hint: string;
  /** Whether a drive did it; null when nobody can know. */
  executed: boolean | null;
}

export interface LinkView {
  id: number;
  url: string;
  medium: string;
  simulated: boolean;
  state: "open" | "lost";
  reason: string | null;
  /** How full its wire is, 0 to 1. */
  load: number | null;
  counters: { name: string; count: number }[];
}

export interface ArgumentInfo {
  name: keyof Arguments;
  unit: string;
  required: boolean;
}

export interface VerbInfo {
  verb: string;
  arguments: ArgumentInfo[];
  moves: boolean;
}

export interface LimitInfo {
  name: string;
  unit: string;
  min: number | null;
  max: number | null;
}

export interface SignalInfo {
  signal: string;
  unit: string;
  pushed: boolean;
}

export interface ActInfo {
  act: string;
  about: string;
  unit: string | null;
}

export interface AxisInfo {
  id: number;
  link: number;
  number: number;
  name: string;
  label: string;
  protocol: string;
  drive: string;
  profile: string;
  simulated: boolean;
  kind: string;
  watchdog: string;
  caution: string;
  verbs: VerbInfo[];
  limits: LimitInfo[];
  signals: SignalInfo[];
  acts: ActInfo[];
}

export interface LockTold {
  by: string;
  at_ms: number;
  reason: string;
}

export interface BenchView {
  version: string;
  scopes: Scope[];
  links: LinkView[];
  axes: AxisInfo[];
  clashes: { link: number; number: number; message: string }[];
  lock: LockTold | null;
  time_scale: number | null;
}

export interface SignalValue {
  signal: string;
  value: number | null;
  unit: string;
  age_ms: number;
}

export interface FaultTold {
  code: number;
  name: string;
  cause: string;
  remedy: string;
}

export interface AxisState {
  id: number;
  mode: string | null;
  enabled: boolean | null;
  armed: boolean;
  moving: boolean | null;
  signals: SignalValue[];
  faults: FaultTold[];
  lease: { owner: string; epoch: number; expires_ms: number } | null;
  panel: { shows: string; keys: string[] } | null;
}

export interface ParameterInfo {
  name: string;
  symbol: string;
  group: string;
  about: string;
  unit: string;
  min: number | null;
  max: number | null;
  default: number | null;
  readable: boolean;
  writable: boolean;
  kept: boolean;
  moves: boolean;
  words: string[];
}

export interface ParameterRead {
  name: string;
  value: number | null;
  raw: number;
  unit: string;
  word: string | null;
}

export interface Change {
  name: string;
  from: number | null;
  to: number;
  unit: string;
  changed: boolean;
}

export interface FrameItem {
  n: number;
  t_us: number;
  link: number;
  dir: "tx" | "rx" | null;
  raw: string;
  text: string;
  protocol: string;
  axis: number | null;
  ok: boolean;
}

export interface ExplainedField {
  from: number;
  to: number;
  name: string;
  value: string;
  meaning: string;
}

export interface CapturePage {
  id: string;
  from: number;
  next: number | null;
  total: number;
  items: FrameItem[];
}

export interface CaptureOpened {
  id: string;
  name: string;
  format: string;
  links: string[];
  summary: string;
  page: CapturePage;
}

export interface Arguments {
  target?: number;
  velocity?: number;
  acceleration?: number;
  torque?: number;
  jerk_time?: number;
  period?: number;
}

export interface Outcome {
  id: string;
  outcome: "done" | "not_done" | "unknown";
  error: Refused | null;
  replayed: boolean;
}

export type StopClass = "failed" | "sent" | "acknowledged" | "standing";

export interface AxisStopped {
  id: number;
  class: StopClass;
  ms: number;
  error: Refused | null;
}

export interface JournalRecord {
  n: number;
  ms: number;
  who: string;
  deed: string;
  axis: number | null;
  detail: unknown;
  hash: string;
}

export interface Welcome {
  server_ms: number;
  t0_ms: number;
  session: string;
  scopes: Scope[];
  lease_ms: number;
}

export type LeaseAct = "take" | "take_over" | "renew" | "drop";

export type ClientMessage =
  | {
      type: "subscribe";
      channel: number;
      axis: number;
      signal?: string;
      parameter?: string;
      hz: number;
    }
  | { type: "unsubscribe"; channel: number }
  | { type: "frames"; on: boolean; filter: string | null }
  | { type: "explain"; n: number }
  | {
      type: "command";
      axis: number;
      id: string;
      issued_ms: number;
      ttl_ms: number;
      epoch: number;
      verb: string;
      arguments: Arguments;
    }
  | { type: "lease"; axis: number; act: LeaseAct; epoch: number }
  | { type: "stop"; axes: number[] | null; reason: string }
  | { type: "release" }
  | { type: "ping"; client_ms: number };

export type ServerMessage =
  | ({ type: "welcome" } & Welcome)
  | ({ type: "bench" } & BenchView)
  | ({ type: "axis" } & AxisState)
  | { type: "subscribed"; channel: number; hz: number; source: "pushed" | "polled"; unit: string }
  | { type: "gap"; channel: number; from_us: number; to_us: number; lost: number }
  | ({ type: "outcome" } & Outcome)
  | { type: "leased"; axis: number; epoch: number; expires_ms: number | null }
  | { type: "stopped"; axes: AxisStopped[] }
  | ({ type: "locked" } & LockTold)
  | { type: "unlocked" }
  | { type: "frames"; items: FrameItem[]; lost: number }
  | { type: "explained"; n: number; fields: ExplainedField[] }
  | { type: "pong"; client_ms: number; server_ms: number }
  | { type: "error"; error: Refused; about: string | null; subject: number | null };
