// The picture as a file: what the canvas shows, with the channels' names and values below.

import { digits } from "../units";
import type { Line } from "./ChannelList.svelte";

const ROW = 18;

export function png(
  picture: HTMLCanvasElement,
  lines: Line[],
  host: HTMLElement,
): Promise<Blob | null> {
  const ratio = devicePixelRatio || 1;
  const canvas = document.createElement("canvas");
  canvas.width = picture.width;
  canvas.height = picture.height + (lines.length + 1) * ROW * ratio;
  const ctx = canvas.getContext("2d");
  if (!ctx) return Promise.resolve(null);
  const style = getComputedStyle(host.closest(".panel") ?? host);
  ctx.fillStyle = style.backgroundColor;
  ctx.fillRect(0, 0, canvas.width, canvas.height);
  ctx.drawImage(picture, 0, 0);
  ctx.font = `${12 * ratio}px system-ui, sans-serif`;
  lines.forEach((line, i) => {
    const y = picture.height + (i + 1) * ROW * ratio;
    ctx.fillStyle = line.colour;
    ctx.fillRect(10 * ratio, y - 5 * ratio, 18 * ratio, 3 * ratio);
    ctx.fillStyle = style.color;
    const range = `${digits(line.min)} … ${digits(line.max)} ${line.unit}`;
    ctx.fillText(
      `${line.axis} ${line.signal}   ${range}   ${line.rate.toFixed(0)} Hz`,
      36 * ratio,
      y,
    );
  });
  return new Promise((settle) => canvas.toBlob(settle, "image/png"));
}
