import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import type { AxisStopReport, GatewayError } from "./message";
import { Problem, UNANSWERED } from "./rest";
import { type RequestedStop, Stops, type StopTransport } from "./stops.svelte";

const refusal = (code: string): GatewayError => ({ code, message: "", hint: "", executed: null });
const unreachable = (): Problem => new Problem(0, refusal("page.unreachable"));
const standing = (id: number): AxisStopReport => ({ id, class: "standing", ms: 1, error: null });

/** A server and the ways to it. */
class World implements StopTransport {
  connected = true;
  /** Result of HTTP requests; null hangs. */
  http: (() => AxisStopReport[]) | null = () => [];
  lives: (number[] | null)[] = [];
  posts: (number[] | null)[] = [];
  told: AxisStopReport[] = [];
  ends: string[] = [];

  live(axes: number[] | null): boolean {
    if (this.connected) this.lives.push(axes);
    return this.connected;
  }

  async post(axes: number[] | null): Promise<AxisStopReport[]> {
    this.posts.push(axes);
    return this.http ? this.http() : new Promise(() => {});
  }

  reached(axes: AxisStopReport[]): void {
    this.told.push(...axes);
  }

  certain({ certain }: RequestedStop): void {
    this.ends.push(certain);
  }

  /** There is no server. */
  die(): void {
    this.connected = false;
    this.http = () => {
      throw unreachable();
    };
  }
}

let world: World;
let stops: Stops;
const pass = (ms: number): Promise<unknown> => vi.advanceTimersByTimeAsync(ms);

beforeEach(() => {
  vi.useFakeTimers();
  world = new World();
  stops = new Stops(world);
});
afterEach(() => vi.useRealTimers());

describe("a stop of this page", () => {
  it("is accepted when the server confirms it, and is not sent twice", async () => {
    stops.request(null, "button");
    expect(stops.last?.certain).toBe("sent");
    stops.locked();
    await pass(100_000);
    expect(stops.last?.certain).toBe("accepted");
    expect([world.lives, world.posts]).toEqual([[null], []]);
  });

  it("is sent over HTTP if the WebSocket does not confirm it, and accepted there", async () => {
    world.http = () => [standing(3)];
    stops.request(null, "button");
    await pass(249);
    expect(world.posts).toEqual([]);
    await pass(1);
    expect(world.posts).toEqual([null]);
    expect(stops.last?.certain).toBe("accepted");
    expect(world.told).toEqual([standing(3)]);
  });

  it("is reported as not sent at once without a server", async () => {
    world.die();
    stops.request(null, "button");
    await pass(0);
    expect(stops.last?.certain).toBe("not_sent");
    await pass(100_000);
    expect(stops.last?.certain).toBe("not_sent");
    expect(world.ends).toEqual(["not_sent"]);
  });

  it("becomes unanswered if the server hangs", async () => {
    world.http = null;
    stops.request(null, "button");
    await pass(1499);
    expect(stops.last?.certain).toBe("sent");
    await pass(1);
    expect(stops.last?.certain).toBe("unanswered");
    // It may still be taken.
    stops.locked();
    expect(stops.last?.certain).toBe("accepted");
  });

  it("may have been sent if no answer comes, over either connection", async () => {
    world.connected = false;
    world.http = () => {
      throw new Problem(0, refusal(UNANSWERED));
    };
    stops.request(null, "button");
    await pass(0);
    expect(stops.last?.certain).toBe("unanswered");
  });

  it("may have been sent if the connection ended after it", async () => {
    world.http = () => {
      throw unreachable();
    };
    stops.request(null, "button");
    await pass(250);
    expect(stops.last?.certain).toBe("unanswered");
  });

  it("is refused if the page is not logged in", async () => {
    world.connected = false;
    world.http = () => {
      throw new Problem(401, refusal("gateway.token"));
    };
    stops.request(null, "button");
    await pass(0);
    expect(stops.last).toMatchObject({ certain: "refused", refused: { code: "gateway.token" } });
  });

  it("is sent again with a new connection while the user waits", async () => {
    world.die();
    stops.request(null, "button");
    await pass(59_000);
    expect(stops.isResending(Date.now())).toBe(true);
    world.connected = true;
    stops.connected();
    expect(world.lives).toEqual([null]);
    stops.locked();
    stops.connected();
    expect(world.lives).toEqual([null]);
    expect(stops.isResending(Date.now())).toBe(false);
  });

  it("is not sent again long after, nor after it was dismissed", async () => {
    world.die();
    stops.request(null, "button");
    await pass(60_000);
    world.connected = true;
    stops.connected();
    expect(world.lives).toEqual([]);
    expect(stops.last?.certain).toBe("not_sent");
    world.die();
    stops.request(null, "button");
    stops.dismiss();
    world.connected = true;
    stops.connected();
    await pass(1000);
    expect(world.lives).toEqual([]);
    expect(stops.last).toBeNull();
  });

  it("of some axes is accepted when each is confirmed", async () => {
    world.http = null;
    stops.request([1, 2], "button");
    stops.reached([standing(1), standing(7)]);
    expect(stops.last?.certain).toBe("sent");
    stops.locked();
    expect(stops.last?.certain).toBe("sent");
    stops.reached([standing(2)]);
    expect(stops.last?.certain).toBe("accepted");
  });

  it("repeats the unconfirmed stops, and nothing else", async () => {
    world.die();
    stops.request([1], "button");
    stops.request([2, 1], "button");
    expect(stops.last?.axes).toEqual([1, 2]);
    stops.request(null, "Esc");
    stops.request([4], "button");
    expect(stops.last?.axes).toBeNull();
    world.connected = true;
    stops.connected();
    stops.locked();
    stops.request([4], "button");
    expect(stops.last?.axes).toEqual([4]);
  });

  it("is not judged by the result of an earlier one", async () => {
    let fail: (problem: Problem) => void = () => {};
    world.connected = false;
    world.post = () => new Promise((_, reject) => (fail = reject));
    stops.request(null, "button");
    const first = fail;
    world.connected = true;
    stops.request(null, "button");
    first(unreachable());
    await pass(0);
    expect(stops.last?.certain).toBe("sent");
  });

  it("that was accepted is forgotten with the connection", () => {
    stops.request(null, "button");
    stops.locked();
    stops.disconnected();
    expect(stops.last).toBeNull();
    world.die();
    stops.request(null, "button");
    stops.disconnected();
    expect(stops.last).not.toBeNull();
  });
});
