// A real server on a rack of simulated drives, and a browser that was let in.

import { type ChildProcess, spawn } from "node:child_process";
import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { createInterface } from "node:readline";

export const ROOT = resolve(import.meta.dirname, "../..");
const POLEPAIR = process.env.POLEPAIR ?? join(ROOT, "target/release/polepair");

export class Server {
  private constructor(
    private readonly process: ChildProcess,
    private readonly folder: string,
    /** Lets one browser in, once. */
    readonly url: string,
  ) {}

  static async start(...links: string[]): Promise<Server> {
    const folder = mkdtempSync(join(tmpdir(), "polepair-page-"));
    const bind = ["serve", "--bind", "127.0.0.1:0", "--state", folder, "--log", "off"];
    const child = spawn(POLEPAIR, [...bind, ...links], {
      cwd: ROOT,
      stdio: ["ignore", "pipe", "inherit"],
    });
    try {
      return new Server(child, folder, await ready(child));
    } catch (problem) {
      child.kill();
      throw problem;
    }
  }

  /** Keeps it from doing anything, or lets it go on. */
  freeze(frozen: boolean): void {
    this.process.kill(frozen ? "SIGSTOP" : "SIGCONT");
  }

  stop(): void {
    this.freeze(false);
    this.process.kill("SIGINT");
    this.process.once("exit", () => rmSync(this.folder, { recursive: true, force: true }));
  }
}

async function ready(child: ChildProcess): Promise<string> {
  const gone = new Promise<never>((_, reject) => {
    child.once("error", reject);
    child.once("exit", (code) => reject(new Error(`polepair serve ended with ${code}`)));
  });
  const told = (async () => {
    if (!child.stdout) throw new Error("no stdout");
    for await (const line of createInterface(child.stdout)) {
      const [, url] = /^ready (http\S+)$/.exec(line) ?? [];
      if (url) return url;
    }
    throw new Error("polepair serve said nothing");
  })();
  gone.catch(() => {});
  return Promise.race([told, gone]);
}
