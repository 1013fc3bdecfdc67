import { readFileSync } from "node:fs";
import { afterEach, describe, expect, it, vi } from "vitest";
import { loadBundle } from "../src/bundle/load.js";
import type { FinerTables } from "../src/bundle/transport.js";
import { ZipArchive } from "../src/bundle/zip.js";

const golden = new URL("../../../tests/golden/bundles/ball_1.2.relight.zip", import.meta.url);
const archive = new Blob([readFileSync(golden)]);
const noPicture = () => Promise.reject(new Error("a picture was decoded"));
const whole = loadBundle({ kind: "archive", file: archive }, () => {}, noPicture);

afterEach(() => vi.unstubAllGlobals());

/** Return the bundle from a web folder, what reads the rest of it, and the bytes that were sent of each file. */
async function fromFolder(parts: boolean, damage = "") {
  const files = await ZipArchive.ofFile(archive);
  const sent = new Map<string, number[]>();
  vi.stubGlobal("fetch", async (url: URL, init?: { headers?: Record<string, string> }) => {
    const path = url.pathname.slice("/ball/".length);
    const data = await files.file(path);
    const range = parts ? /^bytes=(\d+)-(\d+)$/.exec(init?.headers?.range ?? "") : null;
    const body = range === null ? data : data.slice(Number(range[1]), Number(range[2]) + 1);
    sent.set(path, [...(sent.get(path) ?? []), body.length]);
    if (path === damage && Number(range?.[1] ?? 0) > 0) body[0]! ^= 1;
    return new Response(body, { status: range === null ? 200 : 206 });
  });
  const later: (() => Promise<FinerTables>)[] = [];
  const news: number[] = [];
  const bundle = await loadBundle(
    { kind: "url", url: "https://x.example/ball" },
    (each) => {
      if (each.kind === "progress") news.push(each.readBytes / each.totalBytes);
    },
    noPicture,
    (finer) => later.push(finer),
  );
  return { bundle, later, sent, news };
}

/** Return plane `index` of a table as values. */
function plane(
  table: { steps: Int8Array; rows: number; scales: Float32Array; offsets: Float32Array },
  index: number,
  count: number,
) {
  const start = 4 * (index >> 2) * table.rows * 1024 + (index & 3);
  return Array.from(
    { length: count },
    (_, texel) => table.offsets[index]! + table.scales[index]! * table.steps[start + 4 * texel]!,
  );
}

describe("a first picture", () => {
  it("has the planes of a lite bundle, and the others come behind it", async () => {
    const { bundle, later, sent, news } = await fromFolder(true);
    const { transport } = await whole;
    const { numTexels } = transport;
    expect(sent.get("transport/direct_sh7.bin")).toEqual([25 * numTexels]);
    expect(sent.get("transport/visibility_sh4.bin")).toEqual([9 * numTexels]);
    expect(news.at(-1)).toBe(1);
    for (const [name, first, all] of [
      ["direct", 25, 49],
      ["visibility", 9, 16],
    ] as const) {
      const table = bundle.transport[name];
      for (const index of [0, first - 1]) {
        expect(plane(table, index, numTexels)).toEqual(plane(transport[name], index, numTexels));
      }
      for (const index of [first, all - 1]) {
        const most = Math.max(...plane(table, index, numTexels).map(Math.abs));
        expect(most).toBeLessThanOrEqual(table.scales[index]!);
      }
    }
    expect(later).toHaveLength(1);
    const { direct, visibility } = await later[0]!();
    expect(direct).toEqual(transport.direct.steps);
    expect(visibility).toEqual(transport.visibility.steps);
    expect(sent.get("transport/direct_sh7.bin")).toEqual([25 * numTexels, 24 * numTexels]);
    // All else was read once.
    expect(
      [...sent]
        .filter(([, times]) => times.length > 1)
        .map(([path]) => path)
        .sort(),
    ).toEqual(["transport/direct_sh7.bin", "transport/visibility_sh4.bin"]);
  });

  it("has all planes where the host sends no parts, and where files are read from the disk", async () => {
    const { bundle, later } = await fromFolder(false);
    expect(later).toEqual([]);
    expect(bundle.transport.direct.steps).toEqual((await whole).transport.direct.steps);
    const asked = vi.fn();
    const dropped = await loadBundle({ kind: "archive", file: archive }, () => {}, noPicture, asked);
    expect(asked).not.toHaveBeenCalled();
    expect(dropped.transport.visibility.steps).toEqual((await whole).transport.visibility.steps);
  });

  it("is followed by a fault where the rest is of another file", async () => {
    const { later } = await fromFolder(true, "transport/direct_sh7.bin");
    await expect(later[0]!()).rejects.toMatchObject({ code: "bundle.digest_mismatch" });
  });
});
