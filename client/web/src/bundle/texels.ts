/**
 * The nearest covered texel of each texel of an atlas, as in `lambent_relight.baked.raster.nearest_texel`.
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
