import { describe, expect, it } from "vitest";
import { changedParts, StateHistory } from "../src/viewer/history.js";
import { resetOf } from "../src/viewer/resets.js";
import { initialState, type ViewerState } from "../src/viewer/state.js";
import { stepOf } from "../src/viewer/undo.js";

const turned = (azimuthDeg: number, from = initialState): ViewerState => ({
  ...from,
  pose: { ...from.pose, azimuthDeg },
});
const lit = (environment: string, from = initialState): ViewerState => ({ ...from, environment });
const rotated = (yawDeg: number, from = initialState): ViewerState => ({
  ...from,
  turn: { ...from.turn, yawDeg },
});

describe("the history of what is shown", () => {
  it("goes back and forth, and a new change ends what was undone", () => {
    const history = new StateHistory(initialState);
    history.record(lit("preset:sky"), 0);
    history.record(lit("preset:even"), 10);
    expect(history.undo()?.environment).toBe("preset:sky");
    expect(history.undo()).toEqual(initialState);
    expect([history.undo(), history.canUndo]).toEqual([null, false]);
    expect(history.redo()?.environment).toBe("preset:sky");
    history.record(turned(50, lit("preset:sky")), 20);
    expect([history.redo(), history.canRedo]).toEqual([null, false]);
    expect(history.undo()).toEqual(lit("preset:sky"));
  });
  it("takes a continuous drag as one change, and two drags as two", () => {
    const history = new StateHistory(initialState);
    for (let step = 1; step <= 10; step++) history.record(turned(30 + step), 100 * step);
    history.record(turned(80), 5000);
    history.record(turned(81), 5100);
    expect(history.undo()).toEqual(turned(40));
    expect(history.undo()).toEqual(initialState);
  });
  it("takes what happens in one hold as one change, however slow and whatever it is of", () => {
    const history = new StateHistory(initialState);
    history.hold(true);
    history.record(turned(40), 0);
    history.record(rotated(5, turned(40)), 9000);
    history.record(turned(50, rotated(5)), 18000);
    history.hold(false);
    // What moves on after it was let go belongs to it.
    history.record(turned(52, rotated(5)), 18100);
    history.hold(true);
    history.record(turned(60, rotated(5)), 18200);
    expect(history.undo()).toEqual(turned(52, rotated(5)));
    expect(history.undo()).toEqual(initialState);
  });
  it("keeps choices apart, however fast they follow each other", () => {
    const history = new StateHistory(initialState);
    history.record(lit("preset:sky"), 0);
    history.record(lit("preset:even"), 1);
    history.record(turned(40, lit("preset:even")), 2);
    history.apart();
    history.record(turned(30, lit("preset:even")), 3);
    expect(history.undo()).toEqual(turned(40, lit("preset:even")));
    expect(history.undo()).toEqual(lit("preset:even"));
    expect(history.undo()).toEqual(lit("preset:sky"));
  });
  it("does not count what changes nothing, nor what was undone", () => {
    const history = new StateHistory(initialState);
    history.record({ ...initialState }, 0);
    expect(history.canUndo).toBe(false);
    history.record(lit("preset:sky"), 1);
    history.record(history.undo()!, 2);
    expect([history.canUndo, history.canRedo]).toEqual([false, true]);
    history.reset(lit("preset:sky"));
    expect([history.canUndo, history.canRedo]).toEqual([false, false]);
  });
  it("knows in which parts two states differ", () => {
    expect(changedParts(initialState, rotated(5, lit("file:a.exr")))).toEqual(["env", "rotate"]);
  });
});

describe("resets", () => {
  const other: ViewerState = {
    ...rotated(50, turned(99, lit("preset:sky"))),
    look: {
      ...initialState.look,
      tone: "agx",
      edit: { albedoGain: [2, 2, 2], roughnessScale: 2, metalnessShift: 0.5 },
    },
    compare: "plain",
    refine: true,
  };
  it.each([
    ["light", ["rotate"]],
    ["camera", ["camera"]],
    ["material", ["gain", "roughness", "metalness"]],
    ["picture", ["tone", "refine"]],
  ] as const)("of the %s touch nothing else", (part, names) => {
    const homeTurn = { ...initialState.turn, yawDeg: -20 };
    const after = { ...other, ...resetOf(part, other, { home: initialState.pose, homeTurn }) };
    expect(changedParts(other, after)).toEqual(names);
    const still = changedParts(after, { ...initialState, turn: homeTurn });
    for (const name of names) expect(still).not.toContain(name);
  });
});

describe("keys", () => {
  const key = (name: string, more = {}) =>
    stepOf({ key: name, shiftKey: false, altKey: false, ctrlKey: true, metaKey: false, ...more });
  it("undo and redo as elsewhere", () => {
    expect([key("z"), key("Z", { shiftKey: true }), key("y")]).toEqual(["undo", "redo", "redo"]);
    expect(key("z", { ctrlKey: false, metaKey: true })).toBe("undo");
    expect([key("z", { ctrlKey: false }), key("z", { altKey: true }), key("a")]).toEqual([null, null, null]);
  });
});
