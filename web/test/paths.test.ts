// Stored paths of a TS: edited, checked, plotted, loaded and run.

import { afterAll, afterEach, beforeAll, describe, expect, it } from "vitest";
import { BRIEF, Visitor } from "./browser";

let v: Visitor;

beforeAll(async () => {
  v = await Visitor.come("sim:syntron-ts?fn00=14", "sim:tmcl:1");
  await v.page.goto(v.server.url);
  await v.card(1).waitFor();
});
afterAll(async () => v?.leave());
afterEach(() => v.content());

const field = (name: string) => v.page.getByLabel(name, { exact: true });

describe("stored paths", () => {
  it("are read, edited and checked", async () => {
    await v.card(0).getByRole("button").first().click();
    await v.page.getByText("Stored paths").click();
    await v.button("Add a path").click();
    await v.button("Add a path").click();
    await field("Position [deg], path 1").fill("720");
    await field("Kind, path 1").selectOption("auto");
    await field("Next, path 1").fill("5");
    await v.button("Check and plot").click();
    await v.page.getByText("it leads to path 5, which is empty").waitFor();
    expect(await v.button("Load into the drive").isDisabled()).toBe(true);
    await field("Next, path 1").fill("2");
    await field("Position [deg], path 2").fill("30");
    await v.button("Check and plot").click();
    await v.page.getByText("1 -> 2", { exact: true }).waitFor();
    expect(await v.page.getByRole("img", { name: "Speed [rpm]" }).count()).toBe(1);
    await v.page.getByRole("img", { name: "Speed [rpm]" }).scrollIntoViewIfNeeded();
    await v.shot("paths");
    await v.picture("paths");
  });

  it("are loaded after a plan, and run", async () => {
    await v.withControl(
      () => v.button("Load into the drive").click(BRIEF),
      () => v.page.getByText("Applied and read back").isVisible(),
    );
    const run = v.button("Run path 1");
    await v.withControl(
      async () => {
        await v.ready();
        await run.click(BRIEF);
      },
      async () => Math.abs(await v.speed(0)) > 5,
    );
    await v.stands(0);
    await v.giveBack();
  });

  it("are offered for drives that store them only", async () => {
    await v.card(1).getByRole("button").first().click();
    await v.page.getByText("Device information").waitFor();
    expect(await v.page.getByText("Stored paths").count()).toBe(0);
  });
});
