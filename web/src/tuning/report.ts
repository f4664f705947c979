// A report in one HTML file: pictures as SVG, nothing loaded from anywhere, no script.

import { colour } from "../colours";
import { digits } from "../units";
import type { Course } from "./command";
import { isMeasurable, milliseconds, rounded, TOLERANCE, type Timed } from "./metrics";
import type { Run } from "./runs.svelte";

export interface Words {
  title: string;
  run: string;
  axis: string;
  step: string;
  rise: string;
  overshoot: string;
  settling: string;
  peak: string;
  remaining: string;
  rate: string;
  lost: string;
  note: string;
  /** Text for a time that is shorter than the distance of samples, both in milliseconds. */
  too_short: (time: string, interval: string) => string;
  /** Legend of the picture's dashed lines and bands. */
  legend: string;
}

const WIDTH = 900;
const HEIGHT = 380;
const EDGE = { left: 64, right: 12, top: 12, bottom: 34 };
const POINTS_MAX = 2000;
export function report(runs: Run[], words: Words, language: string): string {
  const signals = [...new Set(runs.map((run) => run.signal))];
  const pictures = signals.map((signal) => picture(runs.filter((run) => run.signal === signal)));
  return `<!doctype html>
<html lang="${escape(language)}"><head><meta charset="utf-8"><title>${escape(words.title)}</title>
<style>body{font:14px/1.5 system-ui,sans-serif;max-width:960px;margin:24px auto;padding:0 16px;color:#14202b}
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}td,th{border-bottom:1px solid #cfd7de;
padding:4px 8px;text-align:right}td:first-child,th:first-child,td:nth-child(2),th:nth-child(2){text-align:left}
svg{width:100%;height:auto;margin:12px 0}</style></head><body>
<h1>${escape(words.title)}</h1>
${pictures.join("\n")}
<p>${escape(words.legend)}</p>
${table(runs, words)}
</body></html>
`;
}

function table(runs: Run[], words: Words): string {
  const { run, axis, step, rise, overshoot, settling, peak, remaining, rate, lost, note } = words;
  const head = [run, axis, step, rise, overshoot, settling, peak, remaining, rate, lost, note];
  const rows = runs.map((each) => {
    const { metrics, shown } = each;
    const mark = `<span style="color:${colour(each.id - 1, false)}">&#9632;</span>`;
    const when = new Date(each.at).toISOString().slice(0, 19).replace("T", " ");
    const cells = [
      escape(`${each.axis} · ${each.drive} · ${each.signal}`),
      `${digits(each.from * shown.factor)} → ${digits(each.to * shown.factor)} ${escape(shown.unit)}`,
      escape(timed(metrics?.rise ?? null, words.too_short)),
      metrics ? `${(metrics.overshoot * 100).toFixed(1)} %` : "—",
      escape(timed(metrics?.settling ?? null, words.too_short)),
      escape(timed(metrics?.peak ?? null, words.too_short)),
      metrics ? `${digits(metrics.remaining * shown.factor)} ${escape(shown.unit)}` : "—",
      `${each.rate.toFixed(0)} Hz`,
      String(each.lost),
      escape(each.note),
    ];
    return `<tr><td>${mark} ${when}Z</td>${cells.map((cell) => `<td>${cell}</td>`).join("")}</tr>`;
  });
  const titles = head.map((each) => `<th>${escape(each)}</th>`).join("");
  return `<table><thead><tr>${titles}</tr></thead><tbody>${rows.join("\n")}</tbody></table>`;
}

/** Curves of one signal over one another, each in the colour that it has on the page. */
export function picture(runs: Run[]): string {
  const band = (run: Run): number => Math.abs(run.to - run.from) * TOLERANCE;
  const values = runs.flatMap((run) => [
    run.from,
    run.to - band(run),
    run.to + band(run),
    ...thin(run).map(([, value]) => value),
  ]);
  const times = runs.flatMap((run) => [0, run.times.at(-1) ?? 0]);
  const factor = runs[0]?.shown.factor ?? 1;
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const pad = (high - low || 1) * 0.06;
  const start = Math.min(...runs.map((run) => run.times[0] ?? 0));
  const end = Math.max(...times, start + 1e-3);
  const x = (time: number): string =>
    (EDGE.left + ((time - start) / (end - start)) * (WIDTH - EDGE.left - EDGE.right)).toFixed(1);
  const y = (value: number): string =>
    (
      HEIGHT -
      EDGE.bottom -
      ((value - low + pad) / (high - low + 2 * pad)) * (HEIGHT - EDGE.top - EDGE.bottom)
    ).toFixed(1);
  const lines = runs.map((run) => {
    const points = thin(run).map(([time, value]) => `${x(time)},${y(value)}`);
    const stroke = colour(run.id - 1, false);
    return `<polyline fill="none" stroke="${stroke}" stroke-width="1.6" points="${points.join(" ")}"/>`;
  });
  const bands = runs.map((run) => {
    const [top, bottom] = [y(run.to + band(run)), y(run.to - band(run))];
    const height = (Number(bottom) - Number(top)).toFixed(1);
    return `<rect x="${EDGE.left}" width="${WIDTH - EDGE.left - EDGE.right}" y="${top}" height="${height}" fill="#4f5e6c" opacity="0.12"/>`;
  });
  const courses = runs.map((run) => {
    const course = [[start, run.from], ...run.course, [end, run.to]] as Course;
    const points = course.map(([time, value]) => `${x(Math.min(time, end))},${y(value)}`);
    const stroke = colour(run.id - 1, false);
    return `<polyline fill="none" stroke="${stroke}" stroke-dasharray="5 4" points="${points.join(" ")}"/>`;
  });
  const scale = [0, 0.25, 0.5, 0.75, 1].map((share) => {
    const value = low + share * (high - low);
    const time = start + share * (end - start);
    return `<text x="${EDGE.left - 6}" y="${y(value)}" text-anchor="end">${digits(value * factor)}</text>
<text x="${x(time)}" y="${HEIGHT - 12}" text-anchor="middle">${Number(time.toFixed(4))} s</text>`;
  });
  const unit = escape(`${runs[0]?.signal ?? ""} ${runs[0]?.shown.unit ?? ""}`);
  return `<svg viewBox="0 0 ${WIDTH} ${HEIGHT}" role="img" aria-label="${unit}" font-family="system-ui" font-size="12">
<text x="${EDGE.left + 6}" y="${EDGE.top + 12}">${unit}</text>${[...new Set(bands)].join("")}${courses.join("")}${lines.join("")}${scale.join("")}</svg>`;
}

/** Few enough points for a file, the least and greatest of each piece among them. */
function thin(run: Run): [number, number][] {
  const count = run.times.length;
  const at = (i: number): [number, number] => [run.times[i] ?? 0, run.values[i] ?? 0];
  if (count <= POINTS_MAX) return Array.from({ length: count }, (_, i) => at(i));
  const points: [number, number][] = [];
  const pieces = POINTS_MAX / 2;
  for (let piece = 0; piece < pieces; piece++) {
    const from = Math.floor((piece * count) / pieces);
    const to = Math.floor(((piece + 1) * count) / pieces);
    let [least, greatest] = [from, from];
    for (let i = from; i < to; i++) {
      if ((run.values[i] ?? 0) < (run.values[least] ?? 0)) least = i;
      if ((run.values[i] ?? 0) > (run.values[greatest] ?? 0)) greatest = i;
    }
    points.push(at(Math.min(least, greatest)));
    if (least !== greatest) points.push(at(Math.max(least, greatest)));
  }
  return points;
}

/** A time with its uncertainty, or why it is none. */
export function timed(time: Timed | null, tooShort: Words["too_short"]): string {
  if (!time) return "—";
  if (isMeasurable(time)) return milliseconds(time);
  const { seconds, interval } = time;
  return tooShort(rounded(seconds, interval), rounded(interval, interval));
}

function escape(text: string): string {
  return text.replace(/[&<>"']/g, (each) => `&#${each.charCodeAt(0)};`);
}
