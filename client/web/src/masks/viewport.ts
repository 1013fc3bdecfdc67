/** The place of a photograph on the screen, and its zoom. */

import type { Point, Size } from "./corrections.js";

/** A point of the photograph is at `scale * point + (x, y)` on the screen, CSS pixels. */
export type Viewport = { readonly scale: number; readonly x: number; readonly y: number };

const mostZoom = 40;

/** Return the viewport that shows the whole photograph in the middle of the screen. */
export function fitted(photo: Size, screen: Size): Viewport {
  const scale = Math.min(screen.width / photo.width, screen.height / photo.height);
  return {
    scale,
    x: (screen.width - scale * photo.width) / 2,
    y: (screen.height - scale * photo.height) / 2,
  };
}

export function toPhoto(view: Viewport, x: number, y: number): Point {
  return [(x - view.x) / view.scale, (y - view.y) / view.scale];
}

export function toScreen(view: Viewport, [x, y]: Point): Point {
  return [view.scale * x + view.x, view.scale * y + view.y];
}

/** Return the viewport after zooming around a place of the screen that stays where it is. */
export function zoomed(
  view: Viewport,
  factor: number,
  x: number,
  y: number,
  photo: Size,
  screen: Size,
): Viewport {
  const least = fitted(photo, screen).scale;
  const scale = Math.min(Math.max(view.scale * factor, least), mostZoom * least);
  const [px, py] = toPhoto(view, x, y);
  return kept({ scale, x: x - scale * px, y: y - scale * py }, photo, screen);
}

export function moved(view: Viewport, dx: number, dy: number, photo: Size, screen: Size): Viewport {
  return kept({ ...view, x: view.x + dx, y: view.y + dy }, photo, screen);
}

/** Return the viewport moved as little as needed for a point of the photograph to be seen. */
export function showing(view: Viewport, point: Point, photo: Size, screen: Size): Viewport {
  const [x, y] = toScreen(view, point);
  const margin = 20;
  const dx = Math.max(margin - x, 0) + Math.min(screen.width - margin - x, 0);
  const dy = Math.max(margin - y, 0) + Math.min(screen.height - margin - y, 0);
  return dx === 0 && dy === 0 ? view : moved(view, dx, dy, photo, screen);
}

/** Return the viewport with no empty screen beside a photograph that could fill it. */
function kept(view: Viewport, photo: Size, screen: Size): Viewport {
  const place = (at: number, length: number, room: number) =>
    length <= room ? (room - length) / 2 : Math.min(Math.max(at, room - length), 0);
  return {
    scale: view.scale,
    x: place(view.x, view.scale * photo.width, screen.width),
    y: place(view.y, view.scale * photo.height, screen.height),
  };
}
