// A server that dies, hangs, or is started again: what the page says of it, and what STOP is worth.

import { afterAll, beforeAll, describe, expect, it } from "vitest";
import { Visitor } from "./browser";

let v: Visitor;

beforeAll(async () => {
  v = await Visitor.come("sim:tmcl", "sim:modbus-rtu");
  await v.page.goto(v.server.url);
  await v.card(1).waitFor();
});
afterAll(async () => v?.leave());

describe("a server that is gone", () => {
  const banner = () => v.page.getByRole("region", { name: "Stop" });
  const says = (...words: string[]) =>
    v.until(
      () => banner().innerText(),
      (text) => words.every((word) => text.includes(word)),
    );
  const connected = async () => {
    await v.until(
      () => v.page.getByRole("banner").getByRole("status").innerText(),
      (text) => text.includes("connected"),
    );
    // What could not be reached meanwhile is complained of, as it should be.
    v.complaints = [];
  };
  const locked = async () => {
    const { lock } = await v.server.program.get<{ lock: unknown }>("/bench");
    return lock !== null;
  };

  it("is reported at once and large, with axes that may turn and advice", async () => {
    await v.spin("120");
    await v.until(
      () => v.card(0).innerText(),
      (text) => text.includes("moving"),
    );
    await v.server.crash();
    const text = await says("No connection to the server", "cut its supply", "tmcm-171 1");
    expect(text).toContain("Turning at the last reading");
    expect(text).not.toMatch(/by itself(?! only where)/);
    const title = banner().getByText("No connection to the server");
    expect(await title.evaluate((it) => Number.parseFloat(getComputedStyle(it).fontSize))).toBe(17);
    // Nothing is offered that cannot be done, and no drive is blamed for the server.
    expect(await v.button("Take control").isDisabled()).toBe(true);
    expect(await v.card(0).innerText()).toContain("was moving");
    expect(await v.page.getByText("are its supply and its cable sound").count()).toBe(0);
    expect(await v.serious()).toEqual([]);
    await v.picture("gone");
  });

  it("executes no stop, and the page reports that at once", async () => {
    await v.button(/STOP ALL/).click();
    await says("STOP ALL: NOT DELIVERED", "cut its supply", "repeated as soon as");
    await v.shot("not-sent");
    expect(await banner().innerText()).not.toContain("no reply yet");
  });

  it("accepts the page after a restart, and gets the pending stop", async () => {
    await v.server.again();
    await says("Motion is locked", "all axes at standstill");
    expect(await banner().innerText()).not.toContain("NOT DELIVERED");
    expect(await locked()).toBe(true);
    await connected();
    await v.button("Release motion").click();
    await banner().waitFor({ state: "detached" });
  });

  it("gets no stop that the user dismissed", async () => {
    await v.server.crash();
    await says("No connection to the server");
    await v.page.keyboard.press("Escape");
    await says("NOT DELIVERED");
    await banner().getByRole("button", { name: "Close" }).click();
    await v.server.again();
    await banner().waitFor({ state: "detached" });
    await connected();
    expect(await locked()).toBe(false);
  });

  it("that hangs does not leave a stop unconfirmed for ever", async () => {
    await v.server.freeze();
    await v.page.keyboard.press("Escape");
    await says("STOP ALL: NO REPLY", "cut its supply");
    v.server.resume();
    await says("Motion is locked", "all axes at standstill");
    expect(await banner().innerText()).not.toContain("NO REPLY");
    await v.button("Release motion").click();
    await banner().waitFor({ state: "detached" });
    await connected();
  });

  it("that rejects the page's session is reported once, with the login", async () => {
    await v.server.crash();
    await v.server.again({ forgets: true });
    await says("Not logged in: the server does not execute stops of this page", "cut its supply");
    await v.button(/STOP ALL/).click();
    await says("STOP ALL: NOT EXECUTED", "gateway.token", "Log in below");
    expect(await locked()).toBe(false);
    expect(await v.serious()).toEqual([]);
    await v.shot("logged-out");
    await v.page.getByLabel("Token").fill(v.server.token);
    await v.button("Log in").click();
    await says("Motion is locked", "all axes at standstill");
    await v.button("Release motion").click();
    await banner().waitFor({ state: "detached" });
    await connected();
  });
});
