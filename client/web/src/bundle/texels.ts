/**
 * The texels around each texel of an atlas: the nearest covered one, as in
 * `lambent_relight.baked.raster.nearest_texel`, and those of half the resolution.
 */

const around = [
  [0, 1],
  [0, -1],
  [1, 0],
  [-1, 0],
  [1, 1],
  [1, -1],
  [-1, 1],
  [-1, -1],
] as const;

/**
 * Return the coarse texels between which indirect light is bilinear at every texel, four each in rows of `width`
 * texels: its own, then those beside it, above or below it, and both. As `BakedScene.blocks_around` in Python.
 */
export function blocksAround(
  texelIndex: Uint32Array,
  texelPlane: Uint32Array,
  coarseOfTexel: Uint32Array,
  size: number,
): Uint32Array<ArrayBuffer> {
  const result = new Uint32Array(4 * coarseOfTexel.length);
  const inside = (at: number): number => Math.min(Math.max(at, 0), size - 1);
  texelIndex.forEach((place, texel) => {
    const [row, column] = [Math.floor(place / size), place % size];
    const beside = inside(column + 2 * (column % 2) - 1);
    const above = inside(row + 2 * (row % 2) - 1);
    const block = (r: number, c: number): number => coarseOfTexel[texelPlane[r * size + c]!]!;
    result.set(
      [block(row, column), block(row, beside), block(above, column), block(above, beside)],
      4 * texel,
    );
  });
  return result;
}

/**
 * Return for each of size x size places the position in `texelIndex` of a covered texel near it.
 *
 * Places are reached in rings of 8 neighbours, and each takes the nearest of the texels that its neighbours know.
 */
export function spreadTexels(texelIndex: Uint32Array, size: number): Uint32Array<ArrayBuffer> {
  const none = 0xffffffff;
  const owner = new Uint32Array(size * size).fill(none);
  const queue = new Uint32Array(size * size);
  queue.set(texelIndex);
  texelIndex.forEach((place, texel) => {
    owner[place] = texel;
  });
  let count = texelIndex.length;
  for (let first = 0; first < count; first++) {
    const place = queue[first]!;
    const row = Math.floor(place / size);
    const column = place - row * size;
    if (first >= texelIndex.length) {
      let best = away(owner[place]!, row, column);
      for (const [down, across] of around) {
        const [r, c] = [row + down, column + across];
        if (r < 0 || r >= size || c < 0 || c >= size) continue;
        const other = owner[r * size + c]!;
        if (other === none) continue;
        const distance = away(other, row, column);
        if (distance < best) {
          best = distance;
          owner[place] = other;
        }
      }
    }
    for (let side = 0; side < 8; side++) {
      const r = row + around[side]![0];
      const c = column + around[side]![1];
      if (r < 0 || r >= size || c < 0 || c >= size) continue;
      const other = r * size + c;
      if (owner[other] === none) {
        owner[other] = owner[place]!;
        queue[count++] = other;
      }
    }
  }
  return owner;

  function away(texel: number, row: number, column: number): number {
    const place = texelIndex[texel]!;
    const [r, c] = [Math.floor(place / size), place % size];
    return (r - row) ** 2 + (c - column) ** 2;
  }
}
