// Answers that do not arrive whole, from a real server.

import { createServer, type ServerResponse } from "node:http";
import type { AddressInfo } from "node:net";
import { afterEach, expect, it, vi } from "vitest";
import { Problem, send, UNANSWERED } from "./rest";

const { fetch } = globalThis;
const ended: (() => void)[] = [];

afterEach(() => {
  for (const end of ended.splice(0)) end();
  vi.unstubAllGlobals();
});

/** Requests of the page go to a server that answers so. */
async function serve(answer: (to: ServerResponse) => void): Promise<void> {
  const server = createServer((_, to) => answer(to));
  await new Promise<void>((listens) => server.listen(0, "127.0.0.1", listens));
  ended.push(() => {
    server.close();
    server.closeAllConnections();
  });
  const { port } = server.address() as AddressInfo;
  vi.stubGlobal("fetch", (path: string, request: RequestInit) =>
    fetch(`http://127.0.0.1:${port}${path}`, request),
  );
}

async function problem(ms?: number): Promise<Problem> {
  const reason: unknown = await send("POST", "/stop", {}, ms).then(
    (value) => value,
    (reason: unknown) => reason,
  );
  if (!(reason instanceof Problem)) throw new Error(`no problem, but ${String(reason)}`);
  return reason;
}

/** The head of an answer and the beginning of its body. */
function begin(to: ServerResponse): void {
  to.writeHead(200, { "Content-Length": "100" });
  to.write('{"axes":[');
}

it("treats an incomplete answer as none", async () => {
  await serve((to) => {
    begin(to);
    setTimeout(() => to.destroy(), 20);
  });
  expect((await problem()).refused.code).toBe(UNANSWERED);
});

it("treats an answer whose end is late as none", async () => {
  await serve(begin);
  const { status, refused } = await problem(200);
  expect([status, refused.code]).toEqual([0, UNANSWERED]);
});

it("refuses an answer that is no JSON, but accepts one without a body", async () => {
  await serve((to) => to.end("<html>"));
  expect((await problem()).refused.code).toBe("page.unexpected");
  await serve((to) => to.end());
  expect(await send("DELETE", "/session", {})).toBeUndefined();
});
