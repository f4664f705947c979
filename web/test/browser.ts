// A browser that was let in by a real server, and how a person goes about its page.

import { execFileSync } from "node:child_process";
import { mkdirSync, readdirSync, readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { cpus, loadavg } from "node:os";
import { join, resolve } from "node:path";
import { type Browser, chromium, type Locator, type Page } from "playwright-core";
import { expect } from "vitest";
import { Server } from "./server";

const AXE = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
/** Folder of screenshots, if new ones are requested. */
const IMAGES = process.env.IMAGES;
/** Shows the page that was built last (`PAGE=dist`) in place of that in the server's program. */
const PAGE = process.env.PAGE;
/** Folder of screenshots that are not for the documentation. */
const SHOTS = process.env.SHOTS;
/** Longer than anything takes that works, on a busy machine too. */
export const WAIT_MS = 120_000;
/** An action that a person can do at once. */
export const BRIEF = { timeout: 10_000 };
/** Looks in a row that see control or power offered, before it counts as lost. */
const OFFERS_MAX = 20;
/** A picture of the documentation is no larger. */
const PICTURE_BYTES_MAX = 150_000;
const COLOURS = "128";
export const WIDE = { width: 1280, height: 800 };

interface Violation {
  id: string;
  impact: string | null;
  nodes: { html: string }[];
}

/** What a failed wait says: what was waited for (text, or the source of a condition), what was seen, and how
 * busy the machine is. */
function failedWait(ms: number, what: unknown, seen: unknown): Error {
  const load = loadavg().map((average) => average.toFixed(2));
  const machine = `load ${load.join(" ")} on ${cpus().length} processors`;
  return new Error(`waited ${ms} ms for: ${what}; seen: ${seen}; ${machine}`);
}

/** Scripts and styles of a folder where the server's program has older ones; the rest is its own. */
async function instead(page: Page, folder: string): Promise<void> {
  const files = readdirSync(join(folder, "assets"));
  await page.route(/\/assets\/[^/]*$/, async (route) => {
    const [, name = "", ending = ""] = /([^/-]*)-[^/]*(\.\w+)$/.exec(route.request().url()) ?? [];
    const file = files.find((each) => each.startsWith(`${name}-`) && each.endsWith(ending));
    if (!file) return route.continue();
    await route.fulfill({ path: join(folder, "assets", file) });
  });
}

/** A user of the page. */
export class Visitor {
  /** Errors of the browser: only they show a style or script that the CSP blocks. Refused requests are
   *  not among them, because the page shows those itself. */
  complaints: string[] = [];

  private constructor(
    readonly server: Server,
    private readonly browser: Browser,
    readonly page: Page,
  ) {
    page.on("console", (message) => {
      if (message.type() === "error" && !message.location().url.includes("/api/"))
        this.complaints.push(message.text());
    });
    page.on("pageerror", (error) => this.complaints.push(error.message));
  }

  static async come(...links: string[]): Promise<Visitor> {
    const server = await Server.start(...links);
    try {
      const executablePath = process.env.CHROMIUM ?? "/usr/bin/chromium";
      const browser = await chromium.launch({
        executablePath,
        args: ["--no-sandbox"],
      });
      const page = await browser.newPage({
        viewport: WIDE,
        colorScheme: "light",
        locale: "en-GB",
        timezoneId: "UTC",
      });
      page.setDefaultTimeout(WAIT_MS);
      if (PAGE) await instead(page, resolve(PAGE));
      return new Visitor(server, browser, page);
    } catch (problem) {
      server.stop();
      throw problem;
    }
  }

  async leave(): Promise<void> {
    await this.browser.close();
    this.server.stop();
  }

  /** Nothing was complained of since this was last asked. */
  content(): void {
    const told = this.complaints;
    this.complaints = [];
    expect(told).toEqual([]);
  }

  /** By its whole name: parameters have names too, and a button each. */
  button(name: string | RegExp): Locator {
    return this.page.getByRole("button", { name, exact: typeof name === "string" });
  }

  tab(name: string): Promise<void> {
    return this.page.getByRole("tab", { name }).click();
  }

  card(at: number): Locator {
    return this.page.getByRole("article").nth(at);
  }

  /** Frames of the list; what a select offers has the same role. */
  get frames(): Locator {
    return this.page.getByRole("listbox", { name: "Frames" }).getByRole("option");
  }

  /** Waits until a value is so, and gives it. */
  async until<T>(read: () => Promise<T>, good: (value: T) => boolean, ms = WAIT_MS): Promise<T> {
    const end = Date.now() + ms;
    for (;;) {
      const value = await read();
      if (good(value)) return value;
      if (Date.now() > end) throw failedWait(ms, good, value);
      await this.page.waitForTimeout(50);
    }
  }

  /** What an axis shows of its speed, in rpm. */
  async speed(at: number): Promise<number> {
    const text = await this.card(at).getByRole("row", { name: "velocity" }).innerText();
    return Number(/(-?[\d.]+) rpm/.exec(text)?.[1] ?? Number.NaN);
  }

  async stands(at: number): Promise<void> {
    await this.until(
      () => this.speed(at),
      (speed) => Math.abs(speed) < 1,
    );
  }

  /** What gives control or power, where it is not there. */
  private get offered(): Locator {
    return this.page.locator("button:enabled").filter({ hasText: /^(Take control|Enable)$/ });
  }

  /** Has the axis and its motor powered, whatever became of an earlier lease meanwhile. */
  async ready(): Promise<void> {
    const jog = this.page.locator("button:enabled", { hasText: "+ ▶" });
    const { offered } = this;
    for (const end = Date.now() + WAIT_MS; Date.now() < end;) {
      await offered.or(jog).first().waitFor();
      if (await jog.count()) return;
      // It may have been pressed already, and be gone by now.
      await offered
        .first()
        .click({ timeout: 1000 })
        .catch(() => {});
      await this.page.waitForTimeout(300);
    }
    const seen = (await this.page.getByRole("article").allInnerTexts()).join("; ");
    throw failedWait(WAIT_MS, "an axis with power", seen);
  }

  /** Does something to the axis that needs control and power, until it shows. It is done again only where
   * the page offers control or power anew: without a processor it is silent for longer than a lease lasts,
   * and what was asked for ends with the lease. */
  async withControl(act: () => Promise<unknown>, shows: () => Promise<boolean>): Promise<void> {
    const end = Date.now() + WAIT_MS;
    const spent = (): void => {
      if (Date.now() > end) throw failedWait(WAIT_MS, shows, `false after ${act}`);
    };
    for (;;) {
      await this.ready();
      // A button that is gone by now is not waited for.
      await act().catch(() => {});
      for (let offers = 0; offers < OFFERS_MAX;) {
        if (await shows()) return;
        spent();
        await this.page.waitForTimeout(50);
        offers = (await this.offered.count()) ? offers + 1 : 0;
      }
    }
  }

  /** Jogs until its speed shows; the caller releases the button. */
  async jog(speed: () => Promise<number>): Promise<void> {
    await this.withControl(
      async () => {
        await this.page.mouse.up();
        await this.button("Hold to jog forwards").hover(BRIEF);
        await this.page.mouse.down();
      },
      async () => (await speed()) > 20,
    );
  }

  /** Has the first axis turn, in rpm. */
  async spin(rpm: string): Promise<void> {
    await this.withControl(
      async () => {
        await this.button("Speed").click(BRIEF);
        const field = this.page.getByRole("form", { name: "Move" }).getByLabel("velocity, rpm");
        await field.fill(rpm, BRIEF);
        await this.button("Go").click(BRIEF);
      },
      async () => (await this.speed(0)) > 20,
    );
  }

  /** Gives the lease back, and waits until the server has released it: requests over HTTP may overtake
   * messages on the WebSocket. */
  async giveBack(): Promise<void> {
    await this.button("Release control").click();
    await this.button("Take control").waitFor();
  }

  /** Does something to the simulated drive, and waits until it is done. */
  async act(act: string, value?: [label: string, text: string]): Promise<void> {
    if (value) await this.page.getByLabel(value[0], { exact: true }).fill(value[1]);
    const done = this.page.waitForResponse((answer) => answer.url().includes("/simulation/"));
    await this.page.getByRole("form", { name: act }).getByRole("button").first().click();
    expect((await done).ok()).toBe(true);
  }

  /** Does something at each size, in both languages and themes: `1280x800-en-light`. */
  async everyLook(
    sizes: readonly (readonly [width: number, height: number])[],
    check: (where: string) => Promise<void>,
  ): Promise<void> {
    for (const [language, theme] of [
      ["zh", "dark"],
      ["en", "light"],
    ] as const) {
      await this.page.setViewportSize(WIDE);
      await this.page.locator("header select").nth(2).selectOption(language);
      await this.page.locator("header select").nth(1).selectOption(theme);
      for (const [width, height] of sizes) {
        await this.page.setViewportSize({ width, height });
        await check(`${width}x${height}-${language}-${theme}`);
      }
    }
    await this.page.setViewportSize(WIDE);
  }

  /** Serious findings of axe, by all of its rules or by some, which runs from outside the page's CSP. */
  async serious(...rules: string[]): Promise<string[]> {
    const options = { resultTypes: ["violations"], ...(rules.length ? { runOnly: rules } : {}) };
    await this.page.evaluate(AXE);
    const run = `axe.run(${JSON.stringify(options)})`;
    const found = (await this.page.evaluate(run)) as { violations: Violation[] };
    return found.violations
      .filter((each) => each.impact === "serious" || each.impact === "critical")
      .map((each) => `${each.id}: ${each.nodes[0]?.html}`);
  }

  /** Takes a screenshot of the test's page if `SHOTS=folder` is set. */
  async shot(name: string): Promise<void> {
    if (!SHOTS) return;
    mkdirSync(SHOTS, { recursive: true });
    await this.page.screenshot({ path: join(SHOTS, `${name}.png`) });
  }

  /** Takes a picture for the documentation, in as few colours as a page has. */
  async picture(name: string, of: Page | Locator = this.page): Promise<void> {
    if (!IMAGES) return;
    mkdirSync(IMAGES, { recursive: true });
    const path = join(IMAGES, `dashboard-${name}.png`);
    await of.screenshot({ path });
    execFileSync("pngquant", [
      "--speed",
      "1",
      "--strip",
      "--force",
      "--output",
      path,
      COLOURS,
      path,
    ]);
    expect(readFileSync(path).length).toBeLessThan(PICTURE_BYTES_MAX);
  }
}
