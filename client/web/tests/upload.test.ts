import { createHash } from "node:crypto";
import { describe, expect, it } from "vitest";
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

  it("refuses what is no capture, and says what to do", async () => {
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

/** A server that keeps blobs, and fails as it is told. */
class FakeServer {
  blobs = new Set<string>();
  planned: { path: string; sha256: string }[] = [];
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
    this.planned = [...all];
    const missing = [...new Set(all.map((one) => one.sha256))].filter((one) => !this.blobs.has(one));
    return { missing, unsupported: [], uploads: this.direct ? this.#offers(missing.slice(0, 1)) : [] };
  };
  /** Whether files go to a store, which answers with these statuses, or not at all; its parts have 2 bytes. */
  direct = false;
  statuses: (number | null)[] = [];
  stored: string[] = [];
  parts = new Map<string, string>();
  asked: string[] = [];

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
    this.asked.push(...hashes);
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
    const whole = (one: string) =>
      sha((this.parts.get(`${one}/0`) ?? "") + (this.parts.get(`${one}/2`) ?? "")) === one;
    const stored = hashes.filter(whole);
    this.stored.push(...stored);
    const refused = hashes
      .filter((one) => !whole(one))
      .map((sha256) => ({ sha256, code: "upload_missing", detail: "no" }));
    return { stored, refused };
  };
  readonly putFile = async (_: string, sha256: string, body: Blob) => {
    this.#stumble();
    if (sha(await body.text()) !== sha256) throw new Refused(422, "digest_mismatch", "no", false);
    this.blobs.add(sha256);
    this.sent.push(sha256);
    return new Response();
  };
  readonly putArchive = async (id: string) => {
    this.#stumble();
    return this.scene(id);
  };
  readonly commit = async (id: string) => {
    this.committed = id;
    return this.scene(id);
  };
}

describe("upload", () => {
  const capture = { "bowl/1.png": "one", "bowl/2.png": "two", "bowl/3.png": "one", "bowl/run.exe": "x" };

  function tools(api: FakeServer) {
    const steps: UploadStep[] = [];
    const pauses: number[] = [];
    const controller = new AbortController();
    const wait = async (ms: number) => void pauses.push(ms);
    const given = {
      api,
      hash,
      signal: controller.signal,
      wait,
      onStep: (step: UploadStep) => steps.push(step),
    };
    return { given, steps, pauses, controller };
  }

  it("sends each content once and only what the server lacks", async () => {
    const server = new FakeServer();
    server.blobs.add(sha("two"));
    const { given, steps } = tools(server);
    await upload(await collect(files(capture)), given);
    expect(server.sent.sort()).toEqual([sha("one"), sha("x")].sort());
    expect(server.planned.map((one) => one.path)).toEqual(["1.png", "2.png", "3.png", "run.exe"]);
    expect(server.committed).toBe("scene_1");
    expect(steps.at(-1)).toEqual({ what: "commit", doneBytes: 4, totalBytes: 4, numKnown: 1 });
    expect(steps.filter((step) => step.what === "hash").at(-1)).toMatchObject({
      doneBytes: 10,
      totalBytes: 10,
    });
  });

  it("continues a scene whose upload was broken off", async () => {
    const server = new FakeServer();
    server.blobs.add(sha("one"));
    const { given } = tools(server);
    await upload(await collect(files(capture)), given, "scene_old");
    expect(server.numScenes).toBe(0);
    expect(server.committed).toBe("scene_old");
    expect(server.sent).not.toContain(sha("one"));
  });

  it("waits for a server that is away, longer each time", async () => {
    const server = new FakeServer();
    server.faults = [
      new Unreachable("away"),
      new Refused(503, "database_unavailable", "no", true),
      new Unreachable("away"),
    ];
    const { given, pauses } = tools(server);
    await upload(await collect(files({ "a/1.png": "one", "a/2.png": "two" })), given);
    expect(pauses).toEqual([500, 1000, 2000]);
    expect(server.sent).toHaveLength(2);
  });

  it("gives up where the server declines", async () => {
    const server = new FakeServer();
    server.faults = [new Refused(507, "disk_floor", "full", true)];
    await expect(upload(await collect(files(capture)), tools(server).given)).rejects.toThrow("full");
  });

  it("ends when it is stopped, and commits nothing", async () => {
    const server = new FakeServer();
    const { given, controller } = tools(server);
    controller.abort(new Error("stopped"));
    await expect(upload(await collect(files(capture)), given)).rejects.toThrow("stopped");
    expect(server.committed).toBe("");
  });

  const two = { "a/1.png": "one", "a/2.png": "two" };

  it("sends files to the store in parts, and asks for addresses that the plan has not", async () => {
    const server = new FakeServer();
    server.direct = true;
    const { given, steps } = tools(server);
    await upload(await collect(files(two)), given);
    expect(server.stored.sort()).toEqual([sha("one"), sha("two")].sort());
    expect(server.asked).toEqual([sha("two")]);
    expect(server.sent).toEqual([]);
    expect(steps.at(-1)).toMatchObject({ what: "commit", doneBytes: 6 });
  });

  it("lets the server take the files where the store does not let pages send to it", async () => {
    const server = new FakeServer();
    server.direct = true;
    server.statuses = [null, null];
    const { given, pauses } = tools(server);
    await upload(await collect(files(two)), given);
    expect(server.sent.sort()).toEqual([sha("one"), sha("two")].sort());
    expect(server.stored).toEqual([]);
    expect(pauses).toEqual([]);
  });

  it("asks for new addresses where they have expired, and waits for a store that is away", async () => {
    const server = new FakeServer();
    server.direct = true;
    server.statuses = [200, 403, 200, 503, 200, 200];
    const { given, pauses } = tools(server);
    await upload(await collect(files({ "a/1.png": "one" })), given);
    expect(server.stored).toEqual([sha("one")]);
    expect(server.asked).toHaveLength(2);
    expect(pauses).toEqual([500]);
    expect(server.sent).toEqual([]);
  });

  it("goes on with the store when the server is away for a while", async () => {
    const server = new FakeServer();
    server.direct = true;
    const { given, pauses } = tools(server);
    const plan = server.planFiles;
    const api = {
      ...server,
      planFiles: async (...all: Parameters<typeof plan>) => {
        server.faults = [new Unreachable("away")];
        return plan(...all);
      },
    };
    await upload(await collect(files({ "a/1.png": "one" })), {
      ...given,
      api: api as unknown as FakeServer,
    });
    expect(pauses).toEqual([500]);
    expect(server.stored).toEqual([sha("one")]);
  });

  it("gives up files that the store has never got as they are", async () => {
    const server = new FakeServer();
    server.direct = true;
    server.putToStore = async () => 200;
    await expect(upload(await collect(files(two)), tools(server).given)).rejects.toThrow("no");
    expect(server.committed).toBe("");
  });

  it("takes an archive as sent where only the answer was lost", async () => {
    const server = new FakeServer();
    const candidate = await collect(new Map([["a.tar", new File(["x"], "a.tar")]]));
    const { given } = tools(server);
    server.faults = [];
    const api = {
      ...server,
      putArchive: async () => Promise.reject(new Refused(409, "scene_committed", "no", false)),
    };
    const scene = await upload(candidate, { ...given, api: api as unknown as FakeServer });
    expect(scene.id).toBe("scene_1");
  });
});
