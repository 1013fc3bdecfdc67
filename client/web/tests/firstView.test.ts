import { describe, expect, it } from "vitest";
import type { PhotoCamera } from "../src/bundle/cameras.js";
import type { AtlasMesh } from "../src/bundle/mesh.js";
import { ballOf } from "../src/render/ball.js";
import { contactHeight } from "../src/render/contact.js";
import { orbitCamera } from "../src/viewer/camera.js";
import { elevationRange, firstPose, framed } from "../src/viewer/firstView.js";
import { initialState, limits } from "../src/viewer/state.js";

const [boundsMin, boundsMax] = [
  [-1, 2, 0],
  [3, 3, 0.5],
];
const ball = ballOf(boundsMin, boundsMax);
const positionsXyz = Float32Array.from(
  [-1, 3].flatMap((x) => [2, 3].flatMap((y) => [0, 0.5].flatMap((z) => [x, y, z]))),
);
const mesh = {
  positionsXyz,
  uv: new Float32Array(16),
  indices: new Uint32Array(0),
  normalsXyz: new Float32Array(24),
  tangentsXyzw: new Float32Array(32),
};

/** A camera at some angles around the middle of the box. */
function camera(azimuthDeg: number, elevationDeg: number): PhotoCamera {
  const pose = { ...initialState.pose, azimuthDeg, elevationDeg, distance: 4 };
  return { name: "", ...orbitCamera(pose, ball, 100, 80) };
}

/** Return the shares of the picture's sides that points span, and where their middle is. */
function spanOf(pose: typeof initialState.pose, width: number, height: number) {
  const { cameraToWorld: m, focalX, focalY, centreX, centreY } = orbitCamera(pose, ball, width, height);
  const [xs, ys]: [number[], number[]] = [[], []];
  for (let index = 0; index < positionsXyz.length; index += 3) {
    const local = [0, 1, 2].map((column) =>
      [0, 1, 2].reduce(
        (sum, row) => sum + m[4 * row + column]! * (positionsXyz[index + row]! - m[4 * row + 3]!),
        0,
      ),
    );
    xs.push((centreX + (focalX * local[0]!) / -local[2]!) / width);
    ys.push((centreY - (focalY * local[1]!) / -local[2]!) / height);
  }
  const [left, right, top, bottom] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  return { across: right - left, down: bottom - top, x: 0.5 * (left + right), y: 0.5 * (top + bottom) };
}

describe("the first view", () => {
  it.each([
    [800, 600, 30, 20],
    [400, 900, -100, 50],
    [1000, 300, 170, -10],
  ])("fills %i x %i pixels to 80 %%, in the middle", (width, height, azimuthDeg, elevationDeg) => {
    const from = { ...initialState.pose, azimuthDeg, elevationDeg };
    const pose = framed(from, ball, positionsXyz, width, height);
    const { across, down, x, y } = spanOf(pose, width, height);
    expect(Math.max(across, down)).toBeCloseTo(0.8, 2);
    expect(x).toBeCloseTo(0.5, 2);
    expect(y).toBeCloseTo(0.5, 2);
    expect([pose.azimuthDeg, pose.elevationDeg]).toEqual([azimuthDeg, elevationDeg]);
  });

  it("is from where a photograph was taken, one that looks down a little", () => {
    const cameras = [camera(10, 70), camera(-120, 24), camera(40, 2)];
    const pose = firstPose({ cameras, boundsMin, boundsMax, mesh }, 640, 480);
    expect(pose.azimuthDeg).toBeCloseTo(-120, 6);
    expect(pose.elevationDeg).toBeCloseTo(24, 6);
    expect(spanOf(pose, 640, 480).across).toBeCloseTo(0.8, 2);
    const alone = firstPose({ cameras: [], boundsMin, boundsMax, mesh }, 640, 480);
    expect(alone.azimuthDeg).toBe(initialState.pose.azimuthDeg);
  });

  it("lets one look from 15 degrees beyond the photographs", () => {
    const range = elevationRange({ cameras: [camera(0, 10), camera(90, 67)], boundsMin, boundsMax });
    expect(range[0]).toBeCloseTo(-5, 6);
    expect(range[1]).toBeCloseTo(82, 6);
    const high = elevationRange({ cameras: [camera(0, 85)], boundsMin, boundsMax });
    expect(high[1]).toBe(limits.elevation[1]);
    expect(elevationRange({ cameras: [], boundsMin, boundsMax })).toEqual(limits.elevation);
  });
});

describe("the height of the ground", () => {
  // A column of points; what lies at less than 0.1 was never photographed.
  const column = {
    positionsXyz: Float32Array.from({ length: 3000 }, (_, index) => (index % 3 === 2 ? index / 3000 : 0)),
    uv: Float32Array.from({ length: 2000 }, (_, index) => index / 2000),
  } as unknown as AtlasMesh;

  it("is that of the lowest points that a photograph shows, but for a few", () => {
    expect(contactHeight(column, (u) => u >= 0.1)).toBeCloseTo(0.1 + 0.9 * 0.005, 2);
    expect(contactHeight(column, null)).toBeCloseTo(0.005, 2);
    expect(contactHeight(column, () => false)).toBeCloseTo(0.005, 2);
  });
});
