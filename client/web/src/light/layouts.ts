/**
 * Layouts of environment maps and their conversion to latitude-longitude, by the rules of
 * `lambent_relight.environment.layouts`: what is ahead ends up in the middle of the map, +x; up is +z. Position (s, t) in
 * a face is in [-1, 1], s to the right and t downwards; a face shows the direction ahead + s right + t down.
 */

import type { EnvironmentMap } from "../engine/environmentMap.js";
import { fillIn, mapFaults } from "../words/words.js";
import { MapFault } from "../page/fault.js";

type Vector = readonly [x: number, y: number, z: number];
type Face = readonly [ahead: Vector, right: Vector, down: Vector];
/** Columns and rows of faces or probes, and the column, row and turn by half of +X, -X, +Y, -Y, +Z, -Z. */
type Grid = { readonly columns: number; readonly rows: number; readonly cells: readonly Cell[] };
type Cell = readonly [column: number, row: number, upsideDown: boolean];

const cellsOf = (...places: readonly [number, number][]): Cell[] => places.map(([x, y]) => [x, y, false]);
const strip = [0, 1, 2, 3, 4, 5];
const vertical: Grid = { columns: 1, rows: 6, cells: strip.map((at) => [0, at, false]) };
const probe: Grid = { columns: 1, rows: 1, cells: [] };
const crossCells = cellsOf([2, 1], [0, 1], [1, 0], [1, 2], [1, 1]);
const grids = {
  angular: probe,
  "mirror-ball": probe,
  "cross-horizontal": { columns: 4, rows: 3, cells: [...crossCells, [3, 1, false]] },
  "cross-vertical": { columns: 3, rows: 4, cells: [...crossCells, [1, 3, true]] },
  "strip-horizontal": { columns: 6, rows: 1, cells: strip.map((at) => [at, 0, false]) },
  "strip-vertical": vertical,
  cube: vertical,
} as const satisfies Record<string, Grid>;

type OtherLayout = keyof typeof grids;
/** A way to show the sphere in a picture. */
export type Layout = "latlong" | OtherLayout;

const [x, y, z]: readonly Vector[] = [
  [1, 0, 0],
  [0, 1, 0],
  [0, 0, 1],
];
const minus = ([a, b, c]: Vector): Vector => [-a, -b, -c];
// OpenGL's (x, y, z) is our (z, -x, y), OpenEXR's is our (z, x, y).
const openGl: readonly Face[] = [
  [minus(y!), minus(x!), minus(z!)],
  [y!, x!, minus(z!)],
  [z!, minus(y!), x!],
  [minus(z!), minus(y!), minus(x!)],
  [x!, minus(y!), minus(z!)],
  [minus(x!), y!, minus(z!)],
];
const openExr: readonly Face[] = [
  [y!, x!, minus(z!)],
  [minus(y!), minus(x!), minus(z!)],
  [z!, y!, minus(x!)],
  [minus(z!), y!, x!],
  [x!, minus(y!), minus(z!)],
  [minus(x!), y!, minus(z!)],
];
const subsamples = 3;
/** Share of the mean radiance up to which the unused parts of a picture count as empty. */
const dark = 0.01;

/** Return the layout that pictures of this size have, or null. */
export function layoutOfSize(height: number, width: number): Layout | null {
  if (Math.abs(width - 2 * height) <= Math.max(1, 0.02 * width) || (height === 1 && width === 1)) {
    return "latlong";
  }
  const names = [
    "angular",
    "cross-horizontal",
    "cross-vertical",
    "strip-horizontal",
    "strip-vertical",
  ] as const;
  return names.find((name) => fits(name, height, width)) ?? null;
}

/** Return the given layout, else the stated one, else that of the size; throws MapFault where it cannot be. */
export function decidedLayout(map: EnvironmentMap, stated?: Layout, given?: Layout): Layout {
  const { height, width } = map;
  const layout = given ?? stated ?? layoutOfSize(height, width);
  if (layout === "latlong" || (layout !== null && fits(layout, height, width))) return layout;
  throw new MapFault("environment.shape", fillIn(mapFaults.shape, { width, height }));
}

/**
 * Return the picture with black where the layout has no light. Throws MapFault where such a part is neither dark nor of
 * one colour, because then the picture is something else; not if the layout is `certain`.
 */
export function blankUnused(map: EnvironmentMap, layout: Layout, certain: boolean): EnvironmentMap {
  if (layout === "latlong") return map;
  if (layout === "angular" && !certain && isBlackAtItsRim(map)) throw unclear(layout);
  const unused = unusedBy(layout, map);
  const sums = [0, 0];
  const counts = [0, 0];
  const first = unused.indexOf(1);
  if (first < 0) return map;
  let [plain, insideDiffers] = [true, false];
  const radianceRgb = map.radianceRgb.slice();
  for (let pixel = 0; pixel < unused.length; pixel++) {
    const part = unused[pixel]!;
    for (let at = 3 * pixel; at < 3 * pixel + 3; at++) {
      const value = radianceRgb[at]!;
      const differs = value !== map.radianceRgb[3 * first + (at % 3)]!;
      if (part === 1 ? differs || !Number.isFinite(value) : false) plain = false;
      if (part === 0 && differs) insideDiffers = true;
      sums[part]! += Number.isFinite(value) ? Math.abs(value) : 0;
      counts[part]!++;
      if (part === 1) radianceRgb[at] = 0;
    }
  }
  const isDark = sums[1]! / counts[1]! <= (dark * sums[0]!) / Math.max(counts[0]!, 1);
  if (!certain && !isDark && !(plain && insideDiffers)) {
    throw unclear(layout);
  }
  return { ...map, radianceRgb };
}

/**
 * Return a latitude-longitude map of a picture of finite values in another layout, at most `maxWidth` wide. A pixel is the
 * mean of 3 x 3 interpolated values, evenly spread in its solid angle.
 */
export function toLatLong(map: EnvironmentMap, layout: Layout, maxWidth: number): EnvironmentMap {
  if (layout === "latlong") return map;
  const isProbe = layout === "angular" || layout === "mirror-ball";
  const side = map.width / grids[layout].columns;
  const width = Math.min((isProbe ? 2 : 4) * side, maxWidth);
  const height = width >> 1;
  const look = isProbe ? probeLookup(map, layout === "mirror-ball") : cubeLookup(map, layout);
  const radianceRgb = new Float32Array(3 * height * width);
  const found = new Float64Array(3);
  const around = Float64Array.from(
    { length: subsamples * width },
    (_, at) => Math.PI - (2 * Math.PI * (at + 0.5)) / (subsamples * width),
  );
  const [cosines, sines] = [around.map(Math.cos), around.map(Math.sin)];
  for (let row = 0; row < height; row++) {
    const top = Math.cos((Math.PI * row) / height);
    const bottom = Math.cos((Math.PI * (row + 1)) / height);
    for (let part = 0; part < subsamples; part++) {
      const up = top + ((bottom - top) * (part + 0.5)) / subsamples;
      const level = Math.sqrt(Math.max(1 - up * up, 0));
      for (let at = 0; at < around.length; at++) {
        look(level * cosines[at]!, level * sines[at]!, up, found);
        const target = 3 * (row * width + Math.floor(at / subsamples));
        for (let channel = 0; channel < 3; channel++) {
          radianceRgb[target + channel]! += found[channel]! / subsamples ** 2;
        }
      }
    }
  }
  return { height, width, radianceRgb };
}

function unclear(layout: Layout): MapFault {
  return new MapFault(
    "environment.layout_unclear",
    fillIn(mapFaults.layoutUnclear, { layout: mapFaults.layouts[layout] }),
  );
}

/** Return whether a disc that is lit has no light at all in a ring near its edge, as a ball with a margin. */
function isBlackAtItsRim({ width, radianceRgb }: EnvironmentMap): boolean {
  let [ring, inside, pixels] = [false, false, 0];
  for (let at = 0; at < width * width; at++) {
    const radius = Math.hypot(
      (2 * Math.floor(at / width) + 1) / width - 1,
      (2 * (at % width) + 1) / width - 1,
    );
    if (radius >= 0.98) continue;
    const lit = radianceRgb[3 * at] !== 0 || radianceRgb[3 * at + 1] !== 0 || radianceRgb[3 * at + 2] !== 0;
    if (radius > 0.95) {
      pixels++;
      ring ||= lit;
    } else inside ||= lit;
  }
  return pixels > 0 && inside && !ring;
}

function fits(layout: OtherLayout, height: number, width: number): boolean {
  const { columns, rows } = grids[layout];
  return width * rows === height * columns && width % columns === 0;
}

/** Return 1 for each pixel that shows no direction, else 0. */
function unusedBy(layout: OtherLayout, { height, width }: EnvironmentMap): Uint8Array {
  const unused = new Uint8Array(height * width);
  const { columns, cells } = grids[layout];
  const side = width / columns;
  const filled = new Set(cells.map(([column, row]) => row * columns + column));
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) {
      const outside =
        cells.length === 0
          ? // Edges are soft in pictures: two pixels around the disc may be lit.
            Math.hypot((2 * row + 1) / height - 1, (2 * column + 1) / width - 1) > 1 + 4 / height
          : !filled.has(Math.floor(row / side) * columns + Math.floor(column / side));
      if (outside) unused[row * width + column] = 1;
    }
  }
  return unused;
}

type Lookup = (x: number, y: number, z: number, found: Float64Array) => void;

/** Write the interpolant at a place of the picture that starts at pixel `start`, held at its edges. */
function bilinear(
  { radianceRgb: values, width, height }: EnvironmentMap,
  start: number,
  across: number,
  down: number,
  found: Float64Array,
): void {
  const column = Math.min(Math.max(across, 0), width - 1);
  const row = Math.min(Math.max(down, 0), height - 1);
  const [left, top] = [Math.floor(column), Math.floor(row)];
  const [right, bottom] = [Math.min(left + 1, width - 1), Math.min(top + 1, height - 1)];
  const [shareX, shareY] = [column - left, row - top];
  const [upper, lower] = [start + top * width, start + bottom * width];
  for (let channel = 0; channel < 3; channel++) {
    const above =
      values[3 * (upper + left) + channel]! * (1 - shareX) + values[3 * (upper + right) + channel]! * shareX;
    const below =
      values[3 * (lower + left) + channel]! * (1 - shareX) + values[3 * (lower + right) + channel]! * shareX;
    found[channel] = above * (1 - shareY) + below * shareY;
  }
}

function cubeLookup(map: EnvironmentMap, layout: OtherLayout): Lookup {
  const { columns, cells } = grids[layout];
  const side = map.width / columns;
  const faces = new Float32Array(18 * side * side);
  cells.forEach(([column, row, upsideDown], face) => {
    for (let at = 0; at < side * side; at++) {
      const [down, across] = [Math.floor(at / side), at % side];
      const [fromRow, fromColumn] = upsideDown ? [side - 1 - down, side - 1 - across] : [down, across];
      const source = 3 * ((row * side + fromRow) * map.width + column * side + fromColumn);
      faces.set(map.radianceRgb.subarray(source, source + 3), 3 * (face * side * side + at));
    }
  });
  // The outermost pixels of OpenEXR's faces lie on the edges of the cube.
  if (layout === "cube") return facesLookup(faces, side, openExr, 0.5 * (side - 1));
  // A frame of the neighbours' pixels, so that there are no seams between faces.
  const plain = facesLookup(faces, side, openGl, 0.5 * side);
  const wide = side + 2;
  const framed = new Float32Array(18 * wide * wide);
  const found = new Float64Array(3);
  openGl.forEach(([ahead, right, down], face) => {
    for (let row = 0; row < wide; row++) {
      for (let column = 0; column < wide; column++) {
        const target = 3 * ((face * wide + row) * wide + column);
        if (row > 0 && row <= side && column > 0 && column <= side) {
          const source = 3 * ((face * side + row - 1) * side + column - 1);
          framed.set(faces.subarray(source, source + 3), target);
          continue;
        }
        const [s, t] = [(2 * column - 1) / side - 1, (2 * row - 1) / side - 1];
        const [a, b, c] = [0, 1, 2].map((axis) => ahead[axis]! + s * right[axis]! + t * down[axis]!);
        plain(a!, b!, c!, found);
        framed.set(found, target);
      }
    }
  });
  return facesLookup(framed, wide, openGl, 0.5 * side);
}

function facesLookup(faces: Float32Array, side: number, axes: readonly Face[], scale: number): Lookup {
  const picture = { height: side, width: side, radianceRgb: faces };
  const middle = 0.5 * (side - 1);
  return (x, y, z, found) => {
    let [face, most] = [0, Number.NEGATIVE_INFINITY];
    for (let at = 0; at < 6; at++) {
      const [a, b, c] = axes[at]![0];
      const along = a * x + b * y + c * z;
      if (along > most) [face, most] = [at, along];
    }
    const [, right, down] = axes[face]!;
    const across = (right[0] * x + right[1] * y + right[2] * z) / most;
    const below = (down[0] * x + down[1] * y + down[2] * z) / most;
    bilinear(picture, face * side * side, middle + scale * across, middle + scale * below, found);
  };
}

function probeLookup(map: EnvironmentMap, mirrored: boolean): Lookup {
  const side = map.width;
  const middle = 0.5 * (side - 1);
  // What is behind is the whole rim: pixels that the rim crosses are only partly covered.
  const most = Math.max(1 - 3 / side, 0);
  return (ahead, left, up, found) => {
    const level = Math.hypot(left, up);
    // The normal of a ball is half way between the eye (+x, far away) and the reflected direction.
    const wanted = mirrored ? Math.sqrt(Math.max(0.5 * (1 - ahead), 0)) : Math.atan2(level, ahead) / Math.PI;
    const radius = (0.5 * side * Math.min(wanted, most)) / Math.max(level, 1e-12);
    bilinear(map, 0, middle + radius * (mirrored ? left : -left), middle - radius * up, found);
  };
}
