import { mkdirSync } from "node:fs";
import { join, resolve } from "node:path";
import type { Page } from "playwright-core";
import { beforeAll, describe, expect, inject, it } from "vitest";
import de from "../../src/words/de.json";
import { sharedChromium } from "../support/chromium.js";
import { englishOn, overflowing, saidOn } from "../support/englishTexts.js";
import { openViewer } from "./support.js";

const pictures = resolve(import.meta.dirname, "../../build/browser-tests");

const browser = await sharedChromium();

beforeAll(async () => {
  mkdirSync(pictures, { recursive: true });
});

async function opened(locale: string, width: number, height: number, src?: null): Promise<Page> {
  const context = await browser.newContext({ locale, viewport: { width, height }, reducedMotion: "reduce" });
  return openViewer(context, { env: "preset:studio" }, src === null ? null : "data/bundle/");
}

/** Open all parts of the panel. */
async function unfold(page: Page): Promise<void> {
  await page.evaluate(() => {
    const root = document.querySelector("lambent-viewer")!.shadowRoot!;
    for (const part of root.querySelectorAll("details")) part.open = true;
  });
}

describe("in a German browser the viewer", () => {
  it.each([
    [390, 844],
    [1280, 800],
  ])("speaks German, and all of it fits %i x %i pixels", async (width, height) => {
    const page = await opened("de-AT", width, height);
    expect(await page.evaluate(() => document.documentElement.lang)).toBe("de-AT");
    await page.screenshot({ path: join(pictures, `viewer-de-${width}-closed.png`) });
    await unfold(page);
    const said = await saidOn(page);
    const { controls, resetLight, channels, help } = de.texts.panel;
    expect(said).toEqual(expect.arrayContaining([controls, resetLight, channels.albedo, help, "Studio"]));
    expect(await englishOn(page)).toEqual([]);
    expect(await overflowing(page, ".panel")).toEqual([]);
    expect(await page.evaluate(() => document.documentElement.scrollWidth - innerWidth)).toBe(0);
    await page.screenshot({ path: join(pictures, `viewer-de-${width}.png`) });
    await page.click(`text=${de.texts.panel.film}`);
    await page.getByRole("dialog", { name: de.texts.film.title }).getByText("120 Bilder").waitFor();
    expect(await englishOn(page)).toEqual([]);
    expect(await overflowing(page, "dialog")).toEqual([]);
    await page.screenshot({ path: join(pictures, `viewer-de-${width}-film.png`) });
    await page.context().close();
  });

  it("says in German what its workers found wrong, and before there is a bundle", async () => {
    const page = await opened("de", 640, 480, null);
    const invited = await page.evaluate(() => {
      const viewer = document.querySelector("lambent-viewer")!;
      const drag = (name: string) => viewer.dispatchEvent(new DragEvent(name, { cancelable: true }));
      drag("dragover");
      const { content } = getComputedStyle(viewer.shadowRoot!.querySelector(".dropping")!, "::after");
      drag("dragleave");
      return content;
    });
    expect(invited).toBe(JSON.stringify(de.texts.viewer.drop));
    await page.waitForFunction(
      (text) =>
        document.querySelector("lambent-viewer")!.shadowRoot!.querySelector("h1")?.textContent === text,
      de.texts.viewer.invite,
    );
    expect(await englishOn(page)).toEqual([]);
    const failed = await page.evaluate(
      (address) =>
        document
          .querySelector("lambent-viewer")!
          .show(address)
          .then(String, (error: Error) => error.message),
      `${inject("site")}/data/nothing/`,
    );
    expect(failed).toMatch(/^"?.*manifest\.json.* existiert nicht; die Adresse des Ordners angeben/);
    expect(await englishOn(page)).toEqual([]);
    await page.context().close();
  });
});

describe("in any other browser the viewer", () => {
  it("speaks English", async () => {
    const page = await opened("fr-FR", 1280, 800);
    expect(await page.evaluate(() => document.documentElement.lang)).toBe("en");
    expect(await saidOn(page)).toEqual(expect.arrayContaining(["Controls", "Reset light", "Studio"]));
    await page.screenshot({ path: join(pictures, "viewer-en-1280-closed.png") });
    await unfold(page);
    expect(await overflowing(page, ".panel")).toEqual([]);
    await page.screenshot({ path: join(pictures, "viewer-en-1280.png") });
    await page.context().close();
  });
});

describe("the element on another page", () => {
  it.each([
    ["<html lang=en>", "<lambent-viewer controls lang=de>", "Einstellungen"],
    ["<html lang=de-CH>", "<lambent-viewer controls>", "Einstellungen"],
    ["<html lang=fr>", "<lambent-viewer controls>", "Controls"],
    ["<html>", "<lambent-viewer controls>", "Controls"],
  ])("speaks as the page does: %s %s", async (html, element, said) => {
    // What the browser speaks is of no account there.
    const context = await browser.newContext({ locale: "de-DE" });
    const page = await context.newPage();
    const address = `${inject("site")}/viewer.html?shop`;
    await page.route(address, (route) =>
      route.fulfill({
        contentType: "text/html",
        body: `<!doctype html>${html}<script type=module src=lambent-viewer.js></script>${element}`,
      }),
    );
    await page.goto(address);
    await page.waitForFunction(() => document.querySelector("lambent-viewer")?.viewer != null);
    expect(
      await page.evaluate(() => document.querySelector("lambent-viewer")!.shadowRoot!.textContent),
    ).toContain(said);
    await context.close();
  });
});
