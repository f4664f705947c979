// Requests over HTTP: what is asked once. The cookie goes along by itself; the header says that the
// request comes from this page's own code.

import type { GatewayError } from "./message";

const BASE = "/api/v1";
/** The code of a request that may have been sent, and was not answered in time. */
export const UNANSWERED = "page.unanswered";

/** The server's own refusal, or that it could not be asked. */
export class Problem extends Error {
  constructor(
    readonly status: number,
    readonly refused: GatewayError,
  ) {
    super(refused.message);
  }
}

export function read<T>(path: string): Promise<T> {
  return ask<T>(path, { method: "GET" });
}

/** Asks once. With `ms` it waits for so long, then the code is `UNANSWERED`. */
export function send<T>(
  method: "POST" | "DELETE",
  path: string,
  body: unknown,
  ms?: number,
): Promise<T> {
  return ask<T>(path, {
    method,
    headers: { "Content-Type": "application/json", "X-Polepair": "1" },
    body: JSON.stringify(body),
    ...(ms === undefined ? {} : { signal: AbortSignal.timeout(ms) }),
  });
}

/** A file as it is. */
export function upload<T>(path: string, file: Blob): Promise<T> {
  const headers = { "Content-Type": "application/octet-stream", "X-Polepair": "1" };
  return ask<T>(path, { method: "POST", headers, body: file });
}

async function ask<T>(path: string, request: RequestInit): Promise<T> {
  let answer: Response;
  try {
    answer = await fetch(BASE + path, { ...request, credentials: "same-origin" });
  } catch (problem) {
    const late = problem instanceof DOMException && problem.name === "TimeoutError";
    throw new Problem(0, nobody(late ? UNANSWERED : "page.unreachable"));
  }
  const text = await answer.text().catch(() => null);
  // The answer broke off or came too late: what was asked for may have been done.
  if (answer.ok && text === null) throw new Problem(0, nobody(UNANSWERED));
  const body = parse(text ?? "");
  if (answer.ok && (body !== undefined || text === "")) return body as T;
  throw new Problem(answer.status, refusal(body) ?? unexpected(answer.status));
}

/** The value of a JSON text; `undefined` when it is none. */
function parse(text: string): unknown {
  try {
    return JSON.parse(text);
  } catch {
    return undefined;
  }
}

function refusal(body: unknown): GatewayError | null {
  const error = (body as { error?: Partial<GatewayError> } | null | undefined)?.error;
  if (typeof error?.message !== "string") return null;
  const { code = "", message, hint = "", executed = null } = error;
  return { code, message, hint, executed };
}

function nobody(code: string): GatewayError {
  return { code, message: "", hint: "", executed: null };
}

function unexpected(status: number): GatewayError {
  return { code: "page.unexpected", message: `HTTP ${status}`, hint: "", executed: null };
}
