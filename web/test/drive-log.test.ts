// Step responses that the drive records in its own control loop.

import { afterAll, afterEach, beforeAll, describe, expect, it } from "vitest";
import { BRIEF, Visitor } from "./browser";

let v: Visitor;

beforeAll(async () => {
  v = await Visitor.come("sim:tmlcan:1", "sim:tmcl:1");
  await v.page.goto(v.server.url);
  await v.card(1).waitFor();
});
afterAll(async () => v?.leave());
afterEach(() => v.content());

const rate = () => v.page.getByRole("combobox", { name: "Requested rate" });
const rows = (signal: string) => v.page.getByRole("row", { name: new RegExp(`${signal} .* → `) });

describe("a step that the drive records", () => {
  it("needs that the inferred layout is accepted", async () => {
    await v.card(0).getByRole("button").first().click();
    await v.tab("Tuning");
    await rate().selectOption({ label: "1000 Hz, at most 0.354 s" });
    await v.withControl(
      () => v.page.getByRole("checkbox", { name: "accept an inferred layout" }).check(BRIEF),
      () => v.button("Step").isEnabled(),
    );
  });

  it("has the drive's own rate and its commanded course", async () => {
    for (const signal of ["velocity", "position"]) {
      await v.page.getByRole("combobox", { name: "Step of" }).selectOption(signal);
      await v.withControl(
        () => v.button("Step").click(BRIEF),
        async () => (await rows(signal).count()) >= 1,
      );
      const row = await rows(signal).nth(0).innerText();
      expect(row).toContain("1000 Hz");
      expect(row).toMatch(/\d ± \d+ ms|\d ms/);
      await v.stands(0);
    }
    await v.shot("drive-log");
  });

  it("is offered for drives with a recorder only", async () => {
    await v.card(1).getByRole("button").first().click();
    expect(await rate().innerText()).not.toContain("at most");
  });
});
