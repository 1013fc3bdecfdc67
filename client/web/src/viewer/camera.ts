/** From an orbit to a camera, and what a photograph's camera becomes on a canvas. */

import type { PhotoCamera } from "../bundle/cameras.js";
import type { Ball } from "../render/ball.js";
import type { ViewCamera } from "../render/looks.js";
import type { OrbitPose } from "./state.js";

/** Vertical field of view on a square canvas. */
export const fieldOfViewDeg = 35;

/** Return the directions to the right, up and back of the camera of an orbit. */
export function axesOf(pose: OrbitPose) {
  const [azimuth, elevation] = [(pose.azimuthDeg * Math.PI) / 180, (pose.elevationDeg * Math.PI) / 180];
  const [cosA, sinA] = [Math.cos(azimuth), Math.sin(azimuth)];
  const [cosE, sinE] = [Math.cos(elevation), Math.sin(elevation)];
  return {
    right: [-sinA, cosA, 0],
    up: [-cosA * sinE, -sinA * sinE, cosE],
    back: [cosA * cosE, sinA * cosE, sinE],
  } as const;
}

/** Return the camera of an orbit; the field of view fits into the shorter side. */
export function orbitCamera(pose: OrbitPose, ball: Ball, width: number, height: number): ViewCamera {
  const { right, up, back } = axesOf(pose);
  const eye = ball.centre.map(
    (value, axis) => value + ball.radius * (pose.target[axis]! + pose.distance * back[axis]!),
  );
  const focal = (0.5 * Math.min(width, height)) / Math.tan((fieldOfViewDeg * Math.PI) / 360);
  return {
    width,
    height,
    focalX: focal,
    focalY: focal,
    centreX: width / 2,
    centreY: height / 2,
    cameraToWorld: [0, 1, 2]
      .flatMap((axis) => [right[axis]!, up[axis]!, back[axis]!, eye[axis]!])
      .concat([0, 0, 0, 1]),
  };
}

/** Return a photograph's camera on a canvas: the whole photograph fits, in the middle. */
export function photoCamera(photo: PhotoCamera, width: number, height: number): ViewCamera {
  const scale = Math.min(width / photo.width, height / photo.height);
  return {
    width,
    height,
    focalX: photo.focalX * scale,
    focalY: photo.focalY * scale,
    centreX: photo.centreX * scale + 0.5 * (width - photo.width * scale),
    centreY: photo.centreY * scale + 0.5 * (height - photo.height * scale),
    cameraToWorld: photo.cameraToWorld,
  };
}

/** Parts of a canvas that controls lie on, from its edges; shares of its width and height. */
export type Inset = {
  readonly top: number;
  readonly right: number;
  readonly bottom: number;
  readonly left: number;
};

export const noInset: Inset = { top: 0, right: 0, bottom: 0, left: 0 };

/** Return the camera of a canvas whose picture belongs into what an inset leaves of it. */
export function beside(
  { top, right, bottom, left }: Inset,
  width: number,
  height: number,
  cameraOf: (width: number, height: number) => ViewCamera,
): ViewCamera {
  const side = (length: number, taken: number): number => Math.max(1, Math.round(length * (1 - taken)));
  const inner = cameraOf(side(width, left + right), side(height, top + bottom));
  const centreX = inner.centreX + Math.round(width * left);
  const centreY = inner.centreY + Math.round(height * top);
  return { ...inner, width, height, centreX, centreY };
}

/** Return the vertical field of view of a camera, in degrees. */
export function verticalFieldDeg({ height, focalY }: ViewCamera): number {
  return (2 * Math.atan(height / (2 * focalY)) * 180) / Math.PI;
}

const maxPixelRatio = 2;
/** Pixels of a canvas at most, of a whole and of its longer side: more are drawn too slowly, and shown smaller. */
const [mostPixels, mostSide] = [1 << 24, 8192];

/** Return the size that a canvas should have in pixels, for the room that it has on its page. */
export function sizeOf({
  clientWidth,
  clientHeight,
}: Pick<HTMLCanvasElement, "clientWidth" | "clientHeight">): {
  readonly width: number;
  readonly height: number;
} {
  const most = Math.min(
    Math.sqrt(mostPixels / Math.max(clientWidth * clientHeight, 1)),
    mostSide / Math.max(clientWidth, clientHeight, 1),
  );
  const ratio = Math.min(globalThis.devicePixelRatio || 1, maxPixelRatio, most);
  const side = (css: number): number => Math.max(1, Math.round(css * ratio));
  return { width: side(clientWidth), height: side(clientHeight) };
}
