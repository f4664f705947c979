// How the page looks, to people and to a screen reader, in every panel, theme and language.

import { readdirSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { gzipSync } from "node:zlib";
import { afterAll, afterEach, beforeAll, describe, expect, it } from "vitest";
import { Visitor } from "./browser";
import { ROOT } from "./server";

const PAGE_BYTES_MAX = 300_000;
/** Axe looks at every line of every panel, on a machine that may be at something else. */
const AXE_MS = 240_000;
const UPPER = ["Tuning", "Scope"];
const LOWER = ["Simulation", "Log", "Frames"];

let v: Visitor;

beforeAll(async () => {
  v = await Visitor.come();
  await v.page.goto(v.server.url);
  await v.card(4).waitFor();
});
afterAll(async () => v?.leave());
afterEach(() => v.content());

describe("the dashboard's looks", () => {
  it("take under 300 kB, compressed", () => {
    const dist = join(ROOT, "crates/serve/page");
    const files = readdirSync(dist, { recursive: true, withFileTypes: true });
    const sizes = files
      .filter((each) => each.isFile())
      .map((each) => gzipSync(readFileSync(join(each.parentPath, each.name))).length);
    const sum = sizes.reduce((sum, size) => sum + size, 0);
    console.log(`the page is ${(sum / 1000).toFixed(0)} kB, compressed`);
    expect(sizes.length).toBeGreaterThan(2);
    expect(sum).toBeLessThan(PAGE_BYTES_MAX);
  });

  it("have no serious findings of axe in any panel", { timeout: AXE_MS }, async () => {
    for (const name of [...UPPER, ...LOWER]) {
      await v.tab(name);
      expect(await v.serious()).toEqual([]);
    }
    await v.tab("Simulation");
    await v.picture("simulation");
  });

  it("have contrast in the dark too, in every panel", { timeout: AXE_MS }, async () => {
    await v.page.getByLabel("Colours").selectOption("dark");
    for (const name of [...UPPER, ...LOWER]) {
      await v.tab(name);
      expect(await v.serious("color-contrast")).toEqual([]);
    }
    await v.picture("dark");
  });

  it("can be Chinese", async () => {
    await v.page.getByLabel("Colours").selectOption("light");
    await v.page.getByLabel("Language").selectOption("zh");
    await v.button(/全部停止/).waitFor();
    expect(await v.page.evaluate(() => document.documentElement.lang)).toBe("zh-Hans");
    await v.picture("chinese");
    await v.page.getByLabel("语言").selectOption("en");
  });
});
