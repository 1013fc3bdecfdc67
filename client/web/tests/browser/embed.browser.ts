import { describe, expect, inject, it } from "vitest";
import { sharedChromium } from "../support/chromium.js";
import { meanDifference, openViewer, pictureOf } from "./support.js";

const size = { width: 96, height: 72 };
const browser = await sharedChromium();

describe("the element on another page", () => {
  it("shows what the viewer's page shows, without controls", async () => {
    const page = await browser.newPage({ viewport: { width: 480, height: 360 } });
    await page.goto(`${inject("site")}/pages/embed.html`);
    await page.waitForFunction(() => document.querySelector("lambent-viewer")?.viewer != null);
    await page.evaluate(() => document.querySelector("lambent-viewer")!.ready);
    const found = await page.evaluate(() => {
      const viewer = document.querySelector("lambent-viewer")!;
      const root = viewer.shadowRoot!;
      return {
        state: viewer.state,
        label: root.querySelector("canvas")!.ariaLabel,
        panel: root.querySelector(".panel") !== null,
      };
    });
    expect(found.panel).toBe(false);
    expect(found.label).toContain("A box on a board");
    expect(found.state.turn.yawDeg).toBe(30);
    const shown = await pictureOf(page, size);
    const parameters = { env: "preset:sky", rotate: "30,0,0" };
    const other = await openViewer(browser, parameters, "data/bundle/", { width: 320, height: 240 });
    expect(meanDifference(await pictureOf(other, size), shown)).toBe(0);
  });

  it("gives everything back when it is taken out of the page, and comes again", async () => {
    const page = await browser.newPage({ viewport: { width: 320, height: 240 } });
    await page.goto(`${inject("site")}/pages/embed.html`);
    await page.waitForFunction(() => document.querySelector("lambent-viewer")?.viewer != null);
    await page.evaluate(() => document.querySelector("lambent-viewer")!.ready);
    const again = await page.evaluate(async () => {
      const viewer = document.querySelector("lambent-viewer")!;
      viewer.remove();
      const gone = viewer.viewer === null && viewer.shadowRoot!.childElementCount === 0;
      document.body.append(viewer);
      await viewer.ready;
      return [gone, viewer.viewer?.bundle?.name];
    });
    expect(again).toEqual([true, "analytic"]);
  });
});
