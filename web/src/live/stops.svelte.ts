// Stops that this page says, and what is certain of each. A stop that did not get through stays open: it
// is said again when there is a connection, and whoever said it is told meanwhile that it did not.

import type { AxisStopReport, GatewayError } from "./message";
import { Problem, UNANSWERED } from "./rest";

/** If a stop is not confirmed on the WebSocket by then, it is said over HTTP too. */
const AGAIN_MS = 250;
/** Without a word of the server by then, nobody may count on it. */
const UNANSWERED_MS = 1500;
/** For so long a stop that did not get through is said again by itself; then somebody has to. */
const RESEND_MS = 60_000;

/**
 * What is certain: it was said just now; the server took it, and tells how far each axis came; it may
 * have left, but nobody answered; it did not get through; the server does not do it.
 */
export type Certain = "said" | "taken" | "unanswered" | "not_sent" | "refused";

export interface SaidStop {
  /** Which; `null` for all. */
  axes: number[] | null;
  reason: string;
  /** By this page's clock, ms. */
  at: number;
  certain: Certain;
  /** Why the server does not do it. */
  refused: GatewayError | null;
}

/** How a stop gets to the server. */
export interface Ways {
  /** By the WebSocket. False where there is none: then nothing was sent. */
  live(axes: number[] | null, reason: string): boolean;
  /** By HTTP; gives how far each axis came, or a `Problem`. */
  post(axes: number[] | null, reason: string): Promise<AxisStopReport[]>;
  /** Tells how far axes came. */
  reached(axes: AxisStopReport[]): void;
  /** Tells that it is certain by now what came of a stop. */
  certain(said: SaidStop): void;
}

export class Stops {
  /** The last stop; `null` when nobody need know of it any more. */
  said = $state.raw<SaidStop | null>(null);
  /** Goes up with each time that one is said: what came of an earlier time is not of this one. */
  private times = 0;
  /** Axes that the server told of since. */
  private heard = new Set<number>();

  constructor(private readonly ways: Ways) {}

  /** Whether it is not known to have been taken. */
  get open(): boolean {
    return this.said !== null && this.said.certain !== "taken";
  }

  /** Whether it will be said again by itself. */
  isResending(now: number): boolean {
    return this.open && now - (this.said?.at ?? 0) < RESEND_MS;
  }

  /** Stops axes, or all: together with those whose stop has not got through yet. */
  say(axes: number[] | null, reason: string): void {
    const before = this.open ? this.said : null;
    const wanted =
      axes === null || before?.axes === null
        ? null
        : [...new Set([...(before?.axes ?? []), ...axes])];
    this.out({ axes: wanted, reason, at: Date.now(), certain: "said", refused: null });
  }

  /** There is a connection: what did not get through is said again. */
  connected(): void {
    const { said } = this;
    if (said && this.isResending(Date.now())) this.out({ ...said, certain: "said", refused: null });
  }

  /** There is none: nobody tells any more how far a stop came. */
  disconnected(): void {
    if (!this.open) this.said = null;
  }

  /** The server says that everything was stopped. */
  locked(): void {
    if (this.said?.axes === null) this.end({ certain: "taken" });
  }

  /** The server says how far axes came. */
  reached(axes: AxisStopReport[]): void {
    const wanted = this.said?.axes;
    if (!wanted) return;
    for (const axis of axes) this.heard.add(axis.id);
    if (wanted.every((id) => this.heard.has(id))) this.end({ certain: "taken" });
  }

  /** Whoever said it needs no more. */
  dismiss(): void {
    this.said = null;
  }

  private out(said: SaidStop): void {
    const time = ++this.times;
    const { axes, reason } = said;
    this.said = said;
    this.heard.clear();
    const sent = this.ways.live(axes, reason);
    if (sent) setTimeout(() => this.waits(time) && this.post(time, true), AGAIN_MS);
    else this.post(time, false);
    setTimeout(() => this.waits(time) && this.end({ certain: "unanswered" }), UNANSWERED_MS);
  }

  /** By HTTP, which the WebSocket may have been before. */
  private post(time: number, sent: boolean): void {
    const { said } = this;
    if (!said) return;
    this.ways.post(said.axes, said.reason).then(
      (axes) => {
        if (time === this.times) this.end({ certain: "taken" });
        this.ways.reached(axes);
      },
      (problem: unknown) => {
        if (time !== this.times || !this.open) return;
        if (!(problem instanceof Problem)) throw problem;
        const { status, refused } = problem;
        if (status) this.end({ certain: "refused", refused });
        else if (sent || refused.code === UNANSWERED) this.end({ certain: "unanswered" });
        else this.end({ certain: "not_sent" });
      },
    );
  }

  private waits(time: number): boolean {
    return time === this.times && this.said?.certain === "said";
  }

  private end(what: Partial<SaidStop>): void {
    if (!this.said || this.said.certain === what.certain) return;
    this.said = { ...this.said, ...what };
    this.ways.certain(this.said);
  }
}
