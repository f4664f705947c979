// The scope under load: sixteen channels at 1 kHz from eight simulated drives on two buses of 1 Mbit/s.
// The rate and cost of pictures are printed; the assertions hold on a busy machine as well.

import { execFileSync } from "node:child_process";
import { existsSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { parquetMetadata, parquetReadObjects } from "hyparquet";
import type { CDPSession } from "playwright-core";
import { afterAll, afterEach, beforeAll, describe, expect, it } from "vitest";
import { Visitor } from "./browser";
import { Held } from "./program";
import { ROOT } from "./server";

/** With pyarrow and DuckDB, where `make package` made it. */
const PYTHON = join(ROOT, ".venv/bin/python");
const BUS = "sim:cia402:1,2,3,4?bitrate=1000000";
const AXES = [0, 1, 2, 3, 4, 5, 6, 7];
const CHANNELS = AXES.flatMap((axis) => [`${axis}.position`, `${axis}.velocity`]);
/** Duration of the run: ten minutes in `make soak`. */
const SECONDS = Number(process.env.POLEPAIR_SCOPE_SECONDS ?? 10);
const TEST_MS = 120_000 + SECONDS * 1500;
/** The picture before it is looked at: this long the traces' memory is touched for the first time. */
const SETTLE_MS = 3000;
const HEAP_MAX = 8 << 20;
/** A silence longer than this is drawn as a gap; see `Channel.period_max`. */
const DRAWN_S = 0.1;

let v: Visitor;
/** The server's start, about. */
let begun = 0;
const held: Held[] = [];

/** Has a drive send its position and its speed every millisecond, and turn. */
async function send(axis: number): Promise<void> {
  const { program } = v.server;
  const its = await Held.take(program, axis);
  held.push(its);
  await its.raw("nmt pre-operational");
  const path = `/axes/${axis}/parameters/tpdo%201%20identifier`;
  const { raw } = await program.get<{ raw: number }>(path);
  const valid = raw % 2 ** 31;
  for (const [name, value] of [
    ["identifier", valid + 2 ** 31],
    ["transmission", 255],
    ["inhibit time", 0],
    ["event time", 1],
    ["entries", 0],
    ["entry 1", 0x6064_0020],
    ["entry 2", 0x606c_0020],
    ["entries", 2],
    ["identifier", valid],
  ] as const)
    await its.write(`tpdo 1 ${name}`, value);
  await its.raw("nmt start");
  await its.command("arm");
  await its.command("enable");
  await its.command("velocity", { velocity: 2 + axis });
}

/** Output of parquet.py. */
interface Foreign {
  names: string[];
  types: string[];
  units: object;
  time_zero: string;
  rows: number;
  nulls: number[];
  rising: boolean;
  counted: number[];
}

/** Presses a button that saves a file. */
async function save(button: string): Promise<string> {
  const saved = v.page.waitForEvent("download");
  await v.button(button).click();
  return (await saved).path();
}

interface Cost {
  /** Between pictures, in ms, sorted. */
  frames: number[];
  script: number;
  style: number;
  task: number;
}

/** Pictures for so long, and the processor time of the page's thread, in ms a picture. */
async function watch(cdp: CDPSession, seconds: number): Promise<Cost> {
  const before = await metrics(cdp);
  const frames = await v.page.evaluate(
    (ms) =>
      new Promise<number[]>((settle) => {
        const between: number[] = [];
        let last = Number.NaN;
        const begun = performance.now();
        const tick = (): void => {
          const now = performance.now();
          if (last > 0) between.push(now - last);
          last = now;
          if (now - begun < ms) requestAnimationFrame(tick);
          else settle(between);
        };
        requestAnimationFrame(tick);
      }),
    seconds * 1000,
  );
  const after = await metrics(cdp);
  const each = (name: string): number =>
    (((after[name] ?? 0) - (before[name] ?? 0)) * 1000) / frames.length;
  return {
    frames: frames.sort((a, b) => a - b),
    script: each("ScriptDuration"),
    style: each("RecalcStyleDuration") + each("LayoutDuration"),
    task: each("TaskDuration"),
  };
}

async function metrics(cdp: CDPSession): Promise<Record<string, number>> {
  const { metrics } = await cdp.send("Performance.getMetrics");
  return Object.fromEntries(metrics.map(({ name, value }) => [name, value]));
}

/** Bytes of the page's heap that are in use, its arrays among them. */
async function heap(cdp: CDPSession): Promise<number> {
  await cdp.send("HeapProfiler.collectGarbage");
  const used: Record<string, number> = await cdp.send("Runtime.getHeapUsage");
  return (used.usedSize ?? 0) + (used.backingStorageSize ?? 0);
}

function tell(what: string, { frames, script, style, task }: Cost): void {
  const sum = frames.reduce((sum, each) => sum + each, 0);
  const at = (share: number): string =>
    (frames[Math.floor(frames.length * share)] ?? Number.NaN).toFixed(1);
  console.log(
    `${what}: ${((frames.length * 1000) / sum).toFixed(1)} pictures a second; ` +
      `ms between: median ${at(0.5)}, 95 % ${at(0.95)}, 99 % ${at(0.99)}; ` +
      `ms a picture: script ${script.toFixed(2)}, style and layout ${style.toFixed(2)}, ` +
      `page's thread ${task.toFixed(2)}`,
  );
}

beforeAll(async () => {
  v = await Visitor.come(BUS, BUS);
  begun = Date.now();
  for (const axis of AXES) await send(axis);
}, TEST_MS);
afterAll(async () => {
  held.forEach((each) => each.letGo());
  await v?.leave();
});
afterEach(() => v.content());

/** The page's readout of a channel. */
interface Row {
  hz: number;
  pushed: boolean;
  lost: number;
}

/** Rate and losses of the page's channels. */
async function rows(): Promise<Row[]> {
  const panel = v.page.getByRole("tabpanel", { name: "Scope" });
  const texts = await panel.locator("tbody tr").allInnerTexts();
  return texts.map((text) => {
    const [, hz = "", sign, lost = ""] = /([\d.]+) Hz ([↓↻])\s+(\d+)/.exec(text) ?? [];
    return { hz: Number(hz), pushed: sign === "↓", lost: Number(lost) };
  });
}

/** Waits until a condition holds for all sixteen channels: on a busy machine no samples may come for a second. */
async function untilEach(holds: (row: Row) => boolean): Promise<void> {
  const all = async (): Promise<string> => JSON.stringify(await rows());
  await v.until(all, (text) => {
    const shown = JSON.parse(text) as Row[];
    return shown.length === 16 && shown.every(holds);
  });
}

describe("the scope with sixteen channels at 1 kHz", () => {
  it("shows each one's rate, and takes no more memory in time", { timeout: TEST_MS }, async () => {
    const { page } = v;
    const { origin } = new URL(v.server.url);
    await page.goto(v.server.url);
    // Anew: a page that is there already may just be writing its own view into the URL.
    await page.goto("about:blank");
    await page.goto(`${origin}/#ch=${CHANNELS.join(",")}&hz=1000&lower=log`);
    await untilEach(({ hz, pushed }) => pushed && hz > 0);
    await page.waitForTimeout(SETTLE_MS);
    const cdp = await page.context().newCDPSession(page);
    await cdp.send("Performance.enable", { timeDomain: "threadTicks" });
    for (const span of [2, 10]) {
      await page.getByLabel("Time span").selectOption(String(span));
      tell(`16 channels at 1 kHz, ${span} s across`, await watch(cdp, Math.min(SECONDS, 5)));
    }
    const before = await heap(cdp);
    tell(`16 channels at 1 kHz, ${SECONDS} s long`, await watch(cdp, SECONDS));
    const grown = (await heap(cdp)) - before;
    console.log(`heap ${(before / 1e6).toFixed(1)} MB, ${(grown / 1e3).toFixed(0)} kB more`);
    expect(grown).toBeLessThan(HEAP_MAX);
    // Without lost samples, the rate is that at which the drives send.
    await untilEach(({ hz, lost }) => (lost ? hz > 0 : Math.abs(hz - 1000) < 50));
  });

  it("draws each picture once", async () => {
    const [pictures, drawn] = await v.page.evaluate(
      () =>
        new Promise<[number, number]>((settle) => {
          const its = CanvasRenderingContext2D.prototype;
          const { clearRect } = its;
          let [pictures, drawn] = [0, 0];
          its.clearRect = function (...area) {
            drawn++;
            clearRect.apply(this, area);
          };
          const tick = (): void => {
            if (++pictures < 60) return void requestAnimationFrame(tick);
            its.clearRect = clearRect;
            settle([pictures, drawn]);
          };
          requestAnimationFrame(tick);
        }),
    );
    expect(drawn).toBeGreaterThan(pictures / 2);
    expect(drawn).toBeLessThanOrEqual(pictures + 1);
  });

  it("reports every lost sample", { timeout: TEST_MS }, async () => {
    await v.page.getByLabel("Time span").selectOption("5");
    await v.page.waitForTimeout(1000);
    await v.button("❚❚ Pause").click();
    const told = await rows();
    const text = readFileSync(await save("CSV"), "utf8");
    const lines = text.trim().split("\n").slice(1);
    const last = told.map(() => Number.NaN);
    const missing = told.map(() => 0);
    const count = told.map(() => 0);
    for (const line of lines) {
      const [time = Number.NaN, ...cells] = line
        .split(",")
        .map((c) => (c ? Number(c) : Number.NaN));
      cells.forEach((value, i) => {
        if (Number.isNaN(value)) return;
        const silent = time - (last[i] ?? Number.NaN);
        // A long silence is drawn as one; a short one is lost samples.
        if (silent > 0.0015 && silent < DRAWN_S)
          missing[i] = (missing[i] ?? 0) + Math.round(silent * 1000) - 1;
        last[i] = time;
        count[i] = (count[i] ?? 0) + 1;
      });
    }
    told.forEach(({ lost }, i) => {
      // On a busy machine all of them may be lost.
      if (!lost) expect(count[i]).toBeGreaterThan(100);
      expect(missing[i]).toBeLessThanOrEqual(lost);
    });
  });

  it("saves the same samples as Parquet, with units and gaps", { timeout: TEST_MS }, async () => {
    const csv = readFileSync(await save("CSV"), "utf8")
      .trim()
      .split("\n");
    const path = await save("Parquet");
    const bytes = readFileSync(path);
    const file = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length);
    const read = await parquetReadObjects({ file });
    const lines = read.map((row) => {
      const [time, ...values] = Object.values(row) as (number | null)[];
      return [time?.toFixed(6), ...values.map((value) => value ?? "")].join(",");
    });
    expect(lines).toEqual(csv.slice(1));
    const { key_value_metadata: said = [] } = parquetMetadata(file);
    const units = JSON.parse(said.find(({ key }) => key === "units")?.value ?? "") as object;
    expect([...new Set(Object.values(units))].sort()).toEqual(["rad", "rad/s", "s"]);
    if (!existsSync(PYTHON)) return console.log(`no ${PYTHON}: not read by pyarrow and DuckDB`);
    const out = execFileSync(PYTHON, [join(import.meta.dirname, "parquet.py"), path], {
      encoding: "utf8",
    });
    const foreign = JSON.parse(out) as Foreign;
    expect(foreign.names).toEqual(Object.keys(units));
    expect(foreign.units).toEqual(units);
    expect([foreign.types, foreign.rising, foreign.rows]).toEqual([["double"], true, read.length]);
    const counts = foreign.names.map((name) => read.filter((row) => row[name] !== null).length);
    expect(foreign.nulls).toEqual(counts.map((count) => read.length - count));
    expect(foreign.counted).toEqual([read.length, ...counts]);
    expect(Math.abs(Date.parse(foreign.time_zero) - begun)).toBeLessThan(600_000);
    console.log(`${read.length} rows read by hyparquet, pyarrow and DuckDB alike`);
  });
});
