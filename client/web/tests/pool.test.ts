import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import { mostBytes, RefinePool, workersFor } from "../src/refine/pool.js";
import { refineOptions } from "../src/refine/status.js";

vi.mock("../src/refine/refineWorker.ts?worker&url", () => ({ default: "worker.js" }));

class FakeWorker {
  onmessage: ((event: { data: unknown }) => void) | null = null;
  onerror: unknown = null;
  readonly asked: Record<string, unknown>[] = [];
  ended = false;
  constructor() {
    made.push(this);
  }
  postMessage(question: Record<string, unknown>): void {
    this.asked.push(question);
  }
  terminate(): void {
    this.ended = true;
  }
  say(data: unknown): void {
    this.onmessage?.({ data });
  }
}
const made: FakeWorker[] = [];

beforeEach(() => {
  made.length = 0;
  vi.stubGlobal("Worker", FakeWorker);
  vi.stubGlobal("location", { href: "http://page/", origin: "http://page" });
});
afterEach(() => vi.unstubAllGlobals());

/** A bundle of some bytes of transport. */
const bundleOf = (texelBytes: number, numTexels = 1) =>
  ({
    mesh: { indices: new Uint32Array(3) },
    transport: { numTexels, texelPlane: new Uint8Array(texelBytes) },
  }) as never;
const open = (hear: (answer: unknown) => void) => new RefinePool(bundleOf(8), 3, hear);

describe("the workers of a refinement", () => {
  it("are as many as leave a processor to the page, and one for a fast cache", () => {
    const small = bundleOf(8);
    expect([1, 2, 4, 16].map((count) => workersFor(refineOptions, count, small, false))).toEqual([
      1, 1, 3, 4,
    ]);
    expect(workersFor({ ...refineOptions, backend: "webgpu" }, 16, small, false)).toBe(1);
    expect(workersFor({ ...refineOptions, workers: 2 }, 1, small, false)).toBe(2);
  });

  it("are fewer where each would hold much, more of them where that is shared, and one at least", () => {
    // 256 MiB of tables, and as much as 2^20 texels take besides.
    const large = bundleOf(2 ** 28, 2 ** 20);
    expect(workersFor(refineOptions, 16, large, false)).toBe(2);
    expect(workersFor(refineOptions, 16, large, true)).toBe(4);
    expect(workersFor(refineOptions, 16, bundleOf(2 ** 28, 2 ** 23), false)).toBe(1);
    expect(mostBytes).toBe(2 ** 30);
  });

  it("read the same memory where the page is isolated, and have copies elsewhere", () => {
    const tables = (): Uint8Array[] =>
      made.map(({ asked }) => (asked[0]!.transport as { texelPlane: Uint8Array }).texelPlane);
    vi.stubGlobal("crossOriginIsolated", true);
    open(() => {});
    expect(tables()[0]!.buffer).toBeInstanceOf(SharedArrayBuffer);
    for (const each of tables()) expect(each.buffer).toBe(tables()[0]!.buffer);
    expect([...tables()[0]!]).toEqual(new Array(8).fill(0));
    made.length = 0;
    vi.stubGlobal("crossOriginIsolated", false);
    open(() => {});
    expect(tables()[0]!.buffer).toBeInstanceOf(ArrayBuffer);
  });

  it("share the passes, and are open once all are", () => {
    const heard: unknown[] = [];
    open((answer) => heard.push(answer));
    const shares = made.map(
      ({ asked }) => asked[0]!.share as { index: number; count: number; ports: unknown[] },
    );
    expect(shares.map(({ index, count }) => [index, count])).toEqual([
      [0, 3],
      [1, 3],
      [2, 3],
    ]);
    expect(shares.map(({ ports }) => ports.length)).toEqual([2, 1, 1]);
    made[0]!.say({ kind: "opened" });
    made[2]!.say({ kind: "opened" });
    expect(heard.length).toBe(0);
    made[1]!.say({ kind: "opened" });
    expect(heard.length).toBe(1);
  });

  it("a picture that is done late stops its own passes only", () => {
    const pool = open(() => {});
    pool.ask({ ask: "stop" });
    pool.ask({ ask: "start", id: 2 } as never);
    made[0]!.say({ kind: "picture", id: 1, done: true });
    for (const worker of made) expect(worker.asked.at(-1)).toEqual({ ask: "stop", id: 1 });
  });

  it("end together with the first that fails, and say so once", () => {
    const heard: unknown[] = [];
    open((answer) => heard.push(answer));
    made[1]!.say({ kind: "failed", code: "refine.failed", message: "no" });
    made[2]!.say({ kind: "failed", code: "refine.failed", message: "no" });
    expect(heard.length).toBe(1);
    expect(made.every(({ ended }) => ended)).toBe(true);
  });
});
