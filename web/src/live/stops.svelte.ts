// Stops that this page requests, and the certain progress of each. A stop that was not delivered stays
// open: it is sent again with the next connection, and until then the page shows that it was not.

import type { AxisStopReport, GatewayError } from "./message";
import { Problem, UNANSWERED } from "./rest";

/** If a stop is not confirmed on the WebSocket by then, it is sent over HTTP as well. */
const AGAIN_MS = 250;
/** Without a reply of the server by then, the stop counts as unanswered. */
const UNANSWERED_MS = 1500;
/** A stop that was not delivered is sent again for this time; after it, only by the user. */
const RESEND_MS = 60_000;

/**
 * Certain progress of a stop: sent, without a reply yet; accepted by the server, which reports each axis;
 * unanswered, though it may have been delivered; not sent; refused by the server.
 */
export type Certain = "sent" | "accepted" | "unanswered" | "not_sent" | "refused";

export interface RequestedStop {
  /** Axes to stop; `null` for all. */
  axes: number[] | null;
  reason: string;
  /** Time of the request by this page's clock, ms. */
  at: number;
  certain: Certain;
  /** Reason of the server's refusal. */
  refused: GatewayError | null;
}

/** Paths of a stop to the server. */
export interface StopTransport {
  /** Sends by the WebSocket. False without a connection: then nothing was sent. */
  live(axes: number[] | null, reason: string): boolean;
  /** Sends by HTTP; returns the progress of each axis, or throws a `Problem`. */
  post(axes: number[] | null, reason: string): Promise<AxisStopReport[]>;
  /** Reports the progress of axes. */
  reached(axes: AxisStopReport[]): void;
  /** Reports new certainty about a stop. */
  certain(stop: RequestedStop): void;
}

export class Stops {
  /** The last stop; `null` once it no longer has to be shown. */
  last = $state.raw<RequestedStop | null>(null);
  /** Counts requests, so that the result of an earlier one is not taken for this one. */
  private times = 0;
  /** Axes that the server has reported since. */
  private reported = new Set<number>();

  constructor(private readonly transport: StopTransport) {}

  /** True until the server has accepted it. */
  get open(): boolean {
    return this.last !== null && this.last.certain !== "accepted";
  }

  /** True while it is sent again without the user. */
  isResending(now: number): boolean {
    return this.open && now - (this.last?.at ?? 0) < RESEND_MS;
  }

  /** Stops axes, or all: together with those whose stop has not got through yet. */
  request(axes: number[] | null, reason: string): void {
    const before = this.open ? this.last : null;
    const wanted =
      axes === null || before?.axes === null
        ? null
        : [...new Set([...(before?.axes ?? []), ...axes])];
    this.send({ axes: wanted, reason, at: Date.now(), certain: "sent", refused: null });
  }

  /** Handles a new connection: a stop that was not delivered is sent again. */
  connected(): void {
    const { last } = this;
    if (last && this.isResending(Date.now()))
      this.send({ ...last, certain: "sent", refused: null });
  }

  /** Handles the loss of the connection: progress is no longer reported. */
  disconnected(): void {
    if (!this.open) this.last = null;
  }

  /** Handles the report that all axes were stopped. */
  locked(): void {
    if (this.last?.axes === null) this.end({ certain: "accepted" });
  }

  /** Handles the progress of axes. */
  reached(axes: AxisStopReport[]): void {
    const wanted = this.last?.axes;
    if (!wanted) return;
    for (const axis of axes) this.reported.add(axis.id);
    if (wanted.every((id) => this.reported.has(id))) this.end({ certain: "accepted" });
  }

  /** Removes the last stop at the user's request. */
  dismiss(): void {
    this.last = null;
  }

  private send(stop: RequestedStop): void {
    const time = ++this.times;
    const { axes, reason } = stop;
    this.last = stop;
    this.reported.clear();
    const sent = this.transport.live(axes, reason);
    if (sent) setTimeout(() => this.waits(time) && this.post(time, true), AGAIN_MS);
    else this.post(time, false);
    setTimeout(() => this.waits(time) && this.end({ certain: "unanswered" }), UNANSWERED_MS);
  }

  /** Sends by HTTP, after the WebSocket or in its place. */
  private post(time: number, sent: boolean): void {
    const { last } = this;
    if (!last) return;
    this.transport.post(last.axes, last.reason).then(
      (axes) => {
        if (time === this.times) this.end({ certain: "accepted" });
        this.transport.reached(axes);
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
    return time === this.times && this.last?.certain === "sent";
  }

  private end(what: Partial<RequestedStop>): void {
    if (!this.last || this.last.certain === what.certain) return;
    this.last = { ...this.last, ...what };
    this.transport.certain(this.last);
  }
}
