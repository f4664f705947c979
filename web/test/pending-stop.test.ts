// Pending stops: a motor without confirmed standstill is shown in red until it stands, or until a user
// gives a reason.

import { afterAll, afterEach, beforeAll, describe, expect, it } from "vitest";
import { Visitor } from "./browser";
import { Held, type Kept } from "./program";
import { Drive } from "./server";

interface AxisReply {
  pending_stop: { attempts: number; since_ms: number } | null;
}

const SIZES = [
  [1280, 800],
  [390, 844],
] as const;

let v: Visitor;

beforeAll(async () => {
  v = await Visitor.come("sim:tmcl", "sim:modbus-rtu");
  await v.page.goto(v.server.url);
  await v.card(1).waitFor();
});
afterAll(async () => v?.leave());
afterEach(() => v.content());

const banner = () => v.page.getByRole("region", { name: "Stop" });
const list = () => banner().getByRole("list", { name: "Axes with a pending stop" });
const panel = () => v.page.getByRole("complementary", { name: "Chosen axis" });
const supply = (volts: number) =>
  v.server.program.post("/simulation/0/0", { act: "supply", value: volts });
const pendingStop = async () => (await v.server.program.get<AxisReply>("/axes/0")).pending_stop;
const says = (...words: (string | RegExp)[]) =>
  v.until(
    () => list().innerText(),
    (text) =>
      words.every((word) => (typeof word === "string" ? text.includes(word) : word.test(text))),
  );

/** End of the last pending stop. The page shows it before the journal has written it. */
async function ended(visitor: Visitor, isMeant: (record: Kept) => boolean): Promise<Kept> {
  const isOfStop = ({ deed }: Kept) => deed === "stop_pending" || deed === "stop_ended";
  const records = await visitor.until(
    () => visitor.server.program.get<Kept[]>("/journal"),
    (journal) => journal.filter(isMeant).findLast(isOfStop)?.deed === "stop_ended",
  );
  const last = records.filter(isMeant).findLast(isOfStop);
  if (!last) throw new Error("the journal has no end of a stop");
  return last;
}
const endedHere = () => ended(v, ({ axis }) => axis === 0);

/** Makes its stop pending: the supply is off, and a user pressed STOP. */
async function makeStopPending(): Promise<void> {
  await supply(0);
  await v.page.keyboard.press("Escape");
  await says("tmcm-171 1", "stopped by operator");
}

async function release(): Promise<void> {
  await v.button("Release motion").click();
  await v.button("Release motion").waitFor({ state: "detached" });
}

describe("a motor that is not seen standing", () => {
  it("is shown in red with time, cause, stage of its stop, attempts and supply", async () => {
    await v.card(0).getByRole("button").first().click();
    await v.spin("300");
    await makeStopPending();
    const title = banner().getByText("Standstill not confirmed: 1. Cut the supply of:");
    expect(await title.evaluate((it) => Number.parseFloat(getComputedStyle(it).fontSize))).toBe(17);
    const red = await title.evaluate((it) => {
      const alarm = it.closest(".alarm");
      return alarm && getComputedStyle(alarm).backgroundColor;
    });
    expect(red).toBe("rgb(196, 18, 47)");
    const first = await says("the stop was sent, the drive did not confirm it", "E401");
    const count = (text: string) => Number(/sent (\d+)×/.exec(text)?.[1]);
    await v.until(
      () => list().innerText(),
      (text) =>
        count(text) > count(first) && /stop pending for (\d+ min|[2-9] s|\d\d s)/.test(text),
    );
    const { since_ms } = (await pendingStop()) ?? { since_ms: 0 };
    const at = new Date(since_ms).toLocaleTimeString("en-GB", { timeZone: "UTC" });
    await says(`since ${at}`);
    // No axis is listed twice, and its card and panel show the same.
    expect(await banner().getByRole("listitem").count()).toBe(1);
    expect(await v.card(0).innerText()).toMatch(
      /standstill not confirmed[^]*standstill not confirmed: cut its supply/,
    );
    expect(await panel().locator(".alarm").innerText()).toContain(
      "standstill not confirmed: cut its supply",
    );
    expect(await v.card(1).innerText()).not.toContain("standstill not confirmed");
    await v.picture("pending-stop");
  });

  it("keeps the page in its place at each size, in both languages and themes", async () => {
    await list().getByRole("button", { name: "Dismiss the stop of tmcm-171 1" }).click();
    const form = list().getByRole("form");
    expect(await form.locator("select").evaluate((it) => it === document.activeElement)).toBe(true);
    await v.everyLook(SIZES, async (where) => {
      const height = await v.page.evaluate(() => innerHeight);
      const box = await v.page.locator("section.banners").boundingBox();
      expect((box?.height ?? height) / height, where).toBeLessThanOrEqual(0.4);
      const button = v.page.locator("section.banners form button").first();
      // Playwright's own scrolling also waits until the element does not move.
      await button.evaluate((it) => it.scrollIntoView({ block: "nearest" }));
      await v.until(() => button.isVisible(), Boolean);
      await v.shot(`pending-stop-${where}`);
      expect(await v.serious(), where).toEqual([]);
    });
  });

  it("has no pending stop once a user gives a reason, which the journal keeps", async () => {
    const form = list().getByRole("form", { name: "Dismiss the stop of tmcm-171 1" });
    const dismiss = form.getByRole("button", { name: "Dismiss the stop" });
    expect(await dismiss.isDisabled()).toBe(true);
    expect(await pendingStop()).not.toBeNull();
    await form.getByLabel("Reason").selectOption("The drive was removed, or has no supply");
    const note = form.getByLabel("Note");
    await note.fill("sent in for repair");
    // Without the server there is nothing to dismiss; what was typed is kept.
    await v.server.freeze();
    await v.until(
      () => banner().innerText(),
      (text) => text.includes("No connection to the server"),
    );
    expect(await list().count()).toBe(0);
    v.server.resume();
    await note.waitFor();
    expect(await note.inputValue()).toBe("sent in for repair");
    await dismiss.click();
    await list().waitFor({ state: "detached" });
    expect(await pendingStop()).toBeNull();
    const { who, detail } = await endedHere();
    expect(who).toMatch(/^operator \d+$/);
    expect(detail).toMatchObject({
      how: "dismissed",
      reason: "drive_gone",
      note: "sent in for repair",
    });
    expect(await panel().locator(".alarm").count()).toBe(0);
    expect(await v.card(0).innerText()).not.toContain("cut its supply");
    await supply(24);
    await release();
  });

  it("leaves the list when its standstill is measured", async () => {
    await makeStopPending();
    await supply(24);
    await list().waitFor({ state: "detached" });
    await v.until(
      () => banner().innerText(),
      (text) => text.includes("all axes at standstill"),
    );
    expect((await endedHere()).detail).toMatchObject({ how: "standing" });
    expect(await panel().locator(".alarm").count()).toBe(0);
    await release();
  });

  it("accepts commands of its controller, and shows that it may be turning", async () => {
    await makeStopPending();
    await release();
    expect(await panel().getByRole("form", { name: "Continue to control it" }).count()).toBe(0);
    await v.button("Take control").click();
    const form = panel().getByRole("form", { name: "Continue to control it" });
    await form.waitFor();
    await v.button("Enable").click();
    await v.until(
      () => panel().innerText(),
      (text) => text.includes("gateway.pending"),
    );
    const go = form.getByRole("button");
    expect(await go.isDisabled()).toBe(true);
    await form.getByLabel("I know that tmcm-171 1 may still turn").check();
    await v.shot("pending-stop-may-turn");
    expect(await v.serious()).toEqual([]);
    await go.click();
    await list().waitFor({ state: "detached" });
    await form.waitFor({ state: "detached" });
    expect((await endedHere()).detail).toMatchObject({ how: "dismissed", reason: "taken_over" });
    await supply(24);
    await v.giveBack();
  });

  it("stays in the list with the reason if the server refuses", async () => {
    // From here on the page's requests are allowed to a lease's holder only.
    await v.page.routeWebSocket(/\/api\/v1\/live$/, (page) => {
      const server = page.connectToServer();
      page.onMessage((message) => {
        const said =
          typeof message === "string" ? message.replace('"drive_gone"', '"taken_over"') : message;
        server.send(said);
      });
    });
    // The panel reads the watchdog when it is shown. A stop cancels a read that still waits, which the
    // browser logs as an error.
    const watchdog = v.page.waitForResponse((answer) => answer.url().endsWith("/watchdog"));
    await v.page.reload();
    await v.card(1).waitFor();
    await watchdog;
    await makeStopPending();
    await list().getByRole("button", { name: "Dismiss the stop of tmcm-171 1" }).click();
    const form = list().getByRole("form");
    await form.getByLabel("Reason").selectOption("drive_gone");
    await form.getByRole("button", { name: "Dismiss the stop" }).click();
    const told = await form.getByRole("alert").innerText();
    expect(told).toContain("no client has the lease of this axis");
    expect(told).toContain("gateway.lease");
    expect(await pendingStop()).not.toBeNull();
    await supply(24);
    await list().waitFor({ state: "detached" });
    await release();
  });
});

describe("a drive that was removed while its stop was pending", () => {
  let drive: Drive;
  let late: Visitor;
  const region = () => late.page.getByRole("region", { name: "Stop" });

  beforeAll(async () => {
    drive = await Drive.start("tmcl:1");
    late = await Visitor.come("sim:tmcl", drive.url);
    await late.page.goto(late.server.url);
    await late.card(1).waitFor();
    const held = await Held.take(late.server.program, 1);
    await held.command("arm");
    await held.command("velocity", { velocity: 20 });
    held.letGo();
    await drive.takeAway();
    await late.until(
      async () => JSON.stringify(await late.server.program.get<AxisReply>("/axes/1")),
      (text) => !text.includes('"pending_stop":null'),
    );
    await late.server.crash();
    await late.server.again();
  });
  afterAll(async () => {
    await late?.leave();
    await drive?.takeAway();
  });

  it("is named in red by the next server until a user confirms that it is gone", async () => {
    const title = `Axis 1 · ${drive.url}`;
    await late.until(
      () => region().innerText(),
      (text) => text.includes(title) && text.includes("the previous server"),
    );
    await late.shot("pending-stop-missing");
    await region()
      .getByRole("button", { name: `Dismiss the stop of ${title}` })
      .click();
    const form = region().getByRole("form", { name: `Dismiss the stop of ${title}` });
    await form.getByLabel("Reason").selectOption("The drive was removed, or has no supply");
    await form.getByRole("button", { name: "Dismiss the stop" }).click();
    await region().waitFor({ state: "detached" });
    const end = await ended(late, ({ detail }) => detail.link === drive.url);
    expect(end.detail).toMatchObject({ how: "dismissed", number: 1, link: drive.url });
  });
});
