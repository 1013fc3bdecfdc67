import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import { Applier, type ApplyState } from "../src/masks/applier.js";
import type { Applied } from "../src/masks/backend.js";
import {
  boxOf,
  type Correction,
  documentOf,
  History,
  simplified,
  strokeOf,
} from "../src/masks/corrections.js";
import { agreementText, appliedText } from "../src/masks/editor.js";
import { badge, doubtfulFirst } from "../src/masks/grid.js";
import { inLines } from "../src/page/rest.js";
import { keyOf, localBackend } from "../src/masks/localBackend.js";
import { overlay } from "../src/masks/paint.js";
import { afterKey, brushShare, type Tools } from "../src/masks/tools.js";
import { fitted, moved, showing, toPhoto, toScreen, zoomed } from "../src/masks/viewport.js";

const photo = { width: 4000, height: 3000 };
const screen = { width: 800, height: 800 };
const mark = (frame: string, x = 1): Correction => strokeOf(frame, "background", [[x, 2]], 3);

describe("corrections", () => {
  it("keep the course of a stroke within a fraction of its radius, with few points", () => {
    const circle = Array.from({ length: 500 }, (_, step) => {
      const angle = (2 * Math.PI * step) / 499;
      return [1000 + 300 * Math.cos(angle), 1000 + 300 * Math.sin(angle)] as const;
    });
    const { stroke, radius } = strokeOf("a", "object", circle, 20.04);
    expect(radius).toBe(20);
    expect(stroke.length).toBeLessThan(60);
    expect(stroke[0]).toEqual([1300, 1000]);
    for (const [x, y] of stroke) expect(Math.hypot(x - 1000, y - 1000)).toBeCloseTo(300, 0);
    // No point is left out that is further from the line than the tolerance.
    for (const [x, y] of circle) {
      const nearest = Math.min(...stroke.map(([px, py]) => Math.hypot(px - x, py - y)));
      expect(nearest).toBeLessThan(90);
    }
  });

  it("of one click are one point, and a straight line is its ends", () => {
    const click = { frame: "a", label: "object", stroke: [[1.3, 2]], radius: 3 };
    expect(strokeOf("a", "object", [[1.26, 2]], 3)).toEqual(click);
    const line = [0, 1, 2, 3, 4].map((x) => [x, x] as const);
    expect(simplified(line, 0.1)).toEqual([line[0], line[4]]);
    expect(simplified([line[0]!, [2, 5], line[4]!], 0.1)).toHaveLength(3);
  });

  it("are boxes within the photograph whichever corner came first, and no box where nearly nothing is", () => {
    const box = { frame: "a", label: "object", box: [0, 40, 300, 3000] };
    expect(boxOf("a", "object", [300, 40], [-20, 5000], photo)).toEqual(box);
    expect(boxOf("a", "object", [10, 10], [12, 400], photo)).toBeNull();
  });

  it("are undone one by one, those of an earlier sitting too, and clearing is undone at once", () => {
    const history = new History([mark("a"), mark("b")]);
    history.add(mark("a", 5));
    const corrections = [mark("a"), mark("b"), mark("a", 5)];
    expect(documentOf(history.now)).toEqual({ version: 1, corrections });
    expect(history.of("a")).toHaveLength(2);
    history.clear("a");
    history.clear("nowhere");
    expect(history.now).toEqual([mark("b")]);
    expect([...history.undo()]).toEqual(["a"]);
    expect(history.now).toHaveLength(3);
    expect([...history.undo()]).toEqual(["a"]);
    expect([...history.undo()]).toEqual(["b"]);
    expect([...history.undo()]).toEqual(["a"]);
    expect([history.now, history.canUndo, [...history.undo()]]).toEqual([[], false, []]);
  });
});

describe("the viewport", () => {
  it("shows the whole photograph in the middle, and leads there and back", () => {
    const view = fitted(photo, screen);
    expect(view).toEqual({ scale: 0.2, x: 0, y: 100 });
    const [x, y] = toPhoto(view, ...toScreen(view, [123, 456]));
    expect(x).toBeCloseTo(123);
    expect(y).toBeCloseTo(456);
  });

  it("zooms around the pointer, no further out than the whole", () => {
    const near = zoomed(fitted(photo, screen), 4, 200, 300, photo, screen);
    expect(near.scale).toBeCloseTo(0.8);
    expect(toPhoto(near, 200, 300)).toEqual(toPhoto(fitted(photo, screen), 200, 300));
    expect(zoomed(near, 0.001, 0, 0, photo, screen)).toEqual(fitted(photo, screen));
  });

  it("leaves no empty screen where the photograph could fill it", () => {
    const near = zoomed(fitted(photo, screen), 4, 400, 400, photo, screen);
    expect(toPhoto(moved(near, 9999, 9999, photo, screen), 0, 0)).toEqual([0, 0]);
    const last = moved(near, -9999, -9999, photo, screen);
    expect(toPhoto(last, 800, 800)).toEqual([4000, 3000]);
    const [x, y] = toScreen(showing(last, [10, 10], photo, screen), [10, 10]);
    expect(Math.min(x, y)).toBeGreaterThanOrEqual(0);
    expect(Math.max(x, y)).toBeLessThan(800);
  });
});

describe("the applier", () => {
  const applied: Applied = { agreement: 0.9, doubtful: [], changed: ["a"] };
  beforeEach(() => void vi.useFakeTimers());
  afterEach(() => void vi.useRealTimers());

  function applier() {
    const asked: { count: number; signal: AbortSignal; answer: (error?: Error) => void }[] = [];
    const states: ApplyState[] = [];
    const one = new Applier(
      (corrections, signal) =>
        new Promise((resolve, reject) => {
          const answer = (error?: Error) => (error ? reject(error) : resolve(applied));
          asked.push({ count: corrections.length, signal, answer });
        }),
      (state) => states.push(state),
    );
    return { one, asked, states };
  }

  it("waits for the last of several changes", async () => {
    const { one, asked, states } = applier();
    one.change([mark("a")]);
    await vi.advanceTimersByTimeAsync(340);
    one.change([mark("a"), mark("b")]);
    await vi.advanceTimersByTimeAsync(350);
    expect(asked.map((each) => each.count)).toEqual([2]);
    await vi.advanceTimersByTimeAsync(2000);
    asked[0]!.answer();
    await vi.advanceTimersByTimeAsync(0);
    expect(states).toEqual([{ kind: "applying" }, { kind: "applied", applied, seconds: 2 }]);
  });

  it("ends what a later change overtakes, and says nothing of it", async () => {
    const { one, asked, states } = applier();
    one.change([mark("a")]);
    await vi.advanceTimersByTimeAsync(350);
    one.change([]);
    expect(asked[0]!.signal.aborted).toBe(true);
    asked[0]!.answer(new Error("aborted"));
    await vi.advanceTimersByTimeAsync(350);
    asked[1]!.answer();
    await vi.advanceTimersByTimeAsync(0);
    expect(states.map((each) => each.kind)).toEqual(["applying", "applying", "applied"]);
  });

  it("tells of a failure", async () => {
    const { one, asked, states } = applier();
    one.change([]);
    await vi.advanceTimersByTimeAsync(350);
    asked[0]!.answer(new Error("gone"));
    await vi.advanceTimersByTimeAsync(0);
    expect(states.at(-1)).toEqual({ kind: "failed", error: new Error("gone") });
  });
});

describe("the drawing", () => {
  it("dims the background and outlines the object", () => {
    const inside = [0, 0, 0, 0, 0, 0, 255, 255, 255, 0, 0, 255, 255, 255, 0, 0, 255, 255, 255, 0];
    const rgba = new Uint8ClampedArray(inside.flatMap((value) => [value, value, value, 255]));
    overlay(rgba, 5, 4);
    const alpha = inside.map((_, index) => rgba[4 * index + 3]);
    expect(alpha.slice(0, 6).every((value) => value === 165)).toBe(true);
    // The middle is clear; the edge is opaque, but not along the picture's border.
    expect([alpha[11], alpha[12], alpha[13], alpha[17]]).toEqual([255, 0, 255, 0]);
    expect([...rgba.slice(4 * 11, 4 * 11 + 3)]).toEqual([230, 0, 160]);
  });
});

describe("the grid", () => {
  it("begins with the doubtful ones and names their state", () => {
    const frame = (name: string, doubtful: boolean) => ({ ...photo, name, doubtful });
    const sorted = doubtfulFirst([frame("a", false), frame("b", true), frame("c", false), frame("d", true)]);
    expect(sorted.map((each) => each.name)).toEqual(["b", "d", "a", "c"]);
    expect([badge(false, 0), badge(true, 1), badge(false, 2)]).toEqual(["", "doubtful, 1 mark", "2 marks"]);
  });

  it("asks for a few at a time", async () => {
    let [now, most, all] = [0, 0, 0];
    await inLines(6, [...new Array(40).keys()], async () => {
      now += 1;
      most = Math.max(most, now);
      await new Promise((done) => setTimeout(done, 1));
      now -= 1;
      all += 1;
    });
    expect([most, all]).toEqual([6, 40]);
  });
});

describe("the tools", () => {
  const tools: Tools = { label: "background", shape: "brush", brush: 98 };
  it("are chosen by keys", () => {
    expect(afterKey(tools, "o")).toEqual({ ...tools, label: "object" });
    expect(afterKey(tools, "x")).toEqual({ ...tools, shape: "box" });
    expect(afterKey(tools, "]")?.brush).toBe(100);
    expect(afterKey(tools, "q")).toBeNull();
  });
  it("brush from a thousandth to a tenth of the photograph", () => {
    expect([1, 100].map(brushShare)).toEqual([0.001, expect.closeTo(0.1)]);
  });
});

describe("the words", () => {
  it("say how well the views agree, and what to do where nothing was found", () => {
    expect(agreementText(0.876, "", false)).toBe("Agreement between the views: 88%.");
    expect(agreementText(0, "the views differ", false)).toMatch(
      /No object was found: the views differ\. Mark/,
    );
    expect(agreementText(0.9, "the views differ", true)).toBe("Agreement between the views: 90%.");
    const applied = { agreement: 0.9, doubtful: [], changed: ["a"] };
    expect(appliedText(applied, 40, 3.21)).toBe(
      "All 40 photographs compared in 3.2 s: 1 mask changed. Agreement between the views: 90%.",
    );
    expect(appliedText({ ...applied, changed: [] }, 40, 1)).toMatch(/no mask changed/);
  });
});

describe("the local backend", () => {
  it("asks below its key, with the frame's name escaped", async () => {
    const asked: [string, RequestInit | undefined][] = [];
    const send = (async (url: string, init?: RequestInit) => {
      asked.push([url, init]);
      return new Response(url.includes("finish") ? '{"command": "lambent train"}' : "{}");
    }) as typeof fetch;
    expect(keyOf("#key=a%2Fb")).toBe("a/b");
    expect([keyOf(""), keyOf("#key=")]).toEqual([null, null]);
    const backend = localBackend("a/b", send);
    await backend.picture("IMG 1&2", 240.4);
    await backend.mask("x");
    const signal = new AbortController().signal;
    await backend.apply(documentOf([mark("x")]), signal);
    expect(await backend.finish(documentOf([]))).toBe("lambent train");
    expect(asked.map(([url]) => url)).toEqual([
      "/edit/a%2Fb/picture?frame=IMG%201%262&side=240",
      "/edit/a%2Fb/mask?frame=x",
      "/edit/a%2Fb/corrections",
      "/edit/a%2Fb/finish",
    ]);
    expect(asked[2]![1]).toMatchObject({ method: "POST", signal });
    expect(JSON.parse(String(asked[2]![1]!.body))).toEqual(documentOf([mark("x")]));
  });

  it("says that the command has ended, and what it refuses", async () => {
    const gone = localBackend("k", async () => Promise.reject(new TypeError("failed to fetch")));
    await expect(gone.load()).rejects.toThrow("has ended");
    const refusing = localBackend(
      "k",
      async () => new Response('{"code": "x", "detail": "too many corrections"}', { status: 413 }),
    );
    await expect(refusing.finish(documentOf([]))).rejects.toThrow("too many corrections");
  });
});
