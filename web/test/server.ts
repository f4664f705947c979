// A real server on a rack of simulated drives, and a browser that was let in.

import { type ChildProcess, spawn } from "node:child_process";
import { randomBytes } from "node:crypto";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { createInterface } from "node:readline";
import { Program } from "./program";

export const ROOT = resolve(import.meta.dirname, "../..");
const POLEPAIR = process.env.POLEPAIR ?? join(ROOT, "target/release/polepair");
const SCOPES = "read,stop,move,configure";

export class Server {
  private constructor(
    private readonly process: ChildProcess,
    private readonly folder: string,
    /** Lets one browser in, once. */
    readonly url: string,
    /** What a program does that may send raw requests as well. */
    readonly program: Program,
  ) {}

  static async start(...links: string[]): Promise<Server> {
    const folder = mkdtempSync(join(tmpdir(), "polepair-page-"));
    const [operator, program] = [randomBytes(32).toString("hex"), randomBytes(32).toString("hex")];
    const tokens = `${operator} ${SCOPES} operator\n${program} ${SCOPES},raw program\n`;
    writeFileSync(join(folder, "tokens"), tokens, { mode: 0o600 });
    const bind = ["serve", "--bind", "127.0.0.1:0", "--scopes", `${SCOPES},raw`];
    const child = spawn(POLEPAIR, [...bind, "--state", folder, "--log", "off", ...links], {
      cwd: ROOT,
      stdio: ["ignore", "pipe", "inherit"],
    });
    try {
      const url = await ready(child);
      return new Server(child, folder, url, new Program(new URL(url).origin, program));
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
