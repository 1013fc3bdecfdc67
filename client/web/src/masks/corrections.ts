/** Corrections of masks by hand: boxes and strokes, the document that the worker reads, and its history. */

export type Label = "object" | "background";
/** Pixels of the photograph, x to the right and y down. */
export type Point = readonly [number, number];
export type Stroke = {
  readonly frame: string;
  readonly label: Label;
  readonly stroke: readonly Point[];
  readonly radius: number;
};
/** Left, top, right, bottom. */
export type Box = {
  readonly frame: string;
  readonly label: Label;
  readonly box: readonly [number, number, number, number];
};
export type Correction = Stroke | Box;
export type CorrectionList = { readonly version: 1; readonly corrections: readonly Correction[] };
export type Size = { readonly width: number; readonly height: number };

/** A box has at least as many pixels in both directions; less is a click that missed. */
const leastSide = 3;
const mostPoints = 2000;

/** Return the document of corrections. */
export function documentOf(corrections: readonly Correction[]): CorrectionList {
  return { version: 1, corrections };
}

/** Return a stroke through points, without those that change its place by less than an eighth of its radius. */
export function strokeOf(frame: string, label: Label, points: readonly Point[], radius: number): Stroke {
  let tolerance = Math.max(radius / 8, 0.5);
  let stroke = simplified(points, tolerance);
  while (stroke.length > mostPoints) {
    tolerance *= 2;
    stroke = simplified(points, tolerance);
  }
  return { frame, label, stroke: stroke.map(([x, y]) => [round(x), round(y)]), radius: round(radius) };
}

/** Return the box between two corners, within the photograph, or null if it is nearly empty. */
export function boxOf(frame: string, label: Label, one: Point, other: Point, size: Size): Box | null {
  const [left, right] = [one[0], other[0]].sort((a, b) => a - b).map((x) => clamp(x, size.width));
  const [top, bottom] = [one[1], other[1]].sort((a, b) => a - b).map((y) => clamp(y, size.height));
  if (right! - left! < leastSide || bottom! - top! < leastSide) return null;
  return { frame, label, box: [left!, top!, right!, bottom!] };
}

/** Return the points of a line that are further than `tolerance` from the line without them (Douglas, Peucker). */
export function simplified(points: readonly Point[], tolerance: number): Point[] {
  if (points.length < 3) return [...points];
  const kept = new Set([0, points.length - 1]);
  const open: [number, number][] = [[0, points.length - 1]];
  for (let part = open.pop(); part !== undefined; part = open.pop()) {
    const [first, last] = part;
    let [furthest, most] = [0, tolerance];
    for (let index = first + 1; index < last; index++) {
      const away = distance(points[index]!, points[first]!, points[last]!);
      if (away > most) [furthest, most] = [index, away];
    }
    if (most > tolerance) {
      kept.add(furthest);
      open.push([first, furthest], [furthest, last]);
    }
  }
  return points.filter((_, index) => kept.has(index));
}

/** All corrections, and what they were before each change. */
export class History {
  readonly #past: (readonly Correction[])[];
  #now: readonly Correction[];

  /** Corrections of earlier sessions can be undone one by one. */
  constructor(corrections: readonly Correction[]) {
    this.#now = corrections;
    this.#past = corrections.map((_, count) => corrections.slice(0, count));
  }

  get now(): readonly Correction[] {
    return this.#now;
  }

  get canUndo(): boolean {
    return this.#past.length > 0;
  }

  of(frame: string): Correction[] {
    return this.#now.filter((each) => each.frame === frame);
  }

  add(correction: Correction): void {
    this.#change([...this.#now, correction]);
  }

  /** Remove all corrections of a frame, as one step of the history. */
  clear(frame: string): void {
    const others = this.#now.filter((each) => each.frame !== frame);
    if (others.length < this.#now.length) this.#change(others);
  }

  /** Undo the last change, and return the frames that it affected. */
  undo(): ReadonlySet<string> {
    const before = this.#past.pop();
    if (before === undefined) return new Set();
    const [was, is] = [new Set(this.#now), new Set(before)];
    const differing = [...this.#now, ...before].filter((each) => was.has(each) !== is.has(each));
    this.#now = before;
    return new Set(differing.map((each) => each.frame));
  }

  #change(next: readonly Correction[]): void {
    this.#past.push(this.#now);
    this.#now = next;
  }
}

function distance([x, y]: Point, [x1, y1]: Point, [x2, y2]: Point): number {
  const [dx, dy] = [x2 - x1, y2 - y1];
  const length = dx * dx + dy * dy;
  const share = length === 0 ? 0 : Math.min(Math.max(((x - x1) * dx + (y - y1) * dy) / length, 0), 1);
  return Math.hypot(x - x1 - share * dx, y - y1 - share * dy);
}

const round = (value: number): number => Math.round(value * 10) / 10;
const clamp = (value: number, most: number): number => Math.round(Math.min(Math.max(value, 0), most));
