// The WebSocket, which reconnects by itself. Messages of an earlier connection are not repeated: callers
// that need it do it on `open`.

import { Clock } from "./clock";
import type { ClientMessage, ServerMessage } from "./message";
import { type Block, decode } from "./telemetry";

const PROTOCOL = "polepair.v1";
const AGAIN_MS = [250, 500, 1000, 2000, 4000];
const PING_MS = 2000;
/** The server answers pings at once: after so long without a word the connection is dead. */
const SILENT_MS = 7000;

export interface Listener {
  opened(): void;
  closed(): void;
  message(message: ServerMessage): void;
  telemetry(block: Block): void;
}

export class Socket {
  readonly clock = new Clock();
  /** When the server last said something, by this page's clock, ms. */
  heard = 0;
  private socket: WebSocket | null = null;
  private tries = 0;
  private pinging = 0;
  private ended = false;

  constructor(private readonly listener: Listener) {}

  open(): void {
    this.ended = false;
    const url = new URL("/api/v1/live", location.href);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(url, PROTOCOL);
    this.socket = socket;
    socket.binaryType = "arraybuffer";
    socket.onopen = () => this.opened();
    socket.onmessage = (event) => {
      if (this.socket === socket) this.received(event.data);
    };
    socket.onclose = () => this.closed(socket);
  }

  /** Ends it for good. */
  close(): void {
    this.ended = true;
    this.socket?.close();
  }

  /** Opens it now, instead of at the next try. */
  retry(): void {
    this.tries = 0;
    if (!this.socket) this.open();
  }

  get usable(): boolean {
    return this.socket?.readyState === WebSocket.OPEN;
  }

  /** False where there is no connection: then nothing was sent, and nothing will be. */
  send(message: ClientMessage): boolean {
    if (!this.usable) return false;
    this.socket?.send(JSON.stringify(message));
    return true;
  }

  /** The server's time in ms. */
  now(): number {
    return Date.now() + this.clock.offset;
  }

  private opened(): void {
    this.tries = 0;
    this.heard = Date.now();
    this.pinging = window.setInterval(() => this.ping(), PING_MS);
    this.listener.opened();
    this.ping();
  }

  private ping(): void {
    if (Date.now() - this.heard > SILENT_MS && document.visibilityState === "visible") {
      const { socket } = this;
      socket?.close();
      // A server that hangs does not answer the farewell either: it is not waited for.
      if (socket) this.closed(socket);
      return;
    }
    this.send({ type: "ping", client_ms: Date.now() });
  }

  private received(data: unknown): void {
    this.heard = Date.now();
    if (data instanceof ArrayBuffer) {
      const block = decode(data);
      if (block) this.listener.telemetry(block);
      return;
    }
    if (typeof data !== "string") return;
    const message = JSON.parse(data) as ServerMessage;
    if (message.type === "welcome") this.clock.guess(message.server_ms, this.heard);
    if (message.type === "pong") this.clock.pong(message.client_ms, message.server_ms, this.heard);
    else this.listener.message(message);
  }

  private closed(socket: WebSocket): void {
    if (this.socket !== socket) return;
    this.socket = null;
    window.clearInterval(this.pinging);
    this.listener.closed();
    if (this.ended) return;
    const wait = AGAIN_MS[Math.min(this.tries++, AGAIN_MS.length - 1)] ?? 0;
    window.setTimeout(() => {
      if (!this.socket && !this.ended) this.open();
    }, wait);
  }
}
