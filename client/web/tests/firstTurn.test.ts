import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import { isSlow, turnUntilInput } from "../src/viewer/firstTurn.js";
import { sidesOf } from "../src/viewer/frozen.js";
import { turnedFor, turnFor, turnTowards } from "../src/viewer/turning.js";
import { fromParameters, initialState, toParameters, type ViewerState } from "../src/viewer/state.js";
import type { Viewer } from "../src/viewer/viewer.js";

const home = turnTowards(70);

describe("the turn of a light that nobody has turned", () => {
  it("goes with the first view for built-in lights, and is none for maps", () => {
    expect(home).toEqual({ yawDeg: 70, pitchDeg: 0, rollDeg: 0, intensity: 1 });
    expect(turnTowards(269.7).yawDeg).toBe(-90);
    expect(turnFor("preset:sky", home)).toBe(home);
    expect(turnFor("trained:day", home)).toBe(initialState.turn);
    expect(turnFor("file:a.hdr", home)).toBe(initialState.turn);
  });

  it("comes with another light, and stays once someone has turned it", () => {
    const built = { environment: "preset:studio", turn: home };
    expect(turnedFor({ environment: "trained:day" }, built, home).turn).toBe(initialState.turn);
    expect(turnedFor({ environment: "preset:sky" }, built, home).turn).toBe(home);
    const photographed = { environment: "trained:day", turn: initialState.turn };
    expect(turnedFor({ environment: "preset:sky" }, photographed, home).turn).toBe(home);
    const chosen = { ...built, turn: { ...home, yawDeg: 5 } };
    expect(turnedFor({ environment: "trained:day" }, chosen, home)).toEqual({ environment: "trained:day" });
    expect(turnedFor({ free: true }, built, home)).toEqual({ free: true });
    const both = { environment: "trained:day", turn: chosen.turn };
    expect(turnedFor(both, built, home)).toBe(both);
  });

  it("is left out of an address, and one that a user chose is not, even if it is none", () => {
    expect(toParameters(initialState).has("rotate")).toBe(false);
    const unturned = { ...initialState, turn: { ...initialState.turn } };
    expect(toParameters(unturned).get("rotate")).toBe("0,0,0");
    expect(fromParameters(new URLSearchParams("env=preset:sky")).turn).toBe(initialState.turn);
    const read = fromParameters(toParameters(unturned)).turn;
    expect(read).toEqual(initialState.turn);
    expect(read).not.toBe(initialState.turn);
  });
});

describe("two lights side by side", () => {
  const sides = (change: Partial<ViewerState>) =>
    sidesOf({ ...initialState, compare: "environment", environmentB: "trained:day", ...change }, home);

  it("stand as each of them stands alone, until someone turns the light", () => {
    expect(sides({ turn: home }).map(({ turn }) => turn)).toEqual([home, initialState.turn]);
    const trained = { environment: "trained:day", turn: initialState.turn, environmentB: "preset:sky" };
    expect(sides(trained).map(({ turn }) => turn)).toEqual([initialState.turn, home]);
    const chosen = { ...home, yawDeg: 3 };
    expect(sides({ turn: chosen }).map(({ turn }) => turn)).toEqual([chosen, chosen]);
  });
});

describe("the turn until the first input", () => {
  let frames: FrameRequestCallback[] = [];
  let now = 0;
  let isStill = false;
  let top = 0;
  /** Draw frames, `ms` apart. */
  const pass = (count: number, ms: number): void => {
    for (let k = 0; k < count; k++) {
      now += ms;
      const due = frames;
      frames = [];
      for (const each of due) each(now);
    }
  };

  beforeEach(() => {
    [frames, now, isStill, top] = [[], 0, false, 0];
    vi.stubGlobal("innerHeight", 800);
    vi.stubGlobal("requestAnimationFrame", (each: FrameRequestCallback) => frames.push(each));
    vi.stubGlobal("cancelAnimationFrame", () => {
      frames = [];
    });
    vi.stubGlobal("matchMedia", () => ({ matches: isStill }));
  });
  afterEach(() => vi.unstubAllGlobals());

  /** Return a viewer that has just opened a bundle, the reported motion, and its page. */
  function opened(change: Partial<ViewerState> = {}) {
    const heard = new Map<string, () => void>();
    const viewer = {
      state: { ...initialState, turn: home, ...change },
      homeTurn: home,
      on: (name: string, listener: () => void) => {
        heard.set(name, listener);
        return () => heard.delete(name);
      },
      update: async (more: Partial<ViewerState>) => {
        viewer.state = { ...viewer.state, ...more };
        await null;
        heard.get("change")?.();
      },
    };
    const told: boolean[] = [];
    const box = () => ({ top, bottom: top + 400 });
    const host = Object.assign(new EventTarget(), { getBoundingClientRect: box });
    const stop = new AbortController();
    const moving = (on: boolean): void => void told.push(on);
    turnUntilInput(viewer as unknown as Viewer, host as unknown as HTMLElement, moving, stop.signal);
    heard.get("load")!();
    return { viewer, told, host, stop };
  }

  it("turns by ten degrees a second, and ends where something is touched", () => {
    const { viewer, told, host } = opened();
    pass(1, 16);
    pass(61, 50);
    expect(viewer.state.turn.yawDeg).toBeCloseTo(100.5);
    // What nobody has chosen goes with the next light.
    expect(viewer.state.turn).toBe(viewer.homeTurn);
    host.dispatchEvent(new Event("pointerdown"));
    pass(10, 50);
    expect(viewer.state.turn.yawDeg).toBe(101);
    expect(viewer.state.turn).toBe(viewer.homeTurn);
    expect(told).toEqual([true, false]);
  });

  it("continues where a page in the background was left", () => {
    const { viewer } = opened();
    pass(1, 16);
    pass(1, 60_000);
    expect(viewer.state.turn.yawDeg).toBeCloseTo(71);
    pass(20, 50);
    expect(viewer.state.turn.yawDeg).toBeCloseTo(81);
  });

  it("ends with a change by anyone, with the page, and after three turns", async () => {
    const { viewer, told } = opened();
    pass(20, 50);
    await viewer.update({ free: true });
    pass(20, 50);
    expect(told).toEqual([true, false]);
    const second = opened();
    second.stop.abort();
    expect(frames).toEqual([]);
    const third = opened();
    pass(108 * 20 + 10, 50);
    expect(third.told).toEqual([true, false]);
    expect(frames).toEqual([]);
  });

  it("gives way to a change whose light is still on its way", () => {
    const { viewer, told } = opened();
    pass(5, 50);
    const asked = { ...viewer.state, environment: "url:slow.hdr", turn: initialState.turn };
    viewer.state = asked;
    pass(5, 50);
    expect(told).toEqual([true, false]);
    expect(viewer.state).toBe(asked);
  });

  it("waits while the element is out of the window", () => {
    const { viewer } = opened();
    pass(1, 16);
    top = 900;
    pass(20, 50);
    expect(viewer.state.turn.yawDeg).toBe(70);
    top = 0;
    pass(20, 50);
    expect(viewer.state.turn.yawDeg).toBeCloseTo(80);
  });

  it("ends where frames take long", () => {
    const { told } = opened();
    pass(8, 95);
    expect(told).toEqual([true]);
    pass(1, 95);
    expect(told).toEqual([true, false]);
    expect(isSlow([500, ...Array<number>(8).fill(20)])).toBe(false);
  });

  it("does not begin where less motion is asked for, or something was chosen", () => {
    isStill = true;
    expect(opened().told).toEqual([]);
    isStill = false;
    const others = [{ turn: { ...home } }, { refine: true }, { compare: "plain" as const }];
    for (const change of others) expect(opened(change).told).toEqual([]);
  });
});
