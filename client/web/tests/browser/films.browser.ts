import { ALL_FORMATS, BufferSource, EncodedPacketSink, Input } from "mediabunny";
import type { Page } from "playwright-core";
import { beforeAll, describe, expect, it } from "vitest";
import { type FilmPlan, momentAt, momentOf, planned } from "../../src/film/plan.js";
import { texts } from "../../src/words/words.js";
import { sharedChromium } from "../support/chromium.js";
import { announcements, fixedView, keep, meanDifference, openViewer } from "./support.js";

const browser = await sharedChromium();
let page: Page;

beforeAll(async () => {
  page = await openViewer(browser, { ...fixedView, env: "preset:sky" }, "data/bundle/", {
    width: 800,
    height: 700,
  });
});

/** Make a film on the viewer's page; returns its bytes and the counts that it reported. */
async function filmOf(asked: Partial<FilmPlan>): Promise<{ film: Uint8Array; told: number[]; type: string }> {
  const [text, told, type] = await page.evaluate(async (options) => {
    const element = document.querySelector("lambent-viewer")!;
    const reported: number[] = [];
    const blob = await element.film({ ...options, onFrame: (made, count) => reported.push(made, count) });
    const bytes = new Uint8Array(await blob.arrayBuffer());
    let binary = "";
    for (let at = 0; at < bytes.length; at += 32768) {
      binary += String.fromCharCode(...bytes.subarray(at, at + 32768));
    }
    return [btoa(binary), reported, blob.type] as const;
  }, asked);
  return { film: Uint8Array.from(Buffer.from(text, "base64")), told, type };
}

type Packet = { readonly type: "key" | "delta"; readonly timestamp: number; readonly data: string };

/** Take a film apart, without decoding it. */
async function contentsOf(film: Uint8Array) {
  using input = new Input({ formats: ALL_FORMATS, source: new BufferSource(film) });
  const track = (await input.getPrimaryVideoTrack())!;
  const packets: Packet[] = [];
  for await (const { type, timestamp, data } of new EncodedPacketSink(track).packets()) {
    packets.push({ type, timestamp, data: Buffer.from(data).toString("base64") });
  }
  return {
    format: (await input.getFormat()).name,
    codec: track.codec,
    config: (await track.getDecoderConfig())!,
    size: [track.displayWidth, track.displayHeight],
    seconds: await input.computeDuration(),
    packets,
    times: packets.map(({ timestamp }) => timestamp).sort((one, other) => one - other),
  };
}

/** Return RGBA bytes of frames of a film, as a browser decodes them; the page must be one that may. */
async function framesOf(film: Uint8Array, wanted: readonly number[]): Promise<Uint8Array[]> {
  const { packets, config } = await contentsOf(film);
  const { description, ...others } = config;
  const about = description === undefined ? null : Buffer.from(description as Uint8Array).toString("base64");
  const texts = await page.evaluate(
    async ([chunks, settings, extra, indices]) => {
      const bytesOf = (text: string) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
      const frames: VideoFrame[] = [];
      const failed = new Promise<never>((_, reject) => {
        Object.assign(globalThis, { reject });
      });
      const decoder = new VideoDecoder({
        output: (frame) => frames.push(frame),
        error: (globalThis as unknown as { reject: (error: unknown) => void }).reject,
      });
      decoder.configure({ ...settings, ...(extra === null ? {} : { description: bytesOf(extra) }) });
      for (const { type, timestamp, data } of chunks) {
        const chunk = { type, timestamp: Math.round(1e6 * timestamp), data: bytesOf(data) };
        decoder.decode(new EncodedVideoChunk(chunk));
      }
      await Promise.race([decoder.flush(), failed]);
      frames.sort((one, other) => one.timestamp - other.timestamp);
      const found = indices.map((index) => {
        const frame = frames[index]!;
        const context = new OffscreenCanvas(frame.displayWidth, frame.displayHeight).getContext("2d")!;
        context.drawImage(frame, 0, 0);
        const { data } = context.getImageData(0, 0, frame.displayWidth, frame.displayHeight);
        let binary = "";
        for (let at = 0; at < data.length; at += 32768) {
          binary += String.fromCharCode(...data.subarray(at, at + 32768));
        }
        return btoa(binary);
      });
      for (const frame of frames) frame.close();
      return found;
    },
    [packets, others, about, [...wanted]] as const,
  );
  return texts.map((text) => Uint8Array.from(Buffer.from(text, "base64")));
}

/** Return what the viewer draws at a moment of a film. */
async function drawnAt(plan: FilmPlan, frame: number): Promise<Uint8Array> {
  const state = await page.evaluate(() => document.querySelector("lambent-viewer")!.state);
  const change = momentOf(state, plan.motion, momentAt(plan, frame));
  const text = await page.evaluate(
    async ([next, before, width, height]) => {
      const element = document.querySelector("lambent-viewer")!;
      await element.update(next);
      const { data } = element.picture({ width, height }, 2);
      await element.update({ pose: before.pose, turn: before.turn });
      let binary = "";
      for (let at = 0; at < data.length; at += 32768) {
        binary += String.fromCharCode(...data.subarray(at, at + 32768));
      }
      return btoa(binary);
    },
    [change, state, plan.width, plan.height] as const,
  );
  return Uint8Array.from(Buffer.from(text, "base64"));
}

const small = { width: 320, height: 240, framesPerSecond: 10 };

describe("a film", () => {
  it.each([
    // Four seconds of 1080p take five minutes without a graphics card; the length of a film does not care for its size.
    { width: 192, height: 108, count: 120 },
    { width: 1920, height: 1080, seconds: 0.1, count: 3 },
  ])("of $width x $height has its $count frames, each in its place", async ({ count, ...asked }) => {
    const began = performance.now();
    const { film, told, type } = await filmOf(asked);
    const found = await contentsOf(film);
    console.log(`${found.codec}, ${film.length} bytes, ${Math.round(performance.now() - began)} ms`);
    expect(type).toBe("video/mp4");
    expect(found.format).toBe("MP4");
    // Debian's Chromium encodes H.264; a browser that does not takes the next codec.
    expect(found.codec).toBe("avc");
    expect(found.size).toEqual([asked.width, asked.height]);
    expect(found.times).toHaveLength(count);
    found.times.forEach((time, frame) => {
      expect(time).toBeCloseTo(frame / 30, 3);
    });
    expect(found.seconds).toBeCloseTo(count / 30, 3);
    expect(told.slice(-2)).toEqual([count, count]);
    expect(told).toHaveLength(2 * count);
  });

  it.each([
    ["mp4", "turntable", true],
    ["webm", "light", true],
    ["webm", "both", false],
  ] as const)("as %s of a %s shows what the viewer draws", async (format, motion, loop) => {
    const plan = planned({ ...small, seconds: 0.8, format, motion, loop });
    const before = await page.evaluate(() => document.querySelector("lambent-viewer")!.parameters);
    const { film } = await filmOf(plan);
    const after = await page.evaluate(() => document.querySelector("lambent-viewer")!.parameters);
    expect(after).toBe(before);
    const found = await contentsOf(film);
    expect(found.times).toHaveLength(8);
    const frames = [0, 3, 7];
    const shown = await framesOf(film, frames);
    const drawn: Uint8Array[] = [];
    for (const frame of frames) drawn.push(await drawnAt(plan, frame));
    const apart = shown.map((picture, index) => meanDifference(picture, drawn[index]!));
    const moved = meanDifference(drawn[0]!, drawn[1]!);
    console.log(format, motion, found.codec, apart, `moved ${moved}`);
    shown.forEach((picture, index) => {
      keep(`film_${format}_${motion}_${index}`, picture, plan.width);
    });
    // Lossy, and with the colours of 2 x 2 pixels in one; another frame is further away than that.
    for (const difference of apart) expect(difference).toBeLessThan(Math.min(3, 0.6 * moved));
    const ends = meanDifference(drawn[0]!, drawn[2]!);
    expect(ends < 0.5).toBe(!loop);
  });

  it.each(["mp4", "webm"] as const)(
    "as %s has the background colour where the view has nothing",
    async (format) => {
      const look = (background: "transparent" | "blurred") =>
        page.evaluate(async (behind) => {
          const element = document.querySelector("lambent-viewer")!;
          await element.update({ look: { ...element.state.look, background: behind } });
          return element.state.look.backgroundSrgb;
        }, background);
      const colour = await look("transparent");
      const { film } = await filmOf({ ...small, seconds: 0.1, format });
      await look("blurred");
      const [shown] = await framesOf(film, [0]);
      for (const channel of [0, 1, 2]) {
        expect(Math.abs(shown![channel]! - 255 * colour[channel]!)).toBeLessThan(4);
      }
    },
  );

  it("is refused where it cannot be made, and cancelled", async () => {
    const told = await page.evaluate(async () => {
      const element = document.querySelector("lambent-viewer")!;
      const failure = (work: Promise<unknown>): Promise<{ code?: string; name: string }> =>
        work.then(
          () => ({ name: "none" }),
          (error) => ({ code: error.code, name: error.name }),
        );
      const stop = new AbortController();
      const size = { width: 64, height: 64 };
      let frames = 0;
      return [
        await failure(element.film({ width: 15, height: 64 })),
        await failure(
          element.film({
            ...size,
            signal: stop.signal,
            onFrame: () => {
              if (++frames === 3) stop.abort();
            },
          }),
        ),
        frames,
        await failure(
          element.film({ ...size, onFrame: () => void element.update({ environment: "preset:studio" }) }),
        ),
      ] as const;
    });
    expect(told[0].code).toBe("film.plan");
    expect(told[1].name).toBe("AbortError");
    expect(told[2]).toBe(3);
    expect(told[3].code).toBe("film.interrupted");
  });
});

describe("the dialog of films", () => {
  it("says what it makes, shows it come, and saves it", async () => {
    await page.click("summary:text-is('Save')");
    await page.click("text=Make a film…");
    const dialog = page.getByRole("dialog", { name: "Make a film" });
    await dialog.getByText("120 frames.").waitFor();
    await dialog.getByText("MP4 (H.264)").waitFor({ state: "attached" });
    await dialog.getByLabel("Size").selectOption({ label: "Another size" });
    await dialog.getByLabel("Width").fill("161");
    await dialog.getByLabel("Width").blur();
    await dialog.getByText("even numbers").waitFor();
    expect(await dialog.getByRole("button", { name: "Make the film" }).isDisabled()).toBe(true);
    await dialog.getByLabel("Width").fill("160");
    await dialog.getByLabel("Height").fill("120");
    await dialog.getByLabel("Seconds").fill("0.5");
    await dialog.getByLabel("Frames per second").fill("12");
    await dialog.getByLabel("Format").selectOption("webm");
    const announced = await announcements(page);
    const [download] = await Promise.all([
      page.waitForEvent("download"),
      dialog.getByRole("button", { name: "Make the film" }).click(),
    ]);
    expect(download.suggestedFilename()).toBe("analytic-turntable.webm");
    await dialog.getByText("Saved: 6 frames").waitFor();
    // Not every frame.
    expect((await announced()).map((text) => text.replace(/, .*/, ""))).toEqual([
      texts.film.starting,
      "25 %",
      "50 %",
      "75 %",
      "100 %",
      "Saved: 6 frames",
    ]);
    await dialog.getByLabel("Seconds").fill("60");
    await dialog.getByRole("button", { name: "Make the film" }).click();
    await dialog.getByText(/Frame \d+ of 720/).waitFor();
    await dialog.getByRole("button", { name: "Cancel" }).click();
    await dialog.getByText("nothing was saved").waitFor();
    await dialog.getByRole("button", { name: "Close" }).click();
    await dialog.waitFor({ state: "hidden" });
  });
});
