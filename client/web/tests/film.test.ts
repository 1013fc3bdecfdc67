import { describe, expect, it } from "vitest";
import { defaultPlan, frameCount, momentAt, momentOf, motions, planned } from "../src/film/plan.js";
import { initialState } from "../src/viewer/state.js";

describe("the plan of a film", () => {
  it("has as many frames as its length says", () => {
    expect(frameCount(planned({}))).toBe(120);
    expect(frameCount(planned({ seconds: 1.5, framesPerSecond: 24 }))).toBe(36);
    expect(frameCount(planned({ seconds: 0.1, framesPerSecond: 1 }))).toBe(1);
  });

  it("takes what is not said from the default, and nothing else", () => {
    const asked = { width: 640, height: 360, seconds: undefined, onFrame: () => {} } as object;
    expect(planned(asked)).toEqual({ ...defaultPlan, width: 640, height: 360 });
  });

  it.each([
    { width: 641, height: 360 },
    { width: 640, height: 0 },
    { width: Number.NaN },
    { width: 4098 },
    { seconds: 0 },
    { seconds: 61 },
    { framesPerSecond: 0.5 },
    { framesPerSecond: Number.NaN },
    { motion: "spiral" as never },
    { format: "gif" as never },
  ])("is refused with %j", (asked) => {
    expect(() => planned(asked)).toThrow(expect.objectContaining({ code: "film.plan" }));
  });
});

describe("the moments of a film", () => {
  it("leave the last one to the first frame where it is repeated", () => {
    const plan = planned({ seconds: 1, framesPerSecond: 4 });
    expect([0, 1, 2, 3].map((frame) => momentAt(plan, frame))).toEqual([0, 0.25, 0.5, 0.75]);
    const once = { ...plan, loop: false };
    expect([0, 1, 2, 3].map((frame) => 3 * momentAt(once, frame))).toEqual([0, 1, 2, 3]);
  });

  it("turn the camera, the light, or both once", () => {
    expect(momentOf(initialState, "turntable", 0.5).pose?.azimuthDeg).toBe(
      initialState.pose.azimuthDeg - 180,
    );
    expect(momentOf(initialState, "turntable", 0.5).turn).toBeUndefined();
    expect(momentOf(initialState, "light", 0.25)).toEqual({ turn: { ...initialState.turn, yawDeg: 90 } });
    const both = momentOf(initialState, "both", 0.25);
    expect([both.pose?.azimuthDeg, both.turn?.yawDeg]).toEqual([initialState.pose.azimuthDeg + 90, -90]);
  });

  it.each(motions)("of %s begin as the viewer is", (motion) => {
    expect({ ...initialState, ...momentOf(initialState, motion, 0) }).toEqual(initialState);
  });
});
