// A real server on a rack of simulated drives, and a browser that was let in.

import { type ChildProcess, execFileSync, spawn } from "node:child_process";
import { randomBytes } from "node:crypto";
import { once } from "node:events";
import { mkdtempSync, readdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { createInterface } from "node:readline";
import { Program } from "./program";

export const ROOT = resolve(import.meta.dirname, "../..");
const POLEPAIR = join(ROOT, "target", process.env.POLEPAIR_BUILD ?? "debug", "polepair");
const SCOPES = "read,stop,move,configure";

export class Server {
  private constructor(
    private process: ChildProcess,
    private readonly folder: string,
    private readonly links: string[],
    /** Lets one browser in, once. */
    readonly url: string,
    /** The operator's. */
    readonly token: string,
    /** What a program does that may send raw requests as well. */
    readonly program: Program,
  ) {}

  static async start(...links: string[]): Promise<Server> {
    const folder = mkdtempSync(join(tmpdir(), "polepair-page-"));
    const [operator, program] = [randomBytes(32).toString("hex"), randomBytes(32).toString("hex")];
    const tokens = `${operator} ${SCOPES} operator\n${program} ${SCOPES},raw program\n`;
    writeFileSync(join(folder, "tokens"), tokens, { mode: 0o600 });
    const { child, url } = await serve("127.0.0.1:0", folder, links);
    const asks = new Program(new URL(url).origin, program);
    return new Server(child, folder, links, url, operator, asks);
  }

  /** Suspends the process. Returns when every thread of it is suspended: on a busy machine that takes
   *  a while after the signal, and until then it still answers. */
  async freeze(): Promise<void> {
    this.process.kill("SIGSTOP");
    const tasks = `/proc/${this.process.pid}/task`;
    const state = (task: string): string | undefined =>
      /\) (\w)/.exec(readFileSync(`${tasks}/${task}/stat`, "latin1"))?.[1];
    while (!readdirSync(tasks).every((task) => state(task) === "T"))
      await new Promise((resolve) => setTimeout(resolve, 5));
  }

  /** Lets a suspended process go on. */
  resume(): void {
    this.process.kill("SIGCONT");
  }

  /** It dies, and stops nothing. */
  async crash(): Promise<void> {
    if (this.ended) return;
    const gone = once(this.process, "exit");
    this.process.kill("SIGKILL");
    await gone;
  }

  /** It is started again, at the same place; it may know no more who is logged in. */
  async again({ forgets = false } = {}): Promise<void> {
    if (forgets) rmSync(join(this.folder, "sessions"), { force: true });
    this.process = (await serve(new URL(this.url).host, this.folder, this.links)).child;
  }

  stop(): void {
    this.resume();
    this.process.kill("SIGINT");
    const tidy = (): void => rmSync(this.folder, { recursive: true, force: true });
    if (this.ended) tidy();
    else this.process.once("exit", tidy);
  }

  private get ended(): boolean {
    return this.process.exitCode !== null || this.process.signalCode !== null;
  }
}

async function serve(
  bind: string,
  folder: string,
  links: string[],
): Promise<{ child: ChildProcess; url: string }> {
  const options = ["--bind", bind, "--scopes", `${SCOPES},raw`, "--state", folder, "--log", "off"];
  const child = spawn(POLEPAIR, ["serve", ...options, ...links], {
    cwd: ROOT,
    stdio: ["ignore", "pipe", "inherit"],
  });
  try {
    return { child, url: await ready(child) };
  } catch (problem) {
    child.kill();
    throw problem;
  }
}

/** One run of the command line. */
export function polepair(...words: string[]): string {
  return execFileSync(POLEPAIR, words, { encoding: "utf8", stdio: ["ignore", "pipe", "pipe"] });
}

/** Simulated drives in a process of their own, on TCP unless another place is given. */
export class Drive {
  private constructor(
    private readonly process: ChildProcess,
    /** Reaches them. */
    readonly url: string,
  ) {}

  static async start(words: string, ...place: string[]): Promise<Drive> {
    const where = place.length ? place : ["--tcp", "127.0.0.1:0"];
    const child = spawn(POLEPAIR, ["sim", words, ...where], {
      stdio: ["ignore", "pipe", "inherit"],
    });
    return new Drive(child, await ready(child));
  }

  /** It is taken away for good. */
  async takeAway(): Promise<void> {
    if (this.process.exitCode !== null || this.process.signalCode !== null) return;
    const gone = once(this.process, "exit");
    this.process.kill("SIGKILL");
    await gone;
  }
}

async function ready(child: ChildProcess): Promise<string> {
  const gone = new Promise<never>((_, reject) => {
    child.once("error", reject);
    child.once("exit", (code) => reject(new Error(`polepair ended with ${code}`)));
  });
  const told = (async () => {
    if (!child.stdout) throw new Error("no stdout");
    for await (const line of createInterface(child.stdout)) {
      const [, url] = /^ready (\S+)$/.exec(line) ?? [];
      if (url) return url;
    }
    throw new Error("polepair said nothing");
  })();
  gone.catch(() => {});
  return Promise.race([told, gone]);
}
