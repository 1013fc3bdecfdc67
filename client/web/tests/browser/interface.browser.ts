import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import type { Page } from "playwright-core";
import { beforeAll, describe, expect, inject, it } from "vitest";
import { readExr } from "../../src/light/exrInput.js";
import { sharedChromium } from "../support/chromium.js";
import { change, fixedView, fixtureFile, meanDifference, openViewer, pictureOf, stateOf } from "./support.js";

const size = { width: 96, height: 72 };
const browser = await sharedChromium();
let page: Page;

const state = () => stateOf(page);
const update = (part: object) => change(page, part);
const message = () =>
  page.evaluate(
    () => document.querySelector("lambent-viewer")!.shadowRoot!.querySelector(".message")!.textContent,
  );

/** Drop files onto the viewer, as a person does. */
async function drop(files: readonly { readonly name: string; readonly data: Buffer }[]): Promise<void> {
  const given = files.map(({ name, data }) => ({ name, data: data.toString("base64") }));
  await page.evaluate((all) => {
    const transfer = new DataTransfer();
    for (const { name, data } of all) {
      transfer.items.add(new File([Uint8Array.from(atob(data), (c) => c.charCodeAt(0))], name));
    }
    const viewer = document.querySelector("lambent-viewer")!;
    viewer.dispatchEvent(new DragEvent("drop", { dataTransfer: transfer, bubbles: true, cancelable: true }));
  }, given);
}

beforeAll(async () => {
  page = await openViewer(browser, { ...fixedView, env: "preset:studio" }, "data/bundle/", {
    width: 480,
    height: 360,
  });
});

describe("channels", () => {
  it("all show something else", async () => {
    const names = [
      "final",
      "direct",
      "indirect",
      "visibility",
      "albedo",
      "roughness",
      "metalness",
      "normal",
      "depth",
    ];
    const { look } = await state();
    const pictures: Uint8Array[] = [];
    for (const channel of names) {
      await update({ look: { ...look, channel, background: "transparent" } });
      pictures.push(await pictureOf(page, size, 1));
    }
    await update({ look });
    pictures.forEach((picture, index) => {
      for (const other of pictures.slice(index + 1))
        expect(meanDifference(picture, other)).toBeGreaterThan(0.1);
    });
  });
});

describe("environments", () => {
  it("are lit by a map that is dropped", async () => {
    const before = await pictureOf(page, size, 1);
    await drop([{ name: "spots.exr", data: fixtureFile("spots.exr") }]);
    await page.waitForFunction(
      () => document.querySelector("lambent-viewer")!.state.environment === "file:spots.exr",
    );
    await page.waitForFunction(() =>
      document
        .querySelector("lambent-viewer")!
        .shadowRoot!.querySelector(".message")!
        .textContent?.includes("Lit by"),
    );
    expect(meanDifference(before, await pictureOf(page, size, 1))).toBeGreaterThan(2);
  });

  it("are lit anew by a map that was changed and is dropped again under its name", async () => {
    const before = await pictureOf(page, size, 1);
    const even = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n\x80\x80\x80\x81\x80\x80\x80\x81";
    await drop([{ name: "spots.exr", data: Buffer.from(even, "latin1") }]);
    await page.waitForFunction(() => {
      const told = document
        .querySelector("lambent-viewer")!
        .shadowRoot!.querySelector(".message")!.textContent;
      return told?.includes("Lit by");
    });
    await expect.poll(async () => meanDifference(before, await pictureOf(page, size, 1))).toBeGreaterThan(2);
  });

  it("that cannot be used are refused, and the light stays", async () => {
    const before = await state();
    await drop([{ name: "broken.exr", data: Buffer.from("v/1\x01nothing of use", "latin1") }]);
    await page.waitForFunction(() =>
      document.querySelector("lambent-viewer")!.shadowRoot!.querySelector("[data-problem]"),
    );
    expect(await message()).toContain("environment.exr_damaged");
    expect((await state()).environment).toBe(before.environment);
    await drop([{ name: "notes.txt", data: Buffer.from("hello") }]);
    await page.waitForFunction(() =>
      document
        .querySelector("lambent-viewer")!
        .shadowRoot!.querySelector(".message")!
        .textContent?.startsWith("This is neither"),
    );
  });
});

describe("maps of other hosts", () => {
  it("that the page may not read are refused with the cause and a remedy", async () => {
    const before = await state();
    const url = `${inject("site").replace("127.0.0.1", "localhost")}/data/spots.exr`;
    const told = await page.evaluate(async (given) => {
      try {
        await document.querySelector("lambent-viewer")!.update({ environment: `url:${given}` });
        return "lit";
      } catch (error) {
        const { code, message } = error as Error & { code: string };
        return `${code}: ${message}`;
      }
    }, url);
    expect(told).toMatch(
      /^environment\.blocked: .*localhost.*; download the environment map and drop it here$/,
    );
    expect((await state()).environment).toBe(before.environment);
  });
});

describe("pictures", () => {
  it("as PNG are what is seen", async () => {
    await openPart("Controls");
    await openPart("Save");
    await page.getByLabel("Width (pixels)").fill(String(size.width));
    await page.getByLabel("Height (pixels)").fill(String(size.height));
    const [download] = await Promise.all([
      page.waitForEvent("download"),
      page.getByRole("button", { name: "Save PNG" }).click(),
    ]);
    const data = readFileSync(await download.path()).toString("base64");
    const pixels = await page.evaluate(async (text) => {
      const blob = new Blob([Uint8Array.from(atob(text), (c) => c.charCodeAt(0))], { type: "image/png" });
      const picture = await createImageBitmap(blob, { premultiplyAlpha: "none" });
      const context = new OffscreenCanvas(picture.width, picture.height).getContext("2d")!;
      context.drawImage(picture, 0, 0);
      return [...context.getImageData(0, 0, picture.width, picture.height).data];
    }, data);
    expect(meanDifference(Uint8Array.from(pixels), await pictureOf(page, size))).toBeLessThan(0.01);
  });

  it("as EXR hold linear radiance", async () => {
    const { look } = await state();
    await update({ look: { ...look, tone: "linear", background: "transparent", exposureEv: 1 } });
    const [download] = await Promise.all([
      page.waitForEvent("download"),
      page.getByRole("button", { name: "Save EXR" }).click(),
    ]);
    const map = await readExr(Uint8Array.from(readFileSync(await download.path())), 1 << 20);
    const shown = await pictureOf(page, size);
    let worst = 0;
    map.radianceRgb.forEach((value, index) => {
      const pixel = Math.floor(index / 3);
      if (shown[4 * pixel + 3] !== 255) return;
      const encoded = value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055;
      worst = Math.max(worst, Math.abs(255 * Math.min(encoded, 1) - shown[4 * pixel + (index % 3)]!));
    });
    await update({ look });
    expect(worst).toBeLessThanOrEqual(1.01);
  });
});

/** Open a part of the panel. */
async function openPart(title: string): Promise<void> {
  await page.evaluate((name) => {
    for (const part of document.querySelector("lambent-viewer")!.shadowRoot!.querySelectorAll("details")) {
      if (part.querySelector("summary")!.textContent === name) part.open = true;
    }
  }, title);
}

describe("addresses", () => {
  it("bring back camera, light and settings", async () => {
    await update({
      environment: "preset:sunset",
      turn: { yawDeg: 40, pitchDeg: 10, rollDeg: 0, intensity: 1.5 },
    });
    const before = await state();
    const parameters = await page.evaluate(() => document.querySelector("lambent-viewer")!.parameters);
    const shown = await pictureOf(page, size);
    const other = await openViewer(
      browser,
      { ...fixedView, ...Object.fromEntries(new URLSearchParams(parameters)) },
      "data/bundle/",
      {
        width: 480,
        height: 360,
      },
    );
    const after = await other.evaluate(() => document.querySelector("lambent-viewer")!.state);
    expect(after.turn).toEqual(before.turn);
    expect(after.look).toEqual(before.look);
    expect(meanDifference(await pictureOf(other, size), shown)).toBeLessThan(0.2);
    await other.close();
  });

  it("that a light cannot be fetched from leave the light before, as it stood", async () => {
    const other = await openViewer(browser, {}, "data/bundle/", { width: 320, height: 240 });
    const { before, after } = await other.evaluate(async () => {
      const element = document.querySelector("lambent-viewer")!;
      // Ends its first turn.
      element.dispatchEvent(new Event("pointerdown"));
      const before = element.state;
      const environment = `url:${new URL("data/nothing.exr", location.href).href}`;
      await element.update({ environment }).catch(() => {});
      return { before, after: element.state };
    });
    expect(after.environment).toBe("preset:softboxes");
    expect(before.turn.yawDeg).not.toBe(0);
    expect(after.turn).toEqual(before.turn);
    await other.close();
  });

  it("with a light that is gone show the object in another one, and say so", async () => {
    const other = await openViewer(browser, { ...fixedView, env: "url:data/nothing.exr" }, "data/bundle/", {
      width: 320,
      height: 240,
    });
    const found = await other.evaluate(() => {
      const viewer = document.querySelector("lambent-viewer")!;
      const told = viewer.shadowRoot!.querySelector("[data-problem]")?.textContent ?? "";
      return { name: viewer.viewer!.bundle?.name, light: viewer.state.environment, told };
    });
    expect(found.name).toBe("analytic");
    expect(found.light).toMatch(/^(trained|preset):/);
    expect(found.told).toContain("nothing.exr");
    expect(Math.max(...(await pictureOf(other, { width: 48, height: 36 })))).toBeGreaterThan(0);
    await other.close();
  });
});

describe("bundles", () => {
  it("open from an archive by ranges and show the same", async () => {
    const shown = await pictureOf(page, size);
    await page.evaluate(() => document.querySelector("lambent-viewer")!.show("data/bundle.relight.zip"));
    expect(meanDifference(await pictureOf(page, size), shown)).toBe(0);
  });

  it("that cannot be used say why, and the one before stays", async () => {
    await drop([{ name: "broken.relight.zip", data: Buffer.alloc(64) }]);
    await page.waitForSelector("[data-problem]:has-text('bundle.archive_damaged')");
    const code = await page.evaluate(async () => {
      try {
        await document.querySelector("lambent-viewer")!.show("data/nothing/");
        return "shown";
      } catch (error) {
        return (error as { code?: string }).code;
      }
    });
    expect(code).toBe("bundle.manifest_missing");
    expect(await page.evaluate(() => document.querySelector("lambent-viewer")!.viewer!.bundle?.name)).toBe(
      "analytic",
    );
  });
});

describe("for everyone", () => {
  it("axe finds nothing serious, on a wide and on a narrow page", async () => {
    const axe = createRequire(import.meta.url).resolve("axe-core/axe.min.js");
    for (const width of [900, 390]) {
      await page.setViewportSize({ width, height: 700 });
      for (const part of [
        "Controls",
        "Light",
        "Tilt of the light",
        "Picture",
        "Material",
        "Compare",
        "Save",
      ]) {
        await openPart(part);
      }
      await page.evaluate(readFileSync(axe, "utf8"));
      const found = await page.evaluate(async () => {
        const { axe: checker } = globalThis as unknown as {
          axe: {
            run: () => Promise<{ violations: { id: string; impact: string; nodes: { html: string }[] }[] }>;
          };
        };
        return (await checker.run()).violations
          .filter(({ impact }) => impact === "serious" || impact === "critical")
          .map(({ id, nodes }) => `${id}: ${nodes.map((node) => node.html.slice(0, 120)).join(" | ")}`);
      });
      expect(found).toEqual([]);
    }
  });

  it("every field has a name", async () => {
    const nameless = await page.evaluate(() =>
      [...document.querySelector("lambent-viewer")!.shadowRoot!.querySelectorAll("input, select, button")]
        .filter((field) => {
          const input = field as HTMLInputElement;
          return !input.ariaLabel && !input.labels?.length && !field.textContent?.trim();
        })
        .map((field) => field.outerHTML),
    );
    expect(nameless).toEqual([]);
  });
});

describe("without WebGL 2", () => {
  it("the page says so", async () => {
    const other = await browser.newPage();
    await other.addInitScript(() => {
      HTMLCanvasElement.prototype.getContext = () => null;
    });
    await other.goto(`${inject("site")}/viewer.html#src=${inject("site")}/data/bundle/`);
    await other.waitForSelector("[data-problem]:has-text('WebGL 2')");
    await other.close();
  });
});
