import type { BrowserContext, CDPSession, Page } from "playwright-core";
import { afterAll, beforeAll, describe, expect, inject, it } from "vitest";
import { sharedChromium } from "../support/chromium.js";
import { fixedView, keep, meanDifference, openViewer, pictureOf, stateOf } from "./support.js";

const size = { width: 96, height: 72 };
const small = { width: 320, height: 240 };
const browser = await sharedChromium();

describe("on a telephone", () => {
  let context: BrowserContext;
  let page: Page;
  let session: CDPSession;

  beforeAll(async () => {
    context = await browser.newContext({
      ...{ viewport: { width: 390, height: 700 }, hasTouch: true, isMobile: true },
      ...{ deviceScaleFactor: 1, reducedMotion: "reduce" },
    });
    page = await context.newPage();
    page.setDefaultTimeout(120_000);
    session = await context.newCDPSession(page);
    await page.goto(
      `${inject("site")}/viewer.html#src=data/bundle/&env=preset:even&${new URLSearchParams(fixedView)}`,
    );
    await page.waitForFunction(() => document.querySelector("lambent-viewer")?.viewer?.bundle != null);
    await page.evaluate(() => document.querySelector("lambent-viewer")!.ready);
  });
  afterAll(() => context.close());

  /** Move fingers from places to places. */
  async function fingers(from: readonly [number, number][], to: readonly [number, number][]): Promise<void> {
    const points = (places: readonly [number, number][]) => places.map(([x, y], id) => ({ x, y, id }));
    await session.send("Input.dispatchTouchEvent", { type: "touchStart", touchPoints: points(from) });
    for (const share of [0.25, 0.5, 0.75, 1]) {
      const between = from.map(([x, y], index): [number, number] => {
        const [endX, endY] = to[index]!;
        return [x + share * (endX - x), y + share * (endY - y)];
      });
      await session.send("Input.dispatchTouchEvent", { type: "touchMove", touchPoints: points(between) });
    }
    await session.send("Input.dispatchTouchEvent", { type: "touchEnd", touchPoints: [] });
  }

  it("the picture comes first: the controls are closed, and nothing is wider than the page", async () => {
    const found = await page.evaluate(() => {
      const root = document.querySelector("lambent-viewer")!.shadowRoot!;
      const [panel, canvas] = [
        root.querySelector<HTMLDetailsElement>(".panel")!,
        root.querySelector("canvas")!,
      ];
      return {
        open: panel.open,
        overflow: document.documentElement.scrollWidth - innerWidth,
        panelTop: panel.getBoundingClientRect().top,
        canvas: [canvas.clientWidth, canvas.clientHeight],
      };
    });
    expect(found.open).toBe(false);
    expect(found.overflow).toBeLessThanOrEqual(0);
    expect(found.canvas).toEqual([390, 700]);
    expect(found.panelTop).toBeGreaterThan(600);
  });

  it("one finger turns the camera", async () => {
    const before = await stateOf(page);
    await fingers([[120, 250]], [[160, 270]]);
    const after = await stateOf(page);
    // Seven tenths of a turn over the height of the picture.
    expect(after.pose.azimuthDeg).toBeCloseTo(before.pose.azimuthDeg - 14.4, 3);
    expect(after.pose.elevationDeg).toBeCloseTo(before.pose.elevationDeg + 7.2, 3);
    expect(after.pose.distance).toBe(before.pose.distance);
  });

  it("two fingers that part come nearer, and closer together go away", async () => {
    const before = await stateOf(page);
    await fingers(
      [
        [150, 300],
        [240, 300],
      ],
      [
        [105, 300],
        [285, 300],
      ],
    );
    const near = await stateOf(page);
    expect(near.pose.distance).toBeCloseTo(before.pose.distance / 2, 3);
    expect(near.pose.azimuthDeg).toBe(before.pose.azimuthDeg);
    await fingers(
      [
        [105, 300],
        [285, 300],
      ],
      [
        [150, 300],
        [240, 300],
      ],
    );
    expect((await stateOf(page)).pose.distance).toBeCloseTo(before.pose.distance, 3);
    // The page itself was neither scrolled nor enlarged.
    expect(await page.evaluate(() => [scrollY, visualViewport!.scale])).toEqual([0, 1]);
  });

  it("opened controls leave room for the picture, and can be hit by a finger", async () => {
    await page.tap("summary:text-is('Controls')");
    const found = await page.evaluate(() => {
      const root = document.querySelector("lambent-viewer")!.shadowRoot!;
      const panel = root.querySelector(".panel")!.getBoundingClientRect();
      const heights = [...root.querySelectorAll("select, button, summary")]
        .map((field) => field.getBoundingClientRect().height)
        .filter((height) => height > 0);
      return {
        free: panel.top,
        least: Math.min(...heights),
        overflow: document.documentElement.scrollWidth - innerWidth,
      };
    });
    expect(found.free).toBeGreaterThan(0.35 * 700);
    expect(found.least).toBeGreaterThanOrEqual(24);
    expect(found.overflow).toBeLessThanOrEqual(0);
  });

  it("where less motion is wanted nothing moves by itself", async () => {
    const found = await page.evaluate(async () => {
      const element = document.querySelector("lambent-viewer")!;
      const moving = [...element.shadowRoot!.querySelectorAll("*")].filter((each) => {
        const { transitionDuration, animationName } = getComputedStyle(each);
        return (
          transitionDuration.split(",").some((part) => Number.parseFloat(part) > 0) ||
          animationName !== "none"
        );
      });
      // Files and shadows that come late are drawn when they come: what turns by itself would never rest.
      element.viewer!.drawNow(2);
      let last = performance.now();
      const stop = element.viewer!.on("draw", () => {
        last = performance.now();
      });
      const until = last + 20_000;
      while (performance.now() < until && performance.now() - last < 1000) {
        await new Promise((resolve) => setTimeout(resolve, 50));
      }
      const rested = performance.now() - last >= 1000;
      stop();
      return { moving: moving.map((each) => each.className), rested };
    });
    expect(found).toEqual({ moving: [], rested: true });
  });
});

describe("a graphics card that is taken away", () => {
  it("is reported, and when it comes back everything is drawn as before", async () => {
    const page = await openViewer(
      browser,
      { ...fixedView, env: "preset:sky", ground: "1", background: "transparent" },
      "data/bundle/",
      { width: 320, height: 240 },
    );
    page.setDefaultTimeout(120_000);
    const before = await pictureOf(page, size);
    await page.evaluate(() => {
      const { canvas } = document.querySelector("lambent-viewer")!.viewer!;
      const lose = canvas.getContext("webgl2")!.getExtension("WEBGL_lose_context")!;
      Object.assign(globalThis, { lose });
      lose.loseContext();
    });
    await page.waitForSelector("[data-problem]:has-text('graphics card is not available')");
    await page.evaluate(() => {
      (globalThis as unknown as { lose: WEBGL_lose_context }).lose.restoreContext();
    });
    await page.waitForFunction(
      () =>
        document.querySelector("lambent-viewer")!.shadowRoot!.querySelector(".message")!.textContent === "",
    );
    expect(meanDifference(before, await pictureOf(page, size))).toBe(0);
    await page.close();
  });
});

describe("a card without targets of full floats, as in telephones", () => {
  it("shows the same picture", async () => {
    const before = await openViewer(
      browser,
      { ...fixedView, env: "preset:sky", ground: "1" },
      "data/bundle/",
      small,
    );
    const wanted = await pictureOf(before, size);
    const context = await browser.newContext({ viewport: small });
    await context.addInitScript(() => {
      const prototype = WebGL2RenderingContext.prototype;
      const plain = prototype.getExtension;
      // Extensions that were not requested are missing, whatever the card can do.
      prototype.getExtension = function (this: WebGL2RenderingContext, name: string) {
        return /^(EXT_color_buffer_float|OES_texture_float_linear|EXT_float_blend)$/.test(name)
          ? null
          : (plain as (name: string) => unknown).call(this, name);
      } as typeof plain;
    });
    const page = await openViewer(context, { ...fixedView, env: "preset:sky", ground: "1" });
    expect(meanDifference(await pictureOf(page, size), wanted)).toBe(0);
    const gl = await page.evaluate(() => {
      const { canvas } = document.querySelector("lambent-viewer")!.viewer!;
      return canvas.getContext("webgl2")!.getSupportedExtensions();
    });
    expect(gl).toContain("EXT_color_buffer_half_float");
    await before.close();
    await context.close();
  });
});

describe("a card without memory", () => {
  it("is reported, with what to do", async () => {
    const context = await browser.newContext({ viewport: small });
    await context.addInitScript(() => {
      let times = 0;
      const prototype = WebGL2RenderingContext.prototype;
      prototype.getError = () => (times++ % 2 === 0 ? WebGL2RenderingContext.OUT_OF_MEMORY : 0);
    });
    const page = await openViewer(context, {}, null);
    await page.evaluate(() => {
      document.querySelector("lambent-viewer")!.setAttribute("src", "data/bundle/");
    });
    await page.waitForSelector("[data-problem]:has-text('enough memory for the bundle; close other pages')");
    await context.close();
  });
});

describe("a card with small textures", () => {
  it("draws a large canvas and large pictures part by part", async () => {
    const context = await browser.newContext({ viewport: { width: 1480, height: 400 } });
    const plain = await openViewer(context, { ...fixedView, env: "preset:sunset", background: "colour" });
    await context.addInitScript(() => {
      const prototype = WebGL2RenderingContext.prototype;
      const parameter = prototype.getParameter;
      prototype.getParameter = function (this: WebGL2RenderingContext, name: number) {
        return name === WebGL2RenderingContext.MAX_TEXTURE_SIZE ? 2048 : parameter.call(this, name);
      };
      const sides: number[] = [];
      Object.assign(globalThis, { sides });
      for (const name of ["texImage2D", "texStorage2D", "renderbufferStorage"] as const) {
        const before = prototype[name] as (...given: unknown[]) => void;
        const [width, height] = { texImage2D: [3, 4], texStorage2D: [3, 4], renderbufferStorage: [2, 3] }[
          name
        ];
        Object.assign(prototype, {
          [name](this: WebGL2RenderingContext, ...given: number[]) {
            // A picture is sent without its size.
            if (given.length > 6 || name !== "texImage2D") sides.push(given[width!]!, given[height!]!);
            before.apply(this, given);
          },
        });
      }
    });
    const small = await openViewer(context, { ...fixedView, env: "preset:sunset", background: "colour" });
    const shown = (page: Page) =>
      page.evaluate(() => {
        const viewer = document.querySelector("lambent-viewer")!.viewer!;
        viewer.dither = false;
        viewer.drawNow(2);
        const { width, height } = viewer.canvas;
        const context = new OffscreenCanvas(width, height).getContext("2d")!;
        context.drawImage(viewer.canvas, 0, 0);
        return [...context.getImageData(0, 0, width, height).data];
      });
    const [wanted, found] = [Uint8Array.from(await shown(plain)), Uint8Array.from(await shown(small))];
    expect(wanted.length).toBeGreaterThan(4 * 1025 * 400);
    keep(
      "devices_tiles",
      found,
      await small.evaluate(() => document.querySelector("lambent-viewer")!.viewer!.canvas.width),
    );
    // The pattern of soft shadows begins anew in every part.
    expect(meanDifference(wanted, found)).toBeLessThan(0.05);
    const wide = { width: 8192, height: 8 };
    expect((await pictureOf(small, wide)).some((value, index) => index % 4 === 0 && value !== 237)).toBe(
      true,
    );
    const sides = await small.evaluate(() => (globalThis as unknown as { sides: number[] }).sides);
    expect(sides.length).toBeGreaterThan(20);
    expect(Math.max(...sides)).toBeLessThanOrEqual(2048);
    await context.close();
  });

  it("says that the bundle's tables do not fit, and what to do", async () => {
    const context = await browser.newContext({ viewport: small });
    await context.addInitScript(() => {
      const prototype = WebGL2RenderingContext.prototype;
      const plain = prototype.getParameter;
      prototype.getParameter = function (this: WebGL2RenderingContext, name: number) {
        return name === WebGL2RenderingContext.MAX_TEXTURE_SIZE ? 512 : plain.call(this, name);
      };
    });
    const page = await openViewer(context, {}, null);
    await page.evaluate(() => {
      document.querySelector("lambent-viewer")!.setAttribute("src", "data/bundle/");
    });
    await page.waitForSelector(
      "[data-problem]:has-text('takes textures of 512 texels a side, the bundle has tables of 1024; use another device')",
    );
    await context.close();
  });
});
