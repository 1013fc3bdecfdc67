import { describe, expect, it, vi } from "vitest";
import { ballOf } from "../src/render/ball.js";
import { beside, noInset, orbitCamera, photoCamera, sizeOf, verticalFieldDeg } from "../src/viewer/camera.js";
import { afterKey, orbited, panned, zoomed } from "../src/viewer/orbit.js";
import { pick } from "../src/viewer/pick.js";
import { encodeExr } from "../src/viewer/save.js";
import {
  fromParameters,
  initialState,
  toParameters,
  type ViewerState,
  wrapped,
} from "../src/viewer/state.js";
import { readExr } from "../src/light/exrInput.js";
import { toHalf } from "../src/engine/half.js";

describe("an address", () => {
  const other: ViewerState = {
    environment: "preset:sky",
    turn: { yawDeg: 90, pitchDeg: -20, rollDeg: 5, intensity: 2 },
    look: {
      channel: "albedo",
      tone: "agx",
      exposureEv: -1.5,
      autoExposure: false,
      background: "colour",
      backgroundSrgb: [0.2, 0.4, 0.6],
      edit: { albedoGain: [1.5, 1, 0.5], roughnessScale: 0.5, metalnessShift: 0.25 },
      indirect: false,
      ground: true,
    },
    pose: { azimuthDeg: -120, elevationDeg: 45, distance: 2.5, target: [0.1, -0.2, 0.3] },
    compare: "environment",
    environmentB: "preset:even",
    split: 0.25,
    photo: "r_012",
    refine: true,
    free: true,
  };

  it("brings back every part of the state", () => {
    expect(fromParameters(toParameters(other))).toEqual(other);
    expect(fromParameters(new URLSearchParams(toParameters(other).toString()))).toEqual(other);
  });
  it("says nothing of what is as at the start, and nothing of files that are at no address", () => {
    expect(toParameters(initialState).toString()).toBe("");
    expect(toParameters({ ...initialState, environment: "file:my.exr" }).toString()).toBe("");
  });
  it("without a camera has the pose that the viewer finds", () => {
    const { pose } = fromParameters(new URLSearchParams("env=preset:sky"));
    expect(pose).toBe(initialState.pose);
  });

  it("is kept within limits, and nonsense is ignored", () => {
    const text = "ev=99&camera=1,2&tone=none&rotate=725,0,0&intensity=NaN&split=-1&gain=9,9,9&compare=x";
    const state = fromParameters(new URLSearchParams(text));
    expect(state.look.exposureEv).toBe(8);
    expect(state.pose).toEqual(initialState.pose);
    expect(state.look.tone).toBe("neutral");
    expect(state.turn.yawDeg).toBe(5);
    expect([state.turn.intensity, state.split, state.compare]).toEqual([1, 0, "off"]);
    expect(state.look.edit.albedoGain).toEqual([4, 4, 4]);
  });
});

describe("a camera that turns", () => {
  it("stays within the elevations of photographs, and does not jump where it is outside", () => {
    const range = [-5, 60] as const;
    const at = (elevationDeg: number) => ({ ...initialState.pose, elevationDeg });
    expect(orbited(at(50), 0, 40, range).elevationDeg).toBe(60);
    expect(orbited(at(0), 0, -40, range).elevationDeg).toBe(-5);
    expect(orbited(at(80), 0, 5, range).elevationDeg).toBe(80);
    expect(orbited(at(80), 0, -5, range).elevationDeg).toBe(75);
    expect(orbited(at(80), 0, 5).elevationDeg).toBe(85);
    const { pose, turn } = initialState;
    const press = { key: "ArrowDown", shiftKey: false, altKey: false, ctrlKey: false, metaKey: false };
    expect(afterKey(press, { pose: { ...pose, elevationDeg: -4 }, turn }, range)?.pose?.elevationDeg).toBe(
      -5,
    );
  });
});

describe("the camera", () => {
  const ball = ballOf([-1, -2, -2], [3, 2, 2]);

  it("stands where the orbit says and looks at the middle", () => {
    expect(ball.centre).toEqual([1, 0, 0]);
    const pose = { azimuthDeg: 90, elevationDeg: 0, distance: 2, target: [0, 0, 0] } as const;
    const { cameraToWorld, centreX, focalX } = orbitCamera(pose, ball, 200, 100);
    // Columns: right, up, back, position. From +y with z up, right is -x.
    const expected = [-1, 0, 0, 1, 0, 0, 1, 2 * ball.radius, 0, 1, 0, 0, 0, 0, 0, 1];
    expect(Math.max(...cameraToWorld.map((value, index) => Math.abs(value - expected[index]!)))).toBeLessThan(
      1e-12,
    );
    expect(centreX).toBe(100);
    expect(focalX).toBeCloseTo(50 / Math.tan((17.5 * Math.PI) / 180), 9);
  });
  it("has as many pixels as its place, two for one at most, and not more than can be drawn", () => {
    vi.stubGlobal("devicePixelRatio", 3);
    expect(sizeOf({ clientWidth: 640, clientHeight: 480 })).toEqual({ width: 1280, height: 960 });
    const wide = sizeOf({ clientWidth: 7680, clientHeight: 4320 });
    expect(wide.width * wide.height).toBeLessThan(1.001 * 2 ** 24);
    expect(wide.width / wide.height).toBeCloseTo(16 / 9, 3);
    expect(sizeOf({ clientWidth: 20_000, clientHeight: 100 })).toEqual({ width: 8192, height: 41 });
    expect(sizeOf({ clientWidth: 0, clientHeight: 0 })).toEqual({ width: 1, height: 1 });
    vi.unstubAllGlobals();
  });
  it("of a photograph fits the whole photograph into the canvas", () => {
    const photo = {
      ...{ name: "a", width: 100, height: 50, focalX: 120, focalY: 110, centreX: 49, centreY: 26 },
      cameraToWorld: [],
    };
    const found = photoCamera(photo, 400, 400);
    expect([found.focalX, found.focalY, found.centreX, found.centreY]).toEqual([480, 440, 196, 204]);
  });
});

describe("what lies on the canvas", () => {
  const ball = ballOf([-1, -1, -1], [1, 1, 1]);
  const cameraOf = (width: number, height: number) => orbitCamera(initialState.pose, ball, width, height);

  it("leaves the object in the middle of the rest, as large as that allows", () => {
    const camera = beside({ ...noInset, bottom: 0.5, left: 0.1 }, 400, 800, cameraOf);
    expect([camera.width, camera.height]).toEqual([400, 800]);
    expect([camera.centreX, camera.centreY]).toEqual([220, 200]);
    expect(camera.focalX).toBe(cameraOf(360, 400).focalX);
    expect(beside(noInset, 400, 800, cameraOf)).toEqual(cameraOf(400, 800));
  });
  it("does not change how much of the world a pixel shows", () => {
    expect(verticalFieldDeg(cameraOf(300, 300))).toBeCloseTo(35, 9);
    expect(verticalFieldDeg(cameraOf(300, 600))).toBeGreaterThan(35);
  });
});

describe("the point under the pointer", () => {
  // Two triangles that face +x, one behind the other.
  const mesh = {
    positionsXyz: Float32Array.from([0, -1, -1, 0, 1, -1, 0, 0, 1, 0.5, -1, -1, 0.5, 1, -1, 0.5, 0, 1]),
    indices: Uint32Array.from([0, 1, 2, 3, 4, 5]),
  };
  const pose = { azimuthDeg: 0, elevationDeg: 0, distance: 4, target: [0, 0, 0] } as const;
  const camera = orbitCamera(pose, { centre: [0, 0, 0], radius: 1 }, 200, 100);

  it("is on the nearest surface", () => {
    const found = pick(mesh, camera, 100, 50)!;
    expect(found.map((value) => Number(value.toFixed(9)))).toEqual([0.5, 0, 0]);
    const other = pick(mesh, camera, 110, 60)!;
    expect(other[0]).toBeCloseTo(0.5, 9);
    expect(other[1]).toBeCloseTo((10 / camera.focalX) * 3.5, 9);
    expect(other[2]).toBeCloseTo((-10 / camera.focalY) * 3.5, 9);
  });
  it("is nowhere beside the object, and not behind the eye", () => {
    expect(pick(mesh, camera, 1, 1)).toBeNull();
    const away = orbitCamera({ ...pose, target: [9, 0, 0] }, { centre: [0, 0, 0], radius: 1 }, 200, 100);
    expect(pick(mesh, { ...away, cameraToWorld: flipped(away.cameraToWorld) }, 100, 50)).toBeNull();
  });

  /** Look the other way. */
  function flipped(pose: readonly number[]): number[] {
    return pose.map((value, index) => (index % 4 === 2 || index % 4 === 0 ? -value : value));
  }
});

describe("turning", () => {
  const { pose, turn } = initialState;

  it("stops at the poles and wraps around", () => {
    expect(orbited(pose, 0, 500).elevationDeg).toBe(89);
    expect(orbited({ ...pose, azimuthDeg: 170 }, 20, 0).azimuthDeg).toBe(-170);
    expect([wrapped(180), wrapped(-540), wrapped(-180)]).toEqual([-180, -180, -180]);
    expect(zoomed(pose, 1000).distance).toBe(20);
  });
  it("moves the target in the picture's plane", () => {
    const moved = panned({ ...pose, azimuthDeg: 0, elevationDeg: 0, distance: 2 }, 0.1, 0.2).target;
    expect(moved.map((value) => Number(value.toFixed(12)))).toEqual([0, 0.2, 0.4]);
  });
  it.each([
    ["ArrowLeft", false, { pose: orbited(pose, -5, 0) }],
    ["ArrowUp", false, { pose: orbited(pose, 0, 5) }],
    ["ArrowRight", true, { turn: { ...turn, yawDeg: 5 } }],
    ["[", false, { turn: { ...turn, yawDeg: -5 } }],
    ["+", false, { pose: zoomed(pose, 1 / 1.1) }],
    ["q", false, null],
  ] as const)("by the key %s", (key, shiftKey, expected) => {
    const event = { key, shiftKey, altKey: false, ctrlKey: false, metaKey: false };
    expect(afterKey(event, { pose, turn })).toEqual(expected);
  });
});

describe("an EXR picture", () => {
  it("is read back as it was written", async () => {
    const [width, height] = [3, 2];
    const values = Array.from({ length: 4 * width * height }, (_, index) => 0.25 * index);
    const map = await readExr(encodeExr(Uint16Array.from(values, toHalf), width, height), 100);
    expect([map.width, map.height]).toEqual([3, 2]);
    const expected = values.filter((_, index) => index % 4 < 3);
    expect([...map.radianceRgb]).toEqual(expected);
  });
});
