// Telemetry as it comes over the WebSocket: one little-endian block a message.

const KIND = 1;
const VERSION = 1;
const HEADER = 24;
const SAMPLE = 12;

export interface Block {
  channel: number;
  /** Samples that this channel lost since it was subscribed. */
  lost: number;
  /** Seconds since the server's start. */
  times: Float64Array;
  values: Float64Array;
}

/** The samples of one message, or null where it is no telemetry of a version that we know. */
export function decode(buffer: ArrayBuffer): Block | null {
  if (buffer.byteLength < HEADER) return null;
  const view = new DataView(buffer);
  if (view.getUint8(0) !== KIND || view.getUint8(1) !== VERSION) return null;
  const count = view.getUint32(4, true);
  if (buffer.byteLength !== HEADER + count * SAMPLE) return null;
  const start = Number(view.getBigUint64(8, true));
  const times = new Float64Array(count);
  const values = new Float64Array(count);
  for (let i = 0, at = HEADER; i < count; i++, at += SAMPLE) {
    times[i] = (start + view.getUint32(at, true)) / 1e6;
    values[i] = view.getFloat64(at + 4, true);
  }
  const lost = Number(view.getBigUint64(16, true));
  return { channel: view.getUint16(2, true), lost, times, values };
}
