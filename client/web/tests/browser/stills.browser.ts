import type { Page } from "playwright-core";
import { beforeAll, describe, expect, it } from "vitest";
import { readExr } from "../../src/light/exrInput.js";
import type { ViewCamera } from "../../src/render/looks.js";
import { sharedChromium } from "../support/chromium.js";
import { announcements, fixedView, keep, meanDifference, openViewer, pictureOf } from "./support.js";

// More than one part in either direction.
const size = { width: 260, height: 240 };
const browser = await sharedChromium();
let page: Page;

beforeAll(async () => {
  page = await openViewer(
    browser,
    { ...fixedView, env: "preset:sunset", background: "colour" },
    "data/bundle/",
    {
      width: 900,
      height: 700,
    },
  );
  await page.evaluate(() => {
    const viewer = document.querySelector("lambent-viewer")!.viewer!;
    viewer.refineOptions = { ...viewer.refineOptions, workers: 1, samplesPerPixel: 64, relativeError: 0.01 };
  });
});

async function refined(asked: typeof size | ViewCamera): Promise<{ picture: Uint8Array; parts: number[] }> {
  const [text, parts] = await page.evaluate(async (wanted) => {
    const seen = new Set<string>();
    const element = document.querySelector("lambent-viewer")!;
    const { data } = await element.refinedPicture(wanted, {
      onProgress: (part, all) => seen.add(`${part} ${all}`),
    });
    let binary = "";
    for (let at = 0; at < data.length; at += 32768) {
      binary += String.fromCharCode(...data.subarray(at, at + 32768));
    }
    return [btoa(binary), [...seen].flatMap((each) => each.split(" ").map(Number))] as const;
  }, asked);
  return { picture: Uint8Array.from(Buffer.from(text, "base64")), parts };
}

/** Return the mean step between neighbours in a column, and that of the columns beside it. */
function stepAt(picture: Uint8Array, column: number): number {
  let sum = 0;
  for (let row = 0; row < size.height; row++) {
    const at = 4 * (row * size.width + column);
    for (let channel = 0; channel < 3; channel++)
      sum += Math.abs(picture[at + channel]! - picture[at - 4 + channel]!);
  }
  return sum / (3 * size.height);
}

describe("a refined picture", () => {
  it("in several parts is that of one part, in any size, and has no seams", {
    timeout: 300_000,
  }, async () => {
    const { picture, parts } = await refined(size);
    expect(parts).toEqual([1, 4, 2, 4, 3, 4, 4, 4]);
    keep("still_parts", picture, size.width);
    const baked = await pictureOf(page, size);
    keep("still_baked", baked, size.width);
    // Half the size is one part.
    const half = { width: size.width / 2, height: size.height / 2 };
    const one = await refined(half);
    expect(one.parts).toEqual([1, 1]);
    const smaller = new Uint8Array(4 * half.width * half.height);
    for (let pixel = 0; pixel < half.width * half.height; pixel++) {
      const corner = 2 * Math.floor(pixel / half.width) * size.width + 2 * (pixel % half.width);
      for (let c = 0; c < 4; c++) {
        const at = (offset: number): number => picture[4 * (corner + offset) + c]!;
        smaller[4 * pixel + c] = (at(0) + at(1) + at(size.width) + at(size.width + 1)) / 4;
      }
    }
    const apart = meanDifference(smaller, one.picture);
    const fromBaked = meanDifference(picture, baked);
    const seam = stepAt(picture, 224);
    const beside = (stepAt(picture, 222) + stepAt(picture, 226)) / 2;
    console.log({ apart, fromBaked, seam, beside });
    expect(fromBaked).toBeGreaterThan(0.3);
    expect(apart).toBeLessThan(1.5);
    expect(seam).toBeLessThan(beside + 1);
  });

  it.each([
    ["another light", "light"],
    ["another bundle", "bundle"],
    ["a graphics card that is taken away", "card"],
    ["an element that is taken out", "element"],
  ] as const)("is given up for %s, and says so", async (_, what) => {
    const own = await openViewer(browser, { ...fixedView, env: "preset:studio" }, "data/bundle/", {
      width: 320,
      height: 240,
    });
    const code = await own.evaluate(async (change) => {
      const element = document.querySelector("lambent-viewer")!;
      element.viewer!.refineOptions = { ...element.viewer!.refineOptions, workers: 1 };
      let picture: Promise<string | undefined> = Promise.resolve("not begun");
      await new Promise<void>((reached) => {
        picture = element.refinedPicture({ width: 600, height: 500 }, { onProgress: () => reached() }).then(
          () => "made",
          (error: Error & { code?: string }) => error.code,
        );
      });
      if (change === "light") await element.update({ environment: "preset:even" });
      if (change === "bundle") await element.show("data/golden/ball.relight.zip");
      if (change === "card") {
        const gl = element.viewer!.canvas.getContext("webgl2")!;
        gl.getExtension("WEBGL_lose_context")!.loseContext();
      }
      if (change === "element") element.remove();
      const late = new Promise<string>((resolve) => setTimeout(() => resolve("nothing"), 20_000));
      return Promise.race([picture, late]);
    }, what);
    expect(code).toBe("refine.interrupted");
    await own.close();
  });

  it("of a camera is that of the view from there, wherever one looks from now", async () => {
    const small = { width: 65, height: 60 };
    const there = (await refined(small)).picture;
    const camera = await page.evaluate((asked) => {
      const { viewer } = document.querySelector("lambent-viewer")!;
      return viewer!.camera(asked.width, asked.height);
    }, small);
    const turn = (degrees: number) =>
      page.evaluate((by) => {
        const viewer = document.querySelector("lambent-viewer")!;
        const { pose } = viewer.state;
        return viewer.update({ pose: { ...pose, azimuthDeg: pose.azimuthDeg + by } });
      }, degrees);
    await turn(70);
    const here = (await refined(small)).picture;
    const again = (await refined(camera)).picture;
    await turn(-70);
    const [moved, apart] = [meanDifference(here, there), meanDifference(again, there)];
    console.log({ moved, apart });
    expect(moved).toBeGreaterThan(4);
    expect(apart).toBeLessThan(moved / 4);
  });

  it("is saved in the size that was asked for, with its progress, and can be cancelled", async () => {
    await page.evaluate(() => document.querySelector("lambent-viewer")!.update({ refine: true }));
    await page.click("summary:text-is('Save')");
    await page.getByLabel("Width (pixels)").fill("48");
    await page.getByLabel("Height (pixels)").fill("36");
    const announced = await announcements(page);
    for (const kind of ["PNG", "EXR"]) {
      const [download] = await Promise.all([page.waitForEvent("download"), page.click(`text=Save ${kind}`)]);
      const chunks: Buffer[] = [];
      for await (const chunk of await download.createReadStream()) chunks.push(chunk as Buffer);
      const file = new Uint8Array(Buffer.concat(chunks));
      if (kind === "EXR") {
        const { width, height } = await readExr(file, 48 * 36);
        expect([width, height]).toEqual([48, 36]);
      } else {
        const head = new DataView(file.buffer, file.byteOffset);
        expect([head.getUint32(16), head.getUint32(20)]).toEqual([48, 36]);
      }
      await page.getByRole("dialog").waitFor({ state: "detached" });
    }
    // One part each, and not every number of directions.
    expect(await announced()).toEqual(["100 %", "100 %"]);
    await page.setViewportSize({ width: 700, height: 400 });
    await page.getByLabel("Width (pixels)").fill("4000");
    await page.getByLabel("Height (pixels)").fill("3000");
    await page.click("text=Save PNG");
    const dialog = page.getByRole("dialog", { name: "Refining a picture" });
    await dialog.getByText(/Part \d+ of 252/).waitFor();
    expect(await dialog.getByText("Starting…").count()).toBe(0);
    await dialog.getByRole("button", { name: "Cancel" }).click();
    await dialog.waitFor({ state: "detached" });
    expect(await page.locator("[data-problem]").count()).toBe(0);
    // What is shown is refined again.
    await page.waitForFunction(
      () => document.querySelector("lambent-viewer")!.viewer!.refined !== null,
      null,
      { timeout: 120_000 },
    );
  });
});
