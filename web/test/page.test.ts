// The page as a new user meets it, in a real browser on the real server.

import { mkdirSync, readdirSync, readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { join } from "node:path";
import { gzipSync } from "node:zlib";
import { type Browser, chromium, type Locator, type Page } from "playwright-core";
import { afterAll, afterEach, beforeAll, describe, expect, it } from "vitest";
import { ROOT, Server } from "./server";

const AXE = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
/** Where pictures go: only where somebody asks for new ones. */
const IMAGES = process.env.IMAGES;
const WIDE = { width: 1280, height: 800 };

interface Violation {
  id: string;
  impact: string | null;
  nodes: { html: string }[];
}

let server: Server;
let browser: Browser;
let page: Page;
let complaints: string[] = [];

beforeAll(async () => {
  server = await Server.start("sim:tmcl?axes=2&seed=1", "sim:thruster");
  browser = await chromium.launch({
    executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
    args: ["--no-sandbox"],
  });
  page = await browser.newPage({ viewport: WIDE, colorScheme: "light", locale: "en-GB" });
  // A style or script that the CSP stops is told here, and nowhere else.
  page.on("console", (message) => {
    if (message.type() === "error") complaints.push(message.text());
  });
  page.on("pageerror", (error) => complaints.push(error.message));
});

afterAll(async () => {
  await browser?.close();
  server?.stop();
});

afterEach(() => {
  const told = complaints;
  complaints = [];
  expect(told).toEqual([]);
});

/** By its whole name: parameters have names too, and a button each. */
const button = (name: string | RegExp): Locator =>
  page.getByRole("button", { name, exact: typeof name === "string" });
const tab = (name: string): Promise<void> => page.getByRole("tab", { name }).click();
const card = (at: number): Locator => page.getByRole("article").nth(at);

/** Waits until a text is so, and gives it. */
async function until(
  read: () => Promise<string>,
  good: (text: string) => boolean,
): Promise<string> {
  for (;;) {
    const text = await read();
    if (good(text)) return text;
    await page.waitForTimeout(50);
  }
}

/** What an axis shows of its speed, in rpm. */
async function speed(at: number): Promise<number> {
  const text = await card(at).getByRole("row", { name: "velocity" }).innerText();
  return Number(/(-?[\d.]+) rpm/.exec(text)?.[1] ?? Number.NaN);
}

async function picture(name: string, of: Page | Locator = page): Promise<void> {
  if (!IMAGES) return;
  mkdirSync(IMAGES, { recursive: true });
  await of.screenshot({ path: join(IMAGES, `dashboard-${name}.png`) });
}

/** Serious findings of axe, which runs from outside the page's CSP. */
async function serious(): Promise<string[]> {
  await page.evaluate(AXE);
  const found = (await page.evaluate("axe.run()")) as { violations: Violation[] };
  return found.violations
    .filter((each) => each.impact === "serious" || each.impact === "critical")
    .map((each) => `${each.id}: ${each.nodes[0]?.html}`);
}

describe("the dashboard", () => {
  it("is under 300 kB compressed", () => {
    const dist = join(ROOT, "web/dist");
    const files = readdirSync(dist, { recursive: true, withFileTypes: true });
    const sizes = files
      .filter((each) => each.isFile())
      .map((each) => gzipSync(readFileSync(join(each.parentPath, each.name))).length);
    expect(sizes.length).toBeGreaterThan(2);
    expect(sizes.reduce((sum, size) => sum + size, 0)).toBeLessThan(300_000);
  });

  it("lets a browser in by the URL that was printed, and is painted within a second", async () => {
    await page.goto(server.url);
    expect(page.url()).not.toContain("once");
    await card(2).waitFor();
    const painted = await page.evaluate(
      () => performance.getEntriesByName("first-contentful-paint")[0]?.startTime ?? 1e9,
    );
    expect(painted).toBeLessThan(1000);
  });

  it("says what each axis does, and how old that is", async () => {
    const text = await until(
      () => card(0).innerText(),
      (text) => /velocity\s+-?[\d.]+ rpm\s+\d+\.\d s/.test(text),
    );
    expect(text).toContain("tmcl #1");
    expect(text).toContain("disabled");
  });

  it("jogs a motor while a button is held, and stops it when it is let go", async () => {
    await button("Take control").click();
    await button("Enable").click();
    const forth = button("Hold to jog forwards");
    await page.locator("button:enabled", { hasText: "+ ▶" }).waitFor();
    await forth.hover();
    await page.mouse.down();
    await until(
      async () => String(await speed(0)),
      (text) => Number(text) > 20,
    );
    await picture("light");
    await page.mouse.up();
    await until(
      async () => String(await speed(0)),
      (text) => Math.abs(Number(text)) < 1,
    );
  });

  it("stops a jog by key when the key is let go, and when the page loses the focus", async () => {
    const forth = button("Hold to jog forwards");
    await forth.focus();
    await page.keyboard.down(" ");
    await until(
      async () => String(await speed(0)),
      (text) => Number(text) > 20,
    );
    await page.keyboard.up(" ");
    await until(
      async () => String(await speed(0)),
      (text) => Math.abs(Number(text)) < 1,
    );
    await page.keyboard.down(" ");
    await until(
      async () => String(await speed(0)),
      (text) => Number(text) > 20,
    );
    await page.evaluate(() => window.dispatchEvent(new Event("blur")));
    await until(
      async () => String(await speed(0)),
      (text) => Math.abs(Number(text)) < 1,
    );
    await page.keyboard.up(" ");
  });

  it("shows a step response with its metrics, and makes a report of it", async () => {
    await tab("Tuning");
    await page.getByRole("button", { name: "Step", exact: true }).click();
    const row = page.getByRole("row", { name: /velocity .* → .* rpm/ });
    await row.waitFor();
    expect(await row.innerText()).toMatch(/\d ms/);
    await page.getByRole("button", { name: "Step", exact: true }).click();
    await row.nth(1).waitFor();
    const [file] = await Promise.all([
      page.waitForEvent("download"),
      button("Save report").click(),
    ]);
    const report = readFileSync(await file.path(), "utf8");
    expect(report).toContain("<svg");
    expect(report.match(/<polyline/g)?.length).toBe(2);
    await picture("tuning");
    await tab("Scope");
  });

  it("tells what a fault is, what to do, and clears it", async () => {
    await tab("Simulation");
    await page.getByLabel("supply, V").fill("6");
    await page.getByRole("button", { name: "supply", exact: true }).click();
    const told = await until(
      () => card(0).innerText(),
      (text) => text.includes("fault"),
    );
    expect(told).toMatch(/Cause: \w/);
    expect(told).toMatch(/Remedy: \w/);
    await picture("fault");
    await page.getByLabel("supply, V").fill("24");
    await page.getByRole("button", { name: "supply", exact: true }).click();
    await button("Clear faults").click();
    await until(
      () => card(0).innerText(),
      (text) => !text.includes("fault"),
    );
  });

  it("explains frames byte by byte, filters them, and says where a filter is wrong", async () => {
    await tab("Frames");
    const filter = page.getByLabel("Filter").first();
    await filter.fill("axis = 1");
    await page.getByRole("button", { name: "Filter", exact: true }).click();
    const rows = page.getByRole("option");
    await rows.nth(5).waitFor();
    await button("Freeze").click();
    await rows.nth(5).hover();
    const explained = page.getByRole("region", { name: "Frame explained" });
    await explained.getByRole("listitem").nth(3).waitFor();
    await picture("frames", page.getByRole("region", { name: "Frames" }));
    await filter.fill("axis = = 2");
    await page.getByRole("button", { name: "Filter", exact: true }).click();
    await page.getByRole("region", { name: "Frames" }).getByRole("alert").waitFor();
    await filter.fill("");
    await page.getByRole("button", { name: "Filter", exact: true }).click();
    await page
      .getByRole("region", { name: "Frames" })
      .getByRole("button", { name: "Live" })
      .click();
  });

  it("opens a capture in the same view, with its summary", async () => {
    const input = page.locator("input[type=file][aria-label='Open capture']");
    await input.setInputFiles(join(ROOT, "docs/examples/feeder.log"));
    const summary = page.getByRole("region", { name: "Summary" });
    await summary.waitFor();
    await page.getByRole("option").nth(3).waitFor();
    expect((await summary.innerText()).length).toBeGreaterThan(100);
    await picture("capture");
    await button("Back to live").click();
  });

  it("reads parameters, and applies a plan", async () => {
    await page.getByLabel("Search parameters").fill("max current");
    await button("Read max current").click();
    await until(
      () => button("Read max current").innerText(),
      (text) => /\d/.test(text),
    );
    const field = page.getByLabel("New value of max current");
    await field.fill("1.5");
    await field.blur();
    await button("Plan (1)").click();
    await button("Apply").click();
    await until(
      () => button("Read max current").innerText(),
      (text) => text.startsWith("1.5"),
    );
    await picture("parameters", page.getByRole("complementary", { name: "Chosen axis" }));
  });

  it("has no serious findings of axe, light or dark, in any panel", async () => {
    for (const theme of ["light", "dark"]) {
      await page.getByLabel("Colours").selectOption(theme);
      for (const name of ["Tuning", "Scope", "Simulation", "Log", "Frames"]) {
        await tab(name);
        expect(await serious()).toEqual([]);
      }
    }
    await picture("dark");
    await page.getByLabel("Colours").selectOption("light");
  });

  it("speaks Chinese", async () => {
    await page.getByLabel("Language").selectOption("zh");
    await button(/全部停止/).waitFor();
    expect(await page.evaluate(() => document.documentElement.lang)).toBe("zh-Hans");
    await page.getByLabel("语言").selectOption("en");
  });

  it("stops everything on Esc, says how far, and moves nothing until it is released", async () => {
    await page.keyboard.press("Escape");
    const stop = page.getByRole("region", { name: "Stop" });
    await until(
      () => stop.innerText(),
      (text) => text.includes("Motion is locked") && text.includes("standing still"),
    );
    await picture("stop");
    expect(await button("Hold to jog forwards").isDisabled()).toBe(true);
    await button("Release motion").click();
    await stop.waitFor({ state: "detached" });
    await button("Take control").waitFor();
  });

  it("watches and stops on a phone", async () => {
    await page.setViewportSize({ width: 390, height: 844 });
    const stop = button(/STOP ALL/);
    const box = await stop.boundingBox();
    expect(box?.height).toBeGreaterThanOrEqual(60);
    const wide = await page.evaluate(() => document.documentElement.scrollWidth);
    expect(wide).toBeLessThanOrEqual(390);
    expect(await serious()).toEqual([]);
    await picture("phone");
    await stop.click();
    await button("Release motion").click();
    await page.setViewportSize(WIDE);
  });

  it("connects again by itself, and keeps the view in its URL", async () => {
    await page.getByLabel("Time across").selectOption("2");
    await page.waitForURL(/span=2/);
    await page.context().setOffline(true);
    await page.reload().catch(() => {});
    await page.context().setOffline(false);
    complaints = [];
    await page.goto(page.url());
    await card(2).waitFor();
    expect(await page.getByLabel("Time across").inputValue()).toBe("2");
  });
});
