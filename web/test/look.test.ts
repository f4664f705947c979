// Drives that the connection string does not name: looked for, taken in, moved.

import { afterAll, afterEach, beforeAll, describe, expect, it } from "vitest";
import { BRIEF, Visitor } from "./browser";

const LOOK_MS = 240_000;
const AXE_MS = 240_000;

// Most addresses are silent: the server need not wait for them as long as elsewhere.
process.env.POLEPAIR_TIMEOUT_SCALE = "2";

let v: Visitor;

// Two modules that are not configured, and another link; TMCL hosts are 2.
beforeAll(async () => {
  v = await Visitor.come("sim:tmcl?axes=3&baud=115200#1", "sim:modbus-rtu");
  await v.page.goto(v.server.url);
  await v.card(1).waitFor();
});
afterAll(async () => v?.leave());
afterEach(() => v.content());

describe("looking for drives", () => {
  const group = () => v.page.getByRole("group", { name: /Scan sim:tmcl/ });

  it("shows its progress, can be cancelled, and leaves other links waiting", async () => {
    const look = group().getByRole("button", { name: "Scan for drives" });
    await look.focus();
    await v.page.keyboard.press("Enter");
    await group().getByRole("progressbar").waitFor();
    await v.until(
      () => group().innerText(),
      (text) => /#\d+ · \d+\/\d+/.test(text),
    );
    expect(await v.button("Scan for drives").last().isDisabled()).toBe(true);
    await group().getByRole("button", { name: "Cancel" }).click();
    await v.until(
      () => group().getByRole("status").innerText(),
      (text) => /Cancelled: \d+ addresses were not tried/.test(text),
    );
  });

  it("is refused with a reason while a user controls an axis of the link", async () => {
    await v.card(0).getByRole("button").first().click();
    await v.button("Take control").click();
    await v.button("Release control").waitFor();
    await group().getByRole("button", { name: "Scan for drives" }).click();
    await v.until(
      () => group().getByRole("alert").innerText(),
      (text) => text.includes("commands axis 1"),
    );
    await v.giveBack();
    // The refusal is an answer too, and a browser writes those of 409 down.
    v.complaints = v.complaints.filter((each) => !each.includes("409"));
  });

  it("finds both drives, and identifies them", { timeout: LOOK_MS }, async () => {
    await group().getByRole("button", { name: "Scan for drives" }).click();
    await v.until(
      () => group().getByRole("status").innerText(),
      (text) => text.endsWith("found: 2"),
      LOOK_MS,
    );
    const drives = group().getByRole("list", { name: "Found drives" });
    const text = await drives.innerText();
    for (const part of ["TMCM-171", "tmcl #3", "tmcl #4", "firmware"]) {
      expect(text).toContain(part);
    }
    await v.picture("look");
  });

  it("has no serious findings of axe", { timeout: AXE_MS }, async () => {
    expect(await v.serious()).toEqual([]);
  });

  it("adds a drive, and moves it", async () => {
    await v.button("Add tmcl #4").click();
    await v.until(
      () => group().innerText(),
      (text) => text.includes("added:"),
    );
    await v.page.getByRole("article").nth(2).waitFor();
    const card = v.page.getByRole("article").filter({ hasText: "tmcl #4" });
    await card.getByRole("button").first().click();
    const speed = async () => {
      const text = await card.getByRole("row", { name: "velocity" }).innerText();
      return Number(/(-?[\d.]+) rpm/.exec(text)?.[1] ?? Number.NaN);
    };
    await v.jog(speed);
    await v.page.mouse.up();
    await v.until(speed, (rpm) => Math.abs(rpm) < 1);
  });

  it("names a drive that no longer answers", { timeout: LOOK_MS }, async () => {
    // A scan is refused while a drive is powered, armed or commanded, so all of it ends before.
    const card = v.page.getByRole("article").filter({ hasText: "tmcl #4" });
    await v.withControl(
      () => v.button("Disable").click(BRIEF),
      async () => {
        const text = await card.innerText();
        return text.includes("disabled") && !text.includes("· armed");
      },
    );
    await v.giveBack();
    await v.server.program.post("/simulation/0/1", { act: "supply", value: 0 });
    const again = group().getByRole("button", { name: "Scan for drives" });
    await again.click();
    await group().getByRole("progressbar").waitFor();
    await v.until(
      () => group().innerText(),
      (text) => /did not reply; last reply \d+ s ago/.test(text),
      LOOK_MS,
    );
  });
});
