// The server's clock as this page knows it: commands carry the server's time, so that one which was
// held up on its way is refused instead of moving a motor late.

const KEPT = 8;

interface Sample {
  offset: number;
  round: number;
}

export class Clock {
  private samples: Sample[] = [];

  /** A ping that left and came back at the page's times, and the server's time between them. */
  pong(sent: number, server: number, received: number): void {
    const round = received - sent;
    if (!(round >= 0)) return;
    this.samples.push({ offset: server - (sent + received) / 2, round });
    if (this.samples.length > KEPT) this.samples.shift();
  }

  /** A first guess, before any round trip was measured. */
  guess(server: number, received: number): void {
    this.samples = [{ offset: server - received, round: Number.MAX_VALUE }];
  }

  /** Offset to add to the page's clock, from the quickest round trip, which is the least uncertain. */
  get offset(): number {
    return this.best?.offset ?? 0;
  }

  /** The quickest round trip in ms, or null before the first. */
  get round(): number | null {
    const best = this.best;
    return best && best.round < Number.MAX_VALUE ? best.round : null;
  }

  private get best(): Sample | undefined {
    return this.samples.reduce<Sample | undefined>(
      (best, each) => (best && best.round <= each.round ? best : each),
      undefined,
    );
  }
}
