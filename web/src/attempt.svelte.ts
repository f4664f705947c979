// Requests to the gateway, and how the page shows that one is under way or was refused.

import type { GatewayError } from "./live/message";
import { Problem } from "./live/rest";
import { refusal } from "./words.svelte";

/** Requests of one place of the page: whether one is under way, and why the last one was refused. */
export class Attempt {
  busy = $state(false);
  /** The refusal in the language of the page; `null` without one. */
  refused = $state.raw<GatewayError | null>(null);

  /**
   * A request that a person started: an older refusal disappears at once.
   * The answer, or `null` if the request was refused. Errors of the page itself are thrown.
   */
  run<T>(request: Promise<T>): Promise<T | null> {
    this.refused = null;
    return this.poll(request);
  }

  /** As `run`, for requests that repeat: a refusal stays until one succeeds, so it does not flicker. */
  async poll<T>(request: Promise<T>): Promise<T | null> {
    this.busy = true;
    try {
      const answer = await request;
      this.refused = null;
      return answer;
    } catch (problem) {
      if (!(problem instanceof Problem)) throw problem;
      this.refused = refusal(problem.refused);
      return null;
    } finally {
      this.busy = false;
    }
  }
}
