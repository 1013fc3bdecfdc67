/** Draws masks and marks on canvases. */

import type { Correction, Label, Point } from "./corrections.js";
import { toScreen, type Viewport } from "./viewport.js";

const outlineRgb = [230, 0, 160] as const;
const dimmedAlpha = 165;
const labelColours: Readonly<Record<Label, string>> = { object: "#00c8e6", background: "#ff9d00" };

/** Turn a mask's grey levels, in RGBA, into an overlay for the photograph: the object outlined, the rest dimmed. */
export function overlay(rgba: Uint8ClampedArray, width: number, height: number): void {
  const inside = new Uint8Array(width * height);
  for (let index = 0; index < inside.length; index++) inside[index] = rgba[4 * index]! >= 128 ? 1 : 0;
  const at = (x: number, y: number) =>
    x < 0 || y < 0 || x >= width || y >= height ? 1 : inside[y * width + x]!;
  for (let y = 0; y < height; y++) {
    for (let x = 0; x < width; x++) {
      const index = y * width + x;
      const out = 4 * index;
      const edge = inside[index] && !(at(x - 1, y) && at(x + 1, y) && at(x, y - 1) && at(x, y + 1));
      const [red, green, blue] = edge ? outlineRgb : [24, 24, 24];
      rgba[out] = red;
      rgba[out + 1] = green;
      rgba[out + 2] = blue;
      rgba[out + 3] = edge ? 255 : inside[index] ? 0 : dimmedAlpha;
    }
  }
}

/** Return a mask as an overlay for a photograph, `width` pixels wide. */
export function overlayOf(mask: ImageBitmap, width = mask.width): HTMLCanvasElement {
  const canvas = document.createElement("canvas");
  canvas.width = width;
  canvas.height = Math.max(1, Math.round((width * mask.height) / mask.width));
  const context = canvas.getContext("2d", { willReadFrequently: true })!;
  context.drawImage(mask, 0, 0, canvas.width, canvas.height);
  const pixels = context.getImageData(0, 0, canvas.width, canvas.height);
  overlay(pixels.data, canvas.width, canvas.height);
  context.putImageData(pixels, 0, 0);
  return canvas;
}

/** Draw a small photograph with its mask. */
export function drawThumbnail(canvas: HTMLCanvasElement, picture: ImageBitmap, mask: ImageBitmap): void {
  canvas.width = picture.width;
  canvas.height = picture.height;
  const context = canvas.getContext("2d")!;
  context.drawImage(picture, 0, 0);
  context.drawImage(overlayOf(mask, picture.width), 0, 0, picture.width, picture.height);
}

/** Draw a box or a stroke; marks of the background are dashed, so that colour is not the only difference. */
export function drawMark(context: CanvasRenderingContext2D, view: Viewport, mark: Correction): void {
  context.save();
  context.strokeStyle = labelColours[mark.label];
  context.lineJoin = "round";
  if ("box" in mark) {
    const [left, top] = toScreen(view, [mark.box[0], mark.box[1]]);
    const [right, bottom] = toScreen(view, [mark.box[2], mark.box[3]]);
    outline(context, mark.label, () => context.rect(left, top, right - left, bottom - top));
  } else {
    const line = () => {
      const points: readonly Point[] = mark.stroke.map((point) => toScreen(view, point));
      context.moveTo(...points[0]!);
      for (const point of points.length > 1 ? points.slice(1) : points) context.lineTo(...point);
    };
    context.lineCap = "round";
    context.globalAlpha = 0.4;
    context.lineWidth = Math.max(2 * mark.radius * view.scale, 2);
    context.beginPath();
    line();
    context.stroke();
    context.globalAlpha = 1;
    outline(context, mark.label, line);
  }
  context.restore();
}

/** Draw a line in the current colour over a black one, so that it is visible on everything. */
function outline(context: CanvasRenderingContext2D, label: Label, path: () => void): void {
  const colour = context.strokeStyle;
  context.setLineDash([]);
  context.beginPath();
  path();
  context.lineWidth = 4;
  context.strokeStyle = "#000000";
  context.stroke();
  context.setLineDash(label === "object" ? [] : [7, 5]);
  context.lineWidth = 2;
  context.strokeStyle = colour;
  context.stroke();
}

/** Draw the brush or the corner of a box at a place of the screen. */
export function drawCursor(
  context: CanvasRenderingContext2D,
  [x, y]: Point,
  radius: number | null,
  label: Label,
): void {
  context.save();
  context.strokeStyle = labelColours[label];
  outline(context, "object", () => {
    if (radius !== null) context.arc(x, y, Math.max(radius, 2), 0, 2 * Math.PI);
    context.moveTo(x - 6, y);
    context.lineTo(x + 6, y);
    context.moveTo(x, y - 6);
    context.lineTo(x, y + 6);
  });
  context.restore();
}
