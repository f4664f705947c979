// The drive's own watchdog: what it does when its host falls silent, how that is set, and setting it.

import { afterAll, afterEach, beforeAll, describe, expect, it } from "vitest";
import { Visitor } from "./browser";
import type { Kept } from "./program";

interface Told {
  set: string;
  after_ms: number | null;
}

let v: Visitor;

beforeAll(async () => {
  v = await Visitor.come("sim:tmcl", "sim:cia402:5?heartbeat=100", "sim:modbus-rtu");
  await v.page.goto(v.server.url);
  await v.card(2).waitFor();
});
afterAll(async () => v?.leave());
afterEach(() => v.content());

const form = () => v.page.getByRole("form", { name: "If the host is silent" });
const says = (text: string) =>
  v.until(
    () => form().getByRole("status").innerText(),
    (now) => now === text,
  );
const choose = (at: number) => v.card(at).getByRole("button").first().click();
const told = (axis: number) => v.server.program.get<Told>(`/axes/${axis}/watchdog`);
const set = async (time: string, unit: string) => {
  await form().getByLabel("Stop after silence of").fill(time);
  await form().getByLabel("Unit").selectOption(unit);
  await form().getByRole("button", { name: "Set", exact: true }).click();
};

describe("the drive's own watchdog", () => {
  it("is shown with its present value, and set by the controlling user", async () => {
    await choose(0);
    await says("off: the motor continues to turn");
    expect(await form().innerText()).toContain("is kept in its permanent memory");
    expect(await form().getByRole("button", { name: "Set", exact: true }).isDisabled()).toBe(true);
    await v.button("Take control").click();
    await v.button("Release control").waitFor();
    await set("500", "ms");
    await says("on: the drive stops after 500 ms without messages");
    expect(await told(0)).toMatchObject({ set: "on", after_ms: 500 });
    const journal = await v.server.program.get<Kept[]>("/journal");
    const written = journal.findLast(({ deed, axis }) => deed === "parameters" && axis === 0);
    expect(written?.who).toMatch(/^operator \d+$/);
    expect(written?.detail).toEqual({ watchdog: "serial heartbeat", after_ms: 500 });
    await v.shot("watchdog");
  });

  it("is refused with a reason if the drive cannot have the value, and unchanged", async () => {
    await set("1e6", "s");
    const alert = await form().getByRole("alert").innerText();
    expect(alert).toContain("E216");
    // A browser writes refusals down.
    v.complaints = v.complaints.filter((each) => !each.includes("422"));
    expect(await told(0)).toMatchObject({ set: "on", after_ms: 500 });
    await form().getByRole("button", { name: "Switch off" }).click();
    await says("off: the motor continues to turn");
    expect(await told(0)).toMatchObject({ set: "off", after_ms: null });
    await v.giveBack();
  });

  it("needs a heartbeat if the drive monitors one, and the page shows it", async () => {
    await choose(1);
    // The server has it watch the heartbeat that it sends.
    await says("on: the drive stops after 300 ms without messages");
    expect(await form().innerText()).toContain("heartbeat=100");
    await v.button("Take control").click();
    await v.button("Release control").waitFor();
    await set("1.5", "s");
    await says("on: the drive stops after 1500 ms without messages");
    expect(await told(1)).toMatchObject({ set: "on", after_ms: 1500 });
    await v.giveBack();
    // It is read anew each time that the axis is shown.
    await choose(0);
    await says("off: the motor continues to turn");
    await choose(1);
    await says("on: the drive stops after 1500 ms without messages");
    expect(await v.serious()).toEqual([]);
  });

  it("is not offered if the drive has none", async () => {
    await choose(2);
    await says("none: the motor continues to turn");
    expect(await form().getByRole("button").count()).toBe(1);
  });
});
