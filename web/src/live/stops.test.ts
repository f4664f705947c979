import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import type { AxisStopReport, GatewayError } from "./message";
import { Problem, UNANSWERED } from "./rest";
import { type SaidStop, Stops, type Ways } from "./stops.svelte";

const refusal = (code: string): GatewayError => ({ code, message: "", hint: "", executed: null });
const unreachable = (): Problem => new Problem(0, refusal("page.unreachable"));
const standing = (id: number): AxisStopReport => ({ id, class: "standing", ms: 1, error: null });

/** A server and the ways to it. */
class World implements Ways {
  connected = true;
  /** What HTTP comes to; null hangs. */
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

  certain({ certain }: SaidStop): void {
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
  it("is taken when the server says so, and is not said twice then", async () => {
    stops.say(null, "button");
    expect(stops.said?.certain).toBe("said");
    stops.locked();
    await pass(100_000);
    expect(stops.said?.certain).toBe("taken");
    expect([world.lives, world.posts]).toEqual([[null], []]);
  });

  it("is said over HTTP where the WebSocket does not confirm it, and taken by that", async () => {
    world.http = () => [standing(3)];
    stops.say(null, "button");
    await pass(249);
    expect(world.posts).toEqual([]);
    await pass(1);
    expect(world.posts).toEqual([null]);
    expect(stops.said?.certain).toBe("taken");
    expect(world.told).toEqual([standing(3)]);
  });

  it("did not get through where there is no server, which is said at once", async () => {
    world.die();
    stops.say(null, "button");
    await pass(0);
    expect(stops.said?.certain).toBe("not_sent");
    await pass(100_000);
    expect(stops.said?.certain).toBe("not_sent");
    expect(world.ends).toEqual(["not_sent"]);
  });

  it("is unanswered, and not on its way for ever, where the server hangs", async () => {
    world.http = null;
    stops.say(null, "button");
    await pass(1499);
    expect(stops.said?.certain).toBe("said");
    await pass(1);
    expect(stops.said?.certain).toBe("unanswered");
    // It may still be taken.
    stops.locked();
    expect(stops.said?.certain).toBe("taken");
  });

  it("may have left where nobody answers it, by whichever way it went", async () => {
    world.connected = false;
    world.http = () => {
      throw new Problem(0, refusal(UNANSWERED));
    };
    stops.say(null, "button");
    await pass(0);
    expect(stops.said?.certain).toBe("unanswered");
  });

  it("may have left where the connection ended behind it", async () => {
    world.http = () => {
      throw unreachable();
    };
    stops.say(null, "button");
    await pass(250);
    expect(stops.said?.certain).toBe("unanswered");
  });

  it("is refused where the page is not logged in", async () => {
    world.connected = false;
    world.http = () => {
      throw new Problem(401, refusal("gateway.token"));
    };
    stops.say(null, "button");
    await pass(0);
    expect(stops.said).toMatchObject({ certain: "refused", refused: { code: "gateway.token" } });
  });

  it("is said again when there is a connection, while whoever said it still waits", async () => {
    world.die();
    stops.say(null, "button");
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

  it("is not said by itself long after, nor when it was dismissed", async () => {
    world.die();
    stops.say(null, "button");
    await pass(60_000);
    world.connected = true;
    stops.connected();
    expect(world.lives).toEqual([]);
    expect(stops.said?.certain).toBe("not_sent");
    world.die();
    stops.say(null, "button");
    stops.dismiss();
    world.connected = true;
    stops.connected();
    await pass(1000);
    expect(world.lives).toEqual([]);
    expect(stops.said).toBeNull();
  });

  it("of some axes is taken when each was told of", async () => {
    world.http = null;
    stops.say([1, 2], "button");
    stops.reached([standing(1), standing(7)]);
    expect(stops.said?.certain).toBe("said");
    stops.locked();
    expect(stops.said?.certain).toBe("said");
    stops.reached([standing(2)]);
    expect(stops.said?.certain).toBe("taken");
  });

  it("takes along what has not got through, and nothing else", async () => {
    world.die();
    stops.say([1], "button");
    stops.say([2, 1], "button");
    expect(stops.said?.axes).toEqual([1, 2]);
    stops.say(null, "Esc");
    stops.say([4], "button");
    expect(stops.said?.axes).toBeNull();
    world.connected = true;
    stops.connected();
    stops.locked();
    stops.say([4], "button");
    expect(stops.said?.axes).toEqual([4]);
  });

  it("is not judged by what came of an earlier time", async () => {
    let fail: (problem: Problem) => void = () => {};
    world.connected = false;
    world.post = () => new Promise((_, reject) => (fail = reject));
    stops.say(null, "button");
    const first = fail;
    world.connected = true;
    stops.say(null, "button");
    first(unreachable());
    await pass(0);
    expect(stops.said?.certain).toBe("said");
  });

  it("that was taken is forgotten with the connection: nobody tells of it any more", () => {
    stops.say(null, "button");
    stops.locked();
    stops.disconnected();
    expect(stops.said).toBeNull();
    world.die();
    stops.say(null, "button");
    stops.disconnected();
    expect(stops.said).not.toBeNull();
  });
});
