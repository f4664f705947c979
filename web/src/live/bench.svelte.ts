// The bench as the page knows it, and everything that can be asked of it.

import { axisNumber } from "../axes/number";
import { Channels } from "./channels";
import type {
  CommandArguments,
  CommandRequest,
  AxisInfo,
  AxisState,
  AxisStopReport,
  BenchView,
  DismissReason,
  DriveLogView,
  ExplainedField,
  FoundDrive,
  FrameItem,
  MotionLock,
  ScanView,
  SearchView,
  CommandOutcome,
  GatewayError,
  Scope,
  ServerMessage,
  StopReport,
  Welcome,
} from "./message";
import { preferences } from "../state.svelte";
import { quantity } from "../units";
import { Problem, read, send } from "./rest";
import { Socket } from "./socket";
import { type RequestedStop, Stops } from "./stops.svelte";
import type { Block } from "./telemetry";

const TTL_MS = 500;
/** A command that is given when a recording in the drive runs, which takes some requests to set up. */
const RECORDED_TTL_MS = 10_000;
/** Time the page waits for a command's outcome: homing and moves answer when they have begun. */
const OUTCOME_MS = 15_000;
const RENEW_MS = 500;
/** If a stop under the lease is not answered by then, it is said as everybody may say it. */
const HALT_MS = 1000;
/** Longest time of the server's answer to a stop: it waits until all stand, or 10 s. */
const STOP_MS = 15_000;
const NOTES_MAX = 200;

/** One line of what this page did, and what came of it. */
export interface Note {
  at: number;
  axis: number | null;
  text: string;
  outcome: "pending" | "done" | "not_done" | "unknown" | "info";
  error: GatewayError | null;
}

export type Connection = "connecting" | "open" | "lost" | "token";

interface Pending {
  note: Note;
  settle: (outcome: CommandOutcome) => void;
}

export class Bench {
  connection = $state<Connection>("connecting");
  view = $state.raw<BenchView | null>(null);
  welcome = $state.raw<Welcome | null>(null);
  lock = $state.raw<MotionLock | null>(null);
  /** The last look for drives on each link. */
  looks = $state.raw<Record<number, ScanView>>({});
  /** The last search of ports. */
  search = $state.raw<SearchView | null>(null);
  states = $state.raw<Record<number, AxisState>>({});
  /** When each state came, by this page's clock: ages count on from there. */
  heard: Record<number, number> = {};
  /** Epochs of the leases that this page holds, by axis. */
  leases = $state.raw<Record<number, number>>({});
  /** Stage of the last stop of each axis, of any client. */
  stopped = $state.raw<Record<number, AxisStopReport>>({});
  notes = $state.raw<Note[]>([]);
  round = $state<number | null>(null);
  /** This page's clock, some times a second, for ages. */
  now = $state(Date.now());
  /** The server's, likewise, for times that it tells. */
  serverNow = $state(Date.now());

  /** When the server was last heard of before the connection went, by this page's clock. */
  lastHeard = $state<number | null>(null);

  /** It answered a plain request since, so a stop can be said that way. */
  answers = $state(false);

  readonly stops: Stops;
  readonly channels: Channels;
  readonly framesListeners = new Set<(items: FrameItem[], lost: number) => void>();
  readonly blockListeners = new Set<(block: Block) => void>();
  private readonly socket: Socket;
  private readonly pending = new Map<string, Pending>();
  private readonly dismissals = new Map<number, (refused: GatewayError | null) => void>();
  private readonly explanations = new Map<number, (fields: ExplainedField[]) => void>();
  private t0 = Number.NaN;
  /** Filters that the server has not answered yet. */
  private filtersPending = 0;
  private unlistened: ((error: GatewayError) => void) | null = null;
  private wanted: { on: boolean; filter: string | null } = { on: false, filter: null };

  constructor() {
    this.socket = new Socket({
      opened: () => this.opened(),
      closed: () => this.closed(),
      message: (message) => this.told(message),
      telemetry: (block) => {
        this.channels.telemetry(block);
        for (const each of this.blockListeners) each(block);
      },
    });
    this.channels = new Channels((message) => this.socket.send(message));
    this.stops = new Stops({
      live: (axes, reason) => this.socket.send({ type: "stop", axes, reason }),
      post: async (axes, reason) =>
        (await send<StopReport>("POST", "/stop", { axes, reason }, STOP_MS)).axes,
      reached: (axes) => this.reached(axes),
      certain: (stop) => this.stopEnded(stop),
    });
  }

  start(): void {
    this.socket.open();
    window.setInterval(() => this.renew(), RENEW_MS);
    window.setInterval(() => {
      this.now = Date.now();
      this.serverNow = this.socket.now();
      this.round = this.socket.clock.round;
    }, 250);
  }

  /** Logs in with a typed token. */
  async login(token: string): Promise<void> {
    await send("POST", "/login", { token });
    this.connection = "connecting";
    this.socket.retry();
  }

  may(scope: Scope): boolean {
    return this.view?.scopes.includes(scope) ?? false;
  }

  axis(id: number): AxisInfo | undefined {
    return this.view?.axes.find((axis) => axis.id === id);
  }

  /** Displayed name of an axis: unique, if that is possible. */
  title(id: number): string {
    const axis = this.axis(id);
    if (!axis) return `${id}`;
    if (axis.name) return axis.name;
    const alone = this.view?.axes.every((each) => each === axis || each.label !== axis.label);
    return alone && axis.label ? axis.label : `${axis.profile} ${axisNumber(axis.number)}`;
  }

  signal(id: number, signal: string): number | null {
    return this.states[id]?.signals.find((each) => each.signal === signal)?.value ?? null;
  }

  /** Seconds since the server's start, now. */
  get time(): number {
    return (this.socket.now() - this.t0) / 1000;
  }

  /** The time of day of a moment of telemetry, in ms. */
  timeOfDay(seconds: number): number {
    return this.t0 + seconds * 1000;
  }

  /** True if the drive reports that its motor is powered, and the server allows motion. */
  ready(id: number): boolean {
    const state = this.states[id];
    return state !== undefined && state.armed && state.enabled !== false;
  }

  take(axis: number, over: boolean): void {
    this.socket.send({ type: "lease", axis, act: over ? "take_over" : "take", epoch: 0 });
  }

  drop(axis: number): void {
    const epoch = this.leases[axis];
    if (epoch === undefined) return;
    this.socket.send({ type: "lease", axis, act: "drop", epoch });
    this.forget(axis);
  }

  /** Tells an axis to do something, once. It always settles, if only with `unknown`. */
  command(axis: number, verb: string, args: CommandArguments = {}): Promise<CommandOutcome> {
    const id = crypto.randomUUID();
    const note = this.note(axis, this.described(axis, verb, args), "pending");
    const request = this.request(id, axis, verb, args, TTL_MS);
    return new Promise((settle) => {
      if (!this.socket.send({ type: "command" as const, axis, ...request })) {
        this.ended(note, settle, lost(id, "not_done"));
        return;
      }
      this.pending.set(id, { note, settle });
      window.setTimeout(() => this.outcome(lost(id, "unknown")), OUTCOME_MS);
    });
  }

  /**
   * Records signals in the drive's own control loop, and commands it as soon as the recording runs. `stops`: it is
   * stopped when the points are taken, not only when they have been read.
   */
  async recordInDrive(
    axis: number,
    wanted: { variables: string[]; rate: number; seconds: number; inferred: boolean },
    verb: string,
    args: CommandArguments,
    stops: boolean,
  ): Promise<DriveLogView> {
    const id = crypto.randomUUID();
    const note = this.note(axis, this.described(axis, verb, args), "pending");
    const command = this.request(id, axis, verb, args, RECORDED_TTL_MS);
    const stop = this.request(crypto.randomUUID(), axis, "stop", {}, RECORDED_TTL_MS);
    const afterwards = stops ? stop : null;
    const body = { ...wanted, command, afterwards, epoch: command.epoch };
    try {
      const view = await send<DriveLogView>("POST", `/axes/${axis}/drive-log`, body);
      this.ended(note, () => {}, view.outcome ?? lost(id, "unknown"));
      return view;
    } catch (problem) {
      this.ended(note, () => {}, lost(id, "unknown"));
      throw problem;
    }
  }

  private request(
    id: string,
    axis: number,
    verb: string,
    args: CommandArguments,
    ttl_ms: number,
  ): CommandRequest {
    const epoch = this.leases[axis] ?? 0;
    return { id, issued_ms: this.socket.now(), ttl_ms, epoch, verb, arguments: args };
  }

  /** A command in words, in the units that are shown. */
  private described(axis: number, verb: string, args: CommandArguments): string {
    const offered = this.view?.axes.find((each) => each.id === axis)?.verbs;
    const fields = offered?.find((each) => each.verb === verb)?.arguments ?? [];
    const given = Object.entries(args).map(([name, value]) => {
      const unit = fields.find((field) => field.name === name)?.unit ?? "";
      const told = quantity(Number(value), unit, preferences.units);
      return name === verb ? told : `${name} ${told}`;
    });
    return [verb, given.join(", ")].filter(Boolean).join(" ");
  }

  /** Brings one axis to rest whatever becomes of its command, but leaves the lease where it is. */
  async halt(axis: number): Promise<void> {
    const outcome = await Promise.race([this.command(axis, "stop"), wait(HALT_MS)]);
    // The server reports an accepted stop as pending until the motor stands or moves again.
    const taken = outcome
      ? outcome.outcome === "done" || outcome.error?.code === "gateway.pending"
      : this.states[axis]?.pending_stop;
    if (!taken) this.stop([axis], "stop was not confirmed");
  }

  /** Stops axes, or all of them; needs no lease. What came of it is in `stops` and `stopped`. */
  stop(axes: number[] | null, reason: string): void {
    if (axes === null) this.stopped = {};
    this.note(null, stopped(axes), "info");
    this.stops.request(axes, reason);
    if (!this.socket.usable) this.socket.retry();
  }

  private stopEnded({ axes, certain, refused }: RequestedStop): void {
    if (certain === "accepted" || certain === "sent") return;
    const error = refused ?? unreachable(certain === "not_sent" ? false : null);
    this.note(null, stopped(axes), certain === "unanswered" ? "unknown" : "not_done", error);
  }

  /** Lets motion again after a stop of everything. Nothing moves by that. */
  release(): void {
    if (!this.socket.send({ type: "release" })) return;
    this.note(null, "release", "info");
  }

  /**
   * Dismisses the pending stop of an axis without a confirmed standstill; returns the reason of a refusal. It goes the way of
   * stops: none that is said after it comes before it, and is dismissed with it.
   */
  async dismiss(axis: number, reason: DismissReason, note = ""): Promise<GatewayError | null> {
    const epoch = this.leases[axis] ?? 0;
    const sent = this.socket.send({ type: "dismiss", axis, reason, note, epoch });
    const refused = sent ? await this.dismissed(axis) : unreachable(false);
    this.note(axis, `dismiss ${reason}`, refused ? "not_done" : "done", refused);
    return refused;
  }

  /** Dismisses a pending stop of the previous server for a missing drive. */
  async dismissAbsent(
    link: string,
    number: number,
    reason: DismissReason,
    note = "",
  ): Promise<GatewayError | null> {
    let refused: GatewayError | null = null;
    try {
      await send<null>("POST", "/dismiss", { link, number, reason, note });
    } catch (problem) {
      if (!(problem instanceof Problem)) throw problem;
      refused = problem.refused;
    }
    this.note(null, `dismiss ${reason}`, refused ? "not_done" : "done", refused);
    return refused;
  }

  private dismissed(axis: number): Promise<GatewayError | null> {
    return new Promise((settle) => {
      const before = this.dismissals.get(axis);
      this.dismissals.set(axis, (refused) => {
        before?.(refused);
        settle(refused);
      });
    });
  }

  private settleDismissal(axis: number | null, refused: GatewayError | null): void {
    if (axis === null) return;
    this.dismissals.get(axis)?.(refused);
    this.dismissals.delete(axis);
  }

  /** Looks for drives on a link; `looks` tells how far that is. Nothing moves by it. */
  async look(link: number): Promise<void> {
    const look = await send<ScanView>("POST", `/links/${link}/look`, {});
    // Messages that arrived by the WebSocket in the meantime are newer.
    const known = this.looks[link];
    if (known?.began_ms !== look.began_ms) this.looks = { ...this.looks, [link]: look };
    this.note(null, `look ${this.view?.links[link]?.url ?? link}`, "info");
  }

  async breakLookOff(link: number): Promise<void> {
    await send("DELETE", `/links/${link}/look`, {});
  }

  /** Searches a port, or all that no link uses; `search` tells how far that is. Nothing moves by it. */
  async searchPorts(port: string): Promise<void> {
    const ports = port === "" ? [] : [port];
    const search = await send<SearchView>("POST", "/search", { ports });
    // Messages that arrived by the WebSocket in the meantime are newer.
    if (this.search?.began_ms !== search.began_ms) this.search = search;
    this.note(null, `search ${port || "all ports"}`, "info");
  }

  async breakSearchOff(): Promise<void> {
    await send("DELETE", "/search", {});
  }

  /** Makes axes of drives that were found. */
  async takeIn(link: number, found: FoundDrive[]): Promise<void> {
    const drives = found.map(({ protocol, number }) => ({ protocol, number }));
    await send("POST", `/links/${link}/look/take`, { drives });
    this.note(null, `take in ${drives.map((each) => each.number).join(", ")}`, "info");
  }

  frames(on: boolean, filter: string | null, refused: (error: GatewayError) => void): void {
    this.wanted = { on, filter };
    this.unlistened = refused;
    if (this.socket.send({ type: "frames", on, filter }) && on) this.filtersPending++;
  }

  explain(n: number): Promise<ExplainedField[]> {
    return new Promise((settle) => {
      this.explanations.set(n, settle);
      if (!this.socket.send({ type: "explain", n })) settle([]);
    });
  }

  /** Does something to a simulated drive; gives why not. */
  async act(axis: AxisInfo, act: string, value: number | null): Promise<GatewayError | null> {
    // A drive is named by its place on its link.
    const onLink = this.view?.axes.filter((each) => each.link === axis.link) ?? [];
    const place = onLink.findIndex((each) => each.id === axis.id);
    try {
      await send("POST", `/simulation/${axis.link}/${place}`, { act, value });
      const unit = axis.acts.find((each) => each.act === act)?.unit ?? "";
      const said = [act, value ?? "", value === null ? "" : unit];
      this.note(axis.id, said.filter((part) => part !== "").join(" "), "done");
      return null;
    } catch (problem) {
      if (!(problem instanceof Problem)) throw problem;
      this.complain(problem, axis.id);
      return problem.refused;
    }
  }

  /** Says in the page's own log that something did not work. */
  complain(problem: unknown, axis: number | null = null): void {
    if (problem instanceof Problem) this.note(axis, "", "not_done", problem.refused);
    else this.note(axis, String(problem), "not_done");
  }

  note(
    axis: number | null,
    text: string,
    outcome: Note["outcome"],
    error: GatewayError | null = null,
  ): Note {
    const note: Note = { at: Date.now(), axis, text, outcome, error };
    this.notes = [...this.notes.slice(1 - NOTES_MAX), note];
    return note;
  }

  private opened(): void {
    this.connection = "open";
    this.answers = false;
    this.stops.connected();
    this.filtersPending = this.wanted.on ? 1 : 0;
    if (this.wanted.on) this.socket.send({ type: "frames", ...this.wanted });
  }

  private closed(): void {
    if (this.connection === "open") this.lastHeard = this.socket.heard;
    this.leases = {};
    this.stops.disconnected();
    for (const id of [...this.pending.keys()]) this.outcome(lost(id, "unknown"));
    for (const axis of [...this.dismissals.keys()]) this.settleDismissal(axis, unreachable(null));
    for (const settle of this.explanations.values()) settle([]);
    this.explanations.clear();
    // A user who types a token is not disturbed until the server answers.
    if (this.connection !== "token") this.connection = "lost";
    void this.ask();
  }

  /** A handshake that was refused does not say why; a plain request does. */
  private async ask(): Promise<void> {
    const problem = await read("/bench").then(
      () => null,
      (problem: unknown) => problem,
    );
    if (this.connection === "open") return;
    this.answers = problem === null;
    const refused = problem instanceof Problem && problem.status === 401;
    this.connection = refused ? "token" : "lost";
  }

  private told(message: ServerMessage): void {
    if (this.channels.told(message)) return;
    switch (message.type) {
      case "welcome":
        this.channels.again(message.t0_ms === this.t0);
        this.t0 = message.t0_ms;
        this.welcome = message;
        break;
      case "bench":
        this.view = message;
        this.lock = message.lock;
        this.looks = Object.fromEntries(message.looks.map((look) => [look.link, look]));
        this.search = message.search;
        break;
      case "axis":
        this.heard[message.id] = Date.now();
        this.states = { ...this.states, [message.id]: message };
        this.checkStopped(message);
        this.checkLease(message);
        break;
      case "outcome":
        this.outcome(message);
        break;
      case "leased":
        if (message.expires_ms === null) this.forget(message.axis);
        else this.leases = { ...this.leases, [message.axis]: message.epoch };
        break;
      case "stopped":
        this.reached(message.axes);
        break;
      case "dismissed":
        this.settleDismissal(message.axis, null);
        break;
      case "locked":
        this.lock = message;
        this.leases = {};
        this.stops.locked();
        break;
      case "look":
        this.looks = { ...this.looks, [message.link]: message };
        break;
      case "search":
        this.search = message;
        break;
      case "unlocked":
        this.lock = null;
        this.stopped = {};
        break;
      case "frames":
        // A message without frames answers a filter; what comes before it passed an older one.
        if (!message.items.length && !message.lost) this.filterAnswered();
        if (this.filtersPending) break;
        for (const each of this.framesListeners) each(message.items, message.lost);
        break;
      case "explained":
        this.explanations.get(message.n)?.(message.fields);
        this.explanations.delete(message.n);
        break;
      case "error":
        this.refused(message);
        break;
    }
  }

  private filterAnswered(): void {
    this.filtersPending = Math.max(0, this.filtersPending - 1);
  }

  private refused(message: ServerMessage & { type: "error" }): void {
    if (message.about === "frames") this.filterAnswered();
    if (message.about === "frames" && this.unlistened) this.unlistened(message.error);
    else if (message.about === "explain") this.explanations.forEach((settle) => settle([]));
    else if (message.about === "dismiss") this.settleDismissal(message.subject, message.error);
    else if (message.about === "unsubscribe") return;
    else this.note(message.subject, message.about ?? "", "not_done", message.error);
    if (message.about === "lease" && message.subject !== null) this.forget(message.subject);
  }

  private reached(axes: AxisStopReport[]): void {
    const stopped = { ...this.stopped };
    for (const axis of axes) stopped[axis.id] = axis;
    this.stopped = stopped;
    this.stops.reached(axes);
  }

  private outcome(outcome: CommandOutcome): void {
    const pending = this.pending.get(outcome.id);
    if (!pending) return;
    this.pending.delete(outcome.id);
    this.ended(pending.note, pending.settle, outcome);
  }

  private ended(
    note: Note,
    settle: (outcome: CommandOutcome) => void,
    outcome: CommandOutcome,
  ): void {
    const whole: Note = { ...note, outcome: outcome.outcome, error: outcome.error };
    this.notes = this.notes.map((each) => (each === note ? whole : each));
    settle(outcome);
  }

  /** Forgets the confirmed standstill of an axis that moves again. */
  private checkStopped(state: AxisState): void {
    if (this.lock || !state.moving || this.stopped[state.id]?.class !== "standing") return;
    const { [state.id]: _, ...others } = this.stopped;
    this.stopped = others;
  }

  /** This page lost the lease of the axis, to another client or to none. */
  private checkLease(state: AxisState): void {
    const epoch = this.leases[state.id];
    const theirs = state.lease;
    if (epoch === undefined || !theirs) return;
    if (theirs.epoch > epoch) this.forget(state.id);
  }

  private forget(axis: number): void {
    const { [axis]: _, ...others } = this.leases;
    this.leases = others;
  }

  /** Renews leases, but not while the page is hidden: then they end, and motion with them. */
  private renew(): void {
    if (document.visibilityState !== "visible") return;
    for (const [axis, epoch] of Object.entries(this.leases)) {
      this.socket.send({ type: "lease", axis: Number(axis), act: "renew", epoch });
    }
  }
}

function lost(id: string, outcome: CommandOutcome["outcome"]): CommandOutcome {
  const error = unreachable(outcome === "unknown" ? null : false);
  return { id, outcome, error, replayed: false };
}

function unreachable(executed: boolean | null): GatewayError {
  return { code: "page.unreachable", message: "", hint: "", executed };
}

/** A stop in the page's log. */
function stopped(axes: number[] | null): string {
  return `stop ${axes ?? "all"}`;
}

function wait(ms: number): Promise<null> {
  return new Promise((settle) => window.setTimeout(() => settle(null), ms));
}

export const bench = new Bench();
