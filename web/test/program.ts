// A program beside the browser: it asks the server by REST with a token of its own.

export class Program {
  constructor(
    private readonly base: string,
    private readonly token: string,
  ) {}

  get<T>(path: string): Promise<T> {
    return this.ask<T>(path, { method: "GET" });
  }

  post<T>(path: string, body: unknown): Promise<T> {
    return this.ask<T>(path, { method: "POST", body: JSON.stringify(body) });
  }

  private async ask<T>(path: string, request: RequestInit): Promise<T> {
    const headers = {
      Authorization: `Bearer ${this.token}`,
      "Content-Type": "application/json",
      "X-Polepair": "1",
    };
    const answer = await fetch(`${this.base}/api/v1${path}`, { ...request, headers });
    const text = await answer.text();
    if (!answer.ok) throw new Error(`${request.method} ${path}: ${answer.status} ${text}`);
    return (text ? JSON.parse(text) : null) as T;
  }
}

/** A record of the server's journal. */
export interface Kept {
  deed: string;
  axis: number | null;
  who: string;
  detail: Record<string, unknown>;
}

/** An axis that a program has taken, for as long as it is not let go. */
export class Held {
  private readonly renewing: NodeJS.Timeout;
  private count = 0;

  private constructor(
    private readonly program: Program,
    readonly axis: number,
    private readonly epoch: number,
  ) {
    this.renewing = setInterval(() => {
      // One that is late is said by whatever is commanded next.
      program.post(`/axes/${axis}/lease/renew`, { epoch }).catch(() => {});
    }, 400);
  }

  static async take(program: Program, axis: number): Promise<Held> {
    const { epoch } = await program.post<{ epoch: number }>(`/axes/${axis}/lease`, {});
    return new Held(program, axis, epoch);
  }

  /** Nothing is given back: what moves stops when the lease ends by itself. */
  letGo(): void {
    clearInterval(this.renewing);
  }

  raw(text: string): Promise<void> {
    return this.say("raw", { text });
  }

  command(verb: string, args: Record<string, number> = {}): Promise<void> {
    return this.say("commands", { verb, arguments: args });
  }

  write(name: string, value: number): Promise<unknown> {
    const body = { values: { [name]: value }, epoch: this.epoch };
    return this.program.post(`/axes/${this.axis}/parameters`, body);
  }

  private async say(where: string, what: object): Promise<void> {
    const order = {
      ...what,
      id: `program-${this.axis}-${this.epoch}-${this.count++}`,
      issued_ms: Date.now(),
      ttl_ms: 5000,
      epoch: this.epoch,
    };
    const path = `/axes/${this.axis}/${where}`;
    const { outcome, error } = await this.program.post<{ outcome: string; error: unknown }>(
      path,
      order,
    );
    if (outcome !== "done") throw new Error(`${JSON.stringify(what)}: ${JSON.stringify(error)}`);
  }
}
