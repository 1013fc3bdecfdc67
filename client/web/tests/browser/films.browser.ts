import type { Browser, Page } from "playwright-core";
import { afterAll, beforeAll, describe, expect, it } from "vitest";
import { closePages, sharedChromium } from "../support/chromium.js";
import { openViewer } from "./support.js";

const size = { width: 120, height: 90 };
const seconds = 1.5;
let browser: Browser;
let page: Page;

beforeAll(async () => {
  browser = await sharedChromium();
  page = await openViewer(browser, { env: "preset:sky" }, "data/bundle/", size);
});
afterAll(() => closePages(browser));

type Played = {
  readonly type: string;
  readonly size: number[];
  readonly seconds: number;
  readonly frames: number;
};

/** Play a film on a page without a policy; returns what it is and how many different pictures it shows. */
async function play(film: string): Promise<Played> {
  const player = await browser.newPage();
  const played = await player.evaluate(async (text) => {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const video = document.createElement("video");
    video.muted = true;
    video.src = URL.createObjectURL(new Blob([bytes], { type: "video/webm" }));
    await new Promise((resolve, reject) => {
      video.onloadeddata = resolve;
      video.onerror = () => reject(new Error(video.error?.message));
    });
    const { videoWidth, videoHeight } = video;
    const context = new OffscreenCanvas(videoWidth, videoHeight).getContext("2d", {
      willReadFrequently: true,
    })!;
    const seen: Uint8ClampedArray[] = [];
    const look = (): void => {
      context.drawImage(video, 0, 0);
      const { data } = context.getImageData(0, 0, videoWidth, videoHeight);
      const before = seen.at(-1);
      const change = before?.reduce((sum, value, at) => sum + Math.abs(value - data[at]!), 0);
      if (change === undefined || change / data.length > 0.5) seen.push(data);
    };
    const ended = new Promise((resolve) => {
      video.onended = resolve;
    });
    // Recorders state no length; the player learns it at the end.
    const frame = (): void => {
      look();
      video.requestVideoFrameCallback(frame);
    };
    video.requestVideoFrameCallback(frame);
    await video.play();
    await ended;
    const head = String.fromCharCode(...bytes.subarray(0, 64));
    return {
      type: head.includes("webm") ? "webm" : "another",
      size: [videoWidth, videoHeight],
      seconds: video.currentTime,
      frames: seen.length,
    };
  }, film);
  await player.close();
  return played;
}

describe("films", () => {
  it.each(["turntable", "light"] as const)(
    "of a %s play, show one turn, and leave the view as it was",
    async (kind) => {
      const [before, film, after, canvas] = await page.evaluate(
        async ([asked, length]) => {
          const element = document.querySelector("lambent-viewer")!;
          const first = element.parameters;
          const blob = await element.film(asked, length);
          const bytes = new Uint8Array(await blob.arrayBuffer());
          let text = "";
          for (let at = 0; at < bytes.length; at += 32768) {
            text += String.fromCharCode(...bytes.subarray(at, at + 32768));
          }
          const { width, height } = element.viewer!.canvas;
          return [first, btoa(text), element.parameters, [width, height]] as const;
        },
        [kind, seconds] as const,
      );
      expect(after).toBe(before);
      const played = await play(film);
      console.log(kind, played);
      expect(played.type).toBe("webm");
      expect(played.size).toEqual(canvas);
      // However slow the machine, time goes on in the film; there may be few pictures of it.
      expect(played.seconds).toBeGreaterThan(0.5 * seconds);
      expect(played.frames).toBeGreaterThanOrEqual(3);
    },
  );
});
