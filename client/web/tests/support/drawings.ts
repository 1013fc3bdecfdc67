/** Pictures that look the same everywhere: PNG files of a lit ball, drawn by arithmetic. */

import { crc32, deflateSync } from "node:zlib";

type Size = { readonly width: number; readonly height: number };

/** Return a PNG file of a pixel for each place; `pixel` gives red, green and blue, 0 to 255. */
export function png({ width, height }: Size, pixel: (x: number, y: number) => readonly number[]): Buffer {
  const rows = Buffer.alloc(height * (1 + 3 * width));
  for (let y = 0; y < height; y++) {
    for (let x = 0; x < width; x++) rows.set(pixel(x, y), y * (1 + 3 * width) + 1 + 3 * x);
  }
  const chunk = (type: string, data: Buffer): Buffer => {
    const body = Buffer.concat([Buffer.from(type, "latin1"), data]);
    const [length, sum] = [Buffer.alloc(4), Buffer.alloc(4)];
    length.writeUInt32BE(data.length);
    sum.writeUInt32BE(crc32(body));
    return Buffer.concat([length, body, sum]);
  };
  const head = Buffer.alloc(13);
  head.writeUInt32BE(width, 0);
  head.writeUInt32BE(height, 4);
  // Eight bits of red, green and blue.
  head.set([8, 2], 8);
  const signature = Buffer.from([0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a]);
  const parts = [chunk("IHDR", head), chunk("IDAT", deflateSync(rows)), chunk("IEND", Buffer.alloc(0))];
  return Buffer.concat([signature, ...parts]);
}

/** The ball of a drawing: its middle and radius in shares of the width and the height. */
const ball = { x: 0.5, y: 0.52, radius: 0.34 };

/** Return how far a place is from the middle of the ball, in its radii. */
function distance(x: number, y: number, { width, height }: Size): number {
  return Math.hypot(x - ball.x * width, y - ball.y * height) / (ball.radius * Math.min(width, height));
}

/** Return a photograph of a ball of a hue, 0 to 1, that is lit from `side`, -1 (left) to 1 (right). */
export function photograph(hue: number, side = -0.6, size: Size = { width: 240, height: 180 }): Buffer {
  const colour = [0, 1 / 3, 2 / 3].map((shift) => 0.55 + 0.4 * Math.cos(2 * Math.PI * (hue - shift)));
  return png(size, (x, y) => {
    const r = distance(x, y, size);
    if (r > 1) {
      const grey = 190 - 60 * (y / size.height);
      return [grey, grey, grey + 6];
    }
    const scale = ball.radius * Math.min(size.width, size.height);
    const nx = (x - ball.x * size.width) / scale;
    const ny = (y - ball.y * size.height) / scale;
    const light = Math.max(0, (side * nx - 0.6 * ny + 0.6 * Math.sqrt(1 - r * r)) / 1.04);
    return colour.map((share) => 255 * Math.min(1, share * (0.12 + 0.95 * light)));
  });
}

/** Return the mask of such a photograph. */
export function mask(size: Size = { width: 240, height: 180 }): Buffer {
  return png(size, (x, y) => new Array<number>(3).fill(distance(x, y, size) < 1 ? 255 : 0));
}
