// STOP is in sight and can be pressed, whatever the window, the panel and the number of axes.

import { afterAll, afterEach, beforeAll, describe, expect, it } from "vitest";
import { Visitor } from "./browser";

const KINDS = ["tmcl", "modbus-rtu"];
const EACH = 30;
const AXES = KINDS.length * EACH;
const SIZES = [
  [1280, 720],
  [1366, 768],
  [1440, 900],
  [1920, 1080],
  [1024, 600],
  [768, 1024],
  [844, 390],
  [390, 844],
  [360, 640],
] as const;
/** Every size in both languages and themes, on a machine that may be at something else. */
const LONG_MS = 360_000;

// Drives are silent here on purpose: the server need not wait for them as long as elsewhere.
process.env.POLEPAIR_TIMEOUT_SCALE = "2";

let v: Visitor;

beforeAll(async () => {
  v = await Visitor.come(...KINDS.map((kind) => `sim:${kind}?axes=${EACH}&baud=115200`));
  await v.page.goto(v.server.url);
  await v.card(AXES - 1).waitFor();
});
afterAll(async () => v?.leave());
afterEach(() => v.content());

/** STOP stays in the window, on top of everything, at every scroll position. */
async function stopIsInSight(where: string): Promise<void> {
  const stop = v.page.getByRole("banner").getByRole("button", { name: /STOP ALL|全部停止/ });
  const before = await stop.boundingBox();
  await v.page.getByRole("banner").hover({ position: { x: 5, y: 5 } });
  await v.page.mouse.wheel(0, 3000);
  await v.page.evaluate(() => window.scrollBy(0, 3000));
  const page = await v.page.evaluate(() => ({
    scrolled: [window.scrollX, window.scrollY],
    size: [innerWidth, innerHeight],
    whole: [document.documentElement.scrollWidth, document.documentElement.scrollHeight],
  }));
  expect(page.scrolled, where).toEqual([0, 0]);
  expect(page.whole, where).toEqual(page.size);
  const box = await stop.boundingBox();
  expect(box, where).toEqual(before);
  expect((box?.x ?? 0) + (box?.width ?? 0), where).toBeLessThanOrEqual(page.size[0] ?? 0);
  expect(box?.y, where).toBeGreaterThanOrEqual(0);
  const onTop = await stop.evaluate((button) => {
    const { x, y, width, height } = button.getBoundingClientRect();
    return [0.1, 0.5, 0.9].every((share) =>
      button.contains(document.elementFromPoint(x + width * share, y + height / 2)),
    );
  });
  expect(onTop, where).toBe(true);
}

/** What is below the banner is still there. */
async function pageHasItsPlace(where: string): Promise<void> {
  const main = await v.page.locator("main").boundingBox();
  const height = await v.page.evaluate(() => innerHeight);
  expect((main?.height ?? 0) / height, where).toBeGreaterThan(0.25);
}

/** Checks each look, and takes its picture. */
const everyLook = (check: (where: string) => Promise<void>) =>
  v.everyLook(SIZES, async (where) => {
    await check(where);
    await v.shot(where);
  });

describe("the page with many axes", () => {
  it("keeps STOP in sight at each size", { timeout: LONG_MS }, () => everyLook(stopIsInSight));

  it("keeps it in sight when a hidden element gets the focus", async () => {
    for (const label of await v.page.locator(".hidden-label").all()) {
      await label.evaluate((it) => {
        it.scrollIntoView();
        if (it instanceof HTMLElement) it.focus();
      });
    }
    await stopIsInSight("after the focus");
  });

  it(
    "lists only axes that are not standing, and keeps its place",
    { timeout: LONG_MS },
    async () => {
      const banner = v.page.getByRole("region", { name: /^(Stop|停止)$/ });
      await v.page.keyboard.press("Escape");
      await v.until(
        () => banner.innerText(),
        (text) => text.includes("all axes at standstill"),
      );
      // The list follows the states of axes, which may come after the results of the stop.
      const listed = banner.getByRole("listitem");
      await v.until(
        () => listed.count(),
        (count) => count === 0,
      );
      await v.button("Release motion").click();
      await banner.waitFor({ state: "detached" });
      // The third drive, at address 4, answers no more: its stop is not confirmed by anybody.
      await v.server.program.post("/simulation/0/2", { act: "supply", value: 0 });
      await v.page.keyboard.press("Escape");
      await v.until(
        () => banner.innerText(),
        (text) => text.includes(`${AXES - 1} of ${AXES} at standstill`),
      );
      await v.until(
        () => listed.allInnerTexts(),
        (texts) => texts.length === 1 && (texts[0]?.includes("171 4") ?? false),
      );
      await v.button("Release motion").click();
      // Its stop is pending until standstill is confirmed, also after motion was released.
      await v.until(
        () => banner.innerText(),
        (text) => text.includes("Standstill not confirmed: 1."),
      );
      await v.server.program.post("/simulation/0/2", { act: "supply", value: 24 });
      await v.until(
        () => banner.innerText(),
        (text) => text.includes("all axes at standstill"),
      );
      await v.button("Close").click();
      await banner.waitFor({ state: "detached" });
    },
  );

  it("has room beside sixty moving axes", { timeout: LONG_MS }, async () => {
    const banner = v.page.getByRole("region", { name: /^(Stop|停止)$/ });
    for (let axis = 0; axis < AXES; axis++) {
      const where = `${Math.floor(axis / EACH)}/${axis % EACH}`;
      await v.server.program.post(`/simulation/${where}`, { act: "supply", value: 0 });
    }
    await v.page.keyboard.press("Escape");
    await v.until(
      () => banner.getByRole("listitem").count().then(String),
      (count) => count === String(AXES),
    );
    await everyLook(async (where) => {
      await stopIsInSight(where);
      await pageHasItsPlace(where);
      const release = banner.locator("button.main");
      // The banner may be drawn anew meanwhile.
      await release.evaluate((it) => it.scrollIntoView());
      expect(await release.isVisible(), where).toBe(true);
    });
    expect(await v.serious()).toEqual([]);
  });
});
