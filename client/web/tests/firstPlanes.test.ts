import { readFileSync } from "node:fs";
import { afterEach, describe, expect, it, vi } from "vitest";
import { type Decode, loadBundle } from "../src/bundle/load.js";
import { openBundle } from "../src/bundle/manifest.js";
import { openSource } from "../src/bundle/source.js";
import { type FinerTables, forHits } from "../src/bundle/transport.js";
import { ZipArchive } from "../src/bundle/zip.js";
import { texelMaterials } from "../src/refine/surfacePoints.js";

const archiveOf = (name: string) =>
  new Blob([readFileSync(new URL(`../../../tests/golden/bundles/${name}.relight.zip`, import.meta.url))]);
const archive = archiveOf("ball");
const decode: Decode = async () => ({ width: 1, close: () => {} }) as ImageBitmap;
const whole = loadBundle({ kind: "archive", file: archive }, () => {}, decode);
const [directPath, visibilityPath] = ["transport/direct_sh7.bin", "transport/visibility_sh4.bin"];
const pieceBytes = 1000;

afterEach(() => vi.unstubAllGlobals());

/** A host of a bundle's files: what it was asked for, and what it does with an answer that has all of a file. */
type Host = {
  readonly parts?: boolean;
  /** A file with a wrong byte at its end. */
  readonly damaged?: string;
  /** Called before each piece of a whole file; may wait, or throw where the connection breaks. */
  readonly piece?: (path: string, from: number) => Promise<void>;
};

/** Return the bundle from a web folder, what reads the rest of it, and the requests: ranges, or "". */
async function fromFolder({ parts = true, damaged = "", piece = async () => {} }: Host) {
  const files = await ZipArchive.ofFile(archive);
  const asked = new Map<string, string[]>();
  vi.stubGlobal("fetch", async (url: URL, init?: { headers?: Record<string, string> }) => {
    const path = url.pathname.slice("/ball/".length);
    const data = await files.file(path);
    if (path === damaged) data[data.length - 1]! ^= 1;
    const range = init?.headers?.range ?? "";
    asked.set(path, [...(asked.get(path) ?? []), range]);
    const ends = parts ? /^bytes=(\d+)-(\d+)$/.exec(range) : null;
    if (ends !== null) {
      return new Response(data.slice(Number(ends[1]), Number(ends[2]) + 1), { status: 206 });
    }
    let from = 0;
    const body = new ReadableStream<Uint8Array>({
      async pull(controller) {
        await piece(path, from);
        if (from < data.length) controller.enqueue(data.slice(from, from + pieceBytes));
        else controller.close();
        from += pieceBytes;
      },
    });
    return new Response(body, { headers: { "content-length": String(data.length) } });
  });
  const later: (() => Promise<FinerTables>)[] = [];
  const news: number[] = [];
  const bundle = await loadBundle(
    { kind: "url", url: "https://x.example/ball" },
    (each) => {
      if (each.kind === "progress") news.push(each.readBytes / each.totalBytes);
    },
    decode,
    (finer) => later.push(finer),
  );
  return { bundle, later, asked, news };
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
  it("has the planes of a lite bundle before the rest of the files has come", async () => {
    const { transport } = await whole;
    const { numTexels } = transport;
    let release = (): void => {};
    const held = new Promise<void>((resolve) => {
      release = resolve;
    });
    const piece = async (path: string, from: number) => {
      if (path === directPath && from > 25 * numTexels) await held;
    };
    const { bundle, later, asked, news } = await fromFolder({ piece });
    // A third of the one is needed, and little more than a half of the other.
    expect([asked.get(directPath), asked.get(visibilityPath)]).toEqual([[""], [""]]);
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
    release();
    const { direct, visibility } = await later[0]!();
    expect(direct).toEqual(transport.direct.steps);
    expect(visibility).toEqual(transport.visibility.steps);
    // Every file was read once.
    expect([...asked.values()].every((requests) => requests.length === 1)).toBe(true);
  });

  it("has its largest tables after everything else, so that the rest of them delays nothing", async () => {
    let release = (): void => {};
    const held = new Promise<void>((resolve) => {
      release = resolve;
    });
    const order: string[] = [];
    const piece = async (path: string, from: number) => {
      if (from === 0) order.push(path);
      if (path === "mesh/asset.glb") await held;
    };
    const loading = fromFolder({ piece });
    await vi.waitUntil(() => order.includes("transport/indirect_sh3.bin"), { timeout: 5000 });
    await new Promise((resolve) => setTimeout(resolve, 50));
    expect(order).not.toContain(directPath);
    release();
    await loading;
    const last = [directPath, visibilityPath];
    expect(order.slice(-2).sort()).toEqual(last);
    expect(order.slice(0, -2).filter((path) => last.includes(path))).toEqual([]);
  });

  it("has all planes where files are read from the disk", async () => {
    const asked = vi.fn();
    const dropped = await loadBundle({ kind: "archive", file: archive }, () => {}, decode, asked);
    expect(asked).not.toHaveBeenCalled();
    expect(dropped.transport.visibility.steps).toEqual((await whole).transport.visibility.steps);
  });

  it("is followed by a fault where the rest is of another file", async () => {
    const { later } = await fromFolder({ damaged: directPath });
    await expect(later[0]!()).rejects.toMatchObject({ code: "bundle.digest_mismatch" });
  });

  it("is followed by the whole file again where the connection breaks behind the beginning", async () => {
    let times = 0;
    const { numTexels, direct } = (await whole).transport;
    const piece = async (path: string, from: number) => {
      if (path === directPath && from > 25 * numTexels && times++ === 0) throw new Error("connection lost");
    };
    const { later, asked } = await fromFolder({ piece });
    expect((await later[0]!()).direct).toEqual(direct.steps);
    expect(asked.get(directPath)).toEqual(["", ""]);
  });
});

describe("the beginning of a file", () => {
  const path = "transport/indirect_sh3.bin";
  const beginning = async (host: Host, bytes: number) => {
    const { asked } = await fromFolder(host);
    const { begin } = await openBundle(await openSource({ kind: "url", url: "https://x.example/ball" }));
    asked.clear();
    return { asked, ...(await begin(path, bytes, async () => {})) };
  };

  it("is asked for alone where it is less than a quarter of it, and read out of all of it otherwise", async () => {
    const { asked, data, whole: rest } = await beginning({}, 100);
    expect(asked.get(path)).toEqual(["bytes=0-99"]);
    const all = await rest!();
    expect(asked.get(path)).toEqual(["bytes=0-99", ""]);
    expect(data).toEqual(all.subarray(0, 100));
    const large = await beginning({}, Math.ceil(all.length / 4));
    expect(large.data).toEqual(all.subarray(0, Math.ceil(all.length / 4)));
    expect(await large.whole!()).toEqual(all);
    expect(large.asked.get(path)).toEqual([""]);
  });

  it("comes with all of it from a host that sends no parts", async () => {
    const { asked, data, whole: rest } = await beginning({ parts: false }, 100);
    expect(rest).toBe(null);
    expect(asked.get(path)).toEqual(["bytes=0-99"]);
    expect(data.length).toBeGreaterThan(100);
  });
});

describe("materials of texels", () => {
  const path = "transport/material.bin";

  it("are not read for the first picture, which has the mesh's textures", async () => {
    const { asked, news } = await fromFolder({});
    expect(asked.has(path)).toBe(false);
    expect(news.at(-1)).toBe(1);
  });

  it("are read for light from the surface itself, once", async () => {
    const origin = { kind: "archive", file: archive } as const;
    const { transport } = await whole;
    const { manifest, read } = await openBundle(await openSource(origin));
    const paths: string[] = [];
    const counted = (asked: string) => {
      paths.push(asked);
      return read(asked);
    };
    const first = await forHits(transport, manifest.transport!, counted);
    const { normal, metalness } = texelMaterials(first);
    expect(Math.hypot(...normal.subarray(0, 3))).toBeCloseTo(1, 5);
    expect(metalness).toHaveLength(transport.numTexels);
    expect(paths.filter((each) => each === path)).toHaveLength(1);
  });
});
