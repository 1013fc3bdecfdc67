import { createHash } from "node:crypto";
import { beforeEach, describe, expect, it } from "vitest";
import { sha256Hex } from "../src/page/buffers.js";
import { droppedEntries, filesIn } from "../src/page/files.js";
import { type FileUpload, Refused, type Scene, Unreachable } from "../src/page/rest.js";
import { type Candidate, collect, NotAScene } from "../src/upload/collect.js";
import { type UploadStep, upload } from "../src/upload/upload.js";
import { zipOf } from "./support/bundle.js";

const files = (contents: Record<string, string>) =>
  new Map(Object.entries(contents).map(([path, text]) => [path, new File([text], path.split("/").at(-1)!)]));

const hash = async (blob: Blob) => sha256Hex(new Uint8Array(await blob.arrayBuffer()));
const sha = (text: string) => createHash("sha256").update(text).digest("hex");

const bytes = (contents: Record<string, string>) =>
  new Map(Object.entries(contents).map(([path, text]) => [path, new TextEncoder().encode(text)]));

async function contentsOf(candidate: Candidate): Promise<Record<string, string>> {
  if (candidate.kind !== "files") throw new Error(candidate.kind);
  const pairs = candidate.files.map(async (file) => [file.path, await (await file.read()).text()] as const);
  return Object.fromEntries(await Promise.all(pairs));
}

describe("collect", () => {
  it("takes the folder's name as the scene's, and leaves dot files out", async () => {
    const chosen = files({
      "bowl/transforms.json": "{}",
      "bowl/images/1.png": "one",
      "bowl/.DS_Store": "x",
      "bowl/.git/config": "x",
    });
    const candidate = await collect(chosen);
    expect(candidate.name).toBe("bowl");
    expect(await contentsOf(candidate)).toEqual({ "images/1.png": "one", "transforms.json": "{}" });
  });

  it("opens a zip, with or without a folder around everything", async () => {
    for (const prefix of ["", "shoes/"]) {
      const contents = {
        [`${prefix}transforms.json`]: "{}",
        [`${prefix}images/1.png`]: "one".repeat(1000),
        [`__MACOSX/${prefix}x`]: "x",
      };
      const packed = zipOf(bytes(contents), { packed: prefix !== "" });
      const candidate = await collect(new Map([["shoes.zip", new File([packed], "Shoes.zip")]]));
      expect(candidate.name).toBe("Shoes");
      expect(await contentsOf(candidate)).toEqual({
        "images/1.png": "one".repeat(1000),
        "transforms.json": "{}",
      });
    }
  });

  it("leaves archives that it cannot open to the server", async () => {
    const tar = await collect(new Map([["a.tar.gz", new File(["x"], "a.tar.gz")]]));
    expect(tar).toMatchObject({ kind: "archive", name: "a", mediaType: "application/gzip" });
    const odd = await collect(new Map([["b.zip", new File(["PK no directory"], "b.zip")]]));
    expect(odd).toMatchObject({ kind: "archive", mediaType: "application/zip" });
  });

  it("refuses what is not a capture, and says what to do", async () => {
    const encrypted = new File([zipOf(bytes({ "a.png": "x" }), { flags: 1 })], "c.zip");
    for (const chosen of [files({}), files({ "photo.jpg": "x" }), new Map([["c.zip", encrypted]])]) {
      await expect(collect(chosen)).rejects.toThrow(NotAScene);
    }
  });
});

/** Return what a browser gives for a folder that is dropped; its files come in portions. */
function entryOf(
  name: string,
  inside: Readonly<Record<string, string>> | string,
  path = `/${name}`,
): FileSystemEntry {
  if (typeof inside === "string") {
    const file = (resolve: (file: File) => void) => resolve(new File([inside], name));
    return { isFile: true, fullPath: path, file } as unknown as FileSystemEntry;
  }
  const all = Object.entries(inside).map(([each, text]) => entryOf(each, text, `${path}/${each}`));
  const createReader = () => {
    const left = [...all];
    return { readEntries: (resolve: (some: FileSystemEntry[]) => void) => resolve(left.splice(0, 2)) };
  };
  return { isFile: false, fullPath: path, createReader } as unknown as FileSystemEntry;
}

describe("filesIn", () => {
  it("opens folders to the end, and takes single files", async () => {
    const many = Object.fromEntries(Array.from({ length: 5 }, (_, place) => [`${place}.png`, `${place}`]));
    const entries = [entryOf("bowl", many), entryOf("sky.exr", "x"), null];
    const items = entries.map((entry) => ({ webkitGetAsEntry: () => entry }) as DataTransferItem);
    const found = await filesIn(droppedEntries(items));
    expect([...found.keys()]).toEqual([...Object.keys(many).map((name) => `bowl/${name}`), "sky.exr"]);
    expect(await found.get("bowl/4.png")!.text()).toBe("4");
  });
});

/** A server that keeps blobs, and throws `faults` one after the other. */
class FakeServer {
  blobs = new Set<string>();
  planned: string[] = [];
  /** Contents of files that the server has taken itself. */
  sent: string[] = [];
  faults: Error[] = [];
  numScenes = 0;
  committed = "";

  #stumble(): void {
    const fault = this.faults.shift();
    if (fault !== undefined) throw fault;
  }
  readonly createScene = async (name: string) => {
    this.#stumble();
    this.numScenes += 1;
    return this.scene(`scene_${this.numScenes}`, name);
  };
  readonly scene = async (id: string, name = "x") => ({ id, name }) as Scene;
  readonly planFiles = async (_: string, all: readonly { path: string; sha256: string }[]) => {
    this.planned = all.map((one) => one.path);
    const missing = [...new Set(all.map((one) => one.sha256))].filter((one) => !this.blobs.has(one));
    this.faults.push(...this.faultsAfterPlan);
    return { missing, unsupported: [], uploads: this.direct ? this.#offers(missing.slice(0, 1)) : [] };
  };
  faultsAfterPlan: Error[] = [];
  /** Whether files go to a store, which answers with these statuses, or not at all; its parts have 2 bytes. */
  direct = false;
  statuses: (number | null)[] = [];
  stored: string[] = [];
  parts = new Map<string, string>();
  /** Number of requests for addresses of the store. */
  asked = 0;

  #offers(hashes: readonly string[]): FileUpload[] {
    return hashes.map((sha256) => ({
      sha256,
      size_bytes: 3,
      expires_at: "",
      parts: [0, 2].map((offset, place) => ({
        number: place + 1,
        offset,
        size_bytes: 2,
        url: `https://store/${sha256}/${offset}`,
        headers: { "x-check": sha256 },
      })),
    }));
  }
  readonly offerUploads = async (_: string, hashes: readonly string[]) => {
    this.asked += 1;
    return { items: this.#offers(hashes) };
  };
  putToStore = async (url: string, headers: Readonly<Record<string, string>>, body: Blob) => {
    const status = this.statuses.length > 0 ? this.statuses.shift()! : 200;
    if (status === null) throw new Unreachable("not allowed");
    const [sha256, offset] = url.split("/").slice(-2) as [string, string];
    expect(headers).toEqual({ "x-check": sha256 });
    if (status === 200) this.parts.set(`${sha256}/${offset}`, await body.text());
    return status;
  };
  readonly completeUploads = async (_: string, hashes: readonly string[]) => {
    this.#stumble();
    const text = (one: string) => `${this.parts.get(`${one}/0`)}${this.parts.get(`${one}/2`)}`;
    const [stored, lacking] = [true, false].map((is) =>
      hashes.filter((one) => (sha(text(one)) === one) === is),
    );
    this.stored.push(...stored!.map(text));
    return {
      stored: stored!,
      refused: lacking!.map((sha256) => ({ sha256, code: "upload_missing", detail: "no" })),
    };
  };
  readonly putFile = async (_: string, sha256: string, body: Blob) => {
    this.#stumble();
    const text = await body.text();
    expect(sha(text)).toBe(sha256);
    this.blobs.add(sha256);
    this.sent.push(text);
    return new Response();
  };
  putArchive = async (id: string) => this.scene(id);
  readonly commit = async (id: string) => {
    this.committed = id;
    return this.scene(id);
  };
}

describe("upload", () => {
  const capture = { "bowl/1.png": "one", "bowl/2.png": "two", "bowl/3.png": "one", "bowl/run.exe": "x" };
  const two = { "a/1.png": "one", "a/2.png": "two" };
  const away = new Unreachable("away");
  let server: FakeServer;
  beforeEach(() => {
    server = new FakeServer();
  });

  /** Upload a capture, and return its steps and pauses. */
  async function uploaded(
    contents: Record<string, string> = capture,
    sceneId: string | null = null,
    signal = new AbortController().signal,
  ) {
    const [steps, pauses]: [UploadStep[], number[]] = [[], []];
    const wait = async (ms: number) => void pauses.push(ms);
    const onStep = (step: UploadStep) => void steps.push(step);
    await upload(await collect(files(contents)), { api: server, hash, signal, wait, onStep }, sceneId);
    return { steps, pauses };
  }

  it("sends each content once and only what the server lacks", async () => {
    server.blobs.add(sha("two"));
    const { steps } = await uploaded();
    expect(server.sent.sort()).toEqual(["one", "x"]);
    expect(server.planned).toEqual(["1.png", "2.png", "3.png", "run.exe"]);
    expect(server.committed).toBe("scene_1");
    expect(steps.at(-1)).toEqual({ what: "commit", doneBytes: 4, totalBytes: 4, numKnown: 1 });
    const hashed = steps.filter((step) => step.what === "hash").at(-1);
    expect(hashed).toMatchObject({ doneBytes: 10, totalBytes: 10 });
  });

  it("continues a scene whose upload was broken off", async () => {
    await uploaded(two, "scene_old");
    expect([server.numScenes, server.committed]).toEqual([0, "scene_old"]);
  });

  it("waits for a server that does not answer, longer each time", async () => {
    server.faults = [away, new Refused(503, "database_unavailable", "no", true), away];
    expect((await uploaded(two)).pauses).toEqual([500, 1000, 2000]);
    expect(server.sent).toHaveLength(2);
  });

  it("gives up where the server declines", async () => {
    server.faults = [new Refused(507, "disk_floor", "full", true)];
    await expect(uploaded()).rejects.toThrow("full");
  });

  it("ends when it is stopped, and commits nothing", async () => {
    await expect(uploaded(two, null, AbortSignal.abort(new Error("stopped")))).rejects.toThrow("stopped");
    expect(server.committed).toBe("");
  });

  const no: string[] = [];
  it.each([
    ["in parts, to addresses that are asked for", two, [], [["one", "two"], no, 1, []]],
    ["by the server itself where the store refuses pages", two, [null, null], [no, ["one", "two"], 1, []]],
    [
      "to new addresses where some have expired, and after a wait where it does not answer",
      { "a/1.png": "one" },
      [200, 403, 200, 503, 200, 200],
      [["one"], no, 2, [500]],
    ],
  ])("sends files to the store %s", async (_, contents, statuses, expected) => {
    server.direct = true;
    server.statuses = statuses;
    const { pauses } = await uploaded(contents);
    expect([server.stored.sort(), server.sent.sort(), server.asked, pauses]).toEqual(expected);
  });

  it("continues with the store when the server does not answer for a while", async () => {
    server.direct = true;
    server.faultsAfterPlan = [away];
    expect((await uploaded({ "a/1.png": "one" })).pauses).toEqual([500]);
    expect(server.stored).toEqual(["one"]);
  });

  it("gives up files that the store never gets as they are", async () => {
    server.direct = true;
    server.putToStore = async () => 200;
    await expect(uploaded(two)).rejects.toThrow("no");
    expect(server.committed).toBe("");
  });

  it("takes an archive as sent where only the answer was lost", async () => {
    server.putArchive = () => Promise.reject(new Refused(409, "scene_committed", "no", false));
    const candidate = await collect(new Map([["a.tar", new File(["x"], "a.tar")]]));
    const { signal } = new AbortController();
    const scene = await upload(candidate, { api: server, hash, signal, onStep: () => {} });
    expect(scene.id).toBe("scene_1");
  });
});
