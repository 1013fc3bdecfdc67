/**
 * Pictures of pages, compared with golden ones.
 *
 * What is compared are the means of cells of 8 x 8 pixels: other versions of a browser draw the rims of letters and
 * of rounded corners otherwise, which a mean hardly shows, while whatever moves, goes or changes its colour does.
 */

import { copyFileSync, existsSync, mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { join, resolve } from "node:path";
import type { Browser, Page } from "playwright-core";

const folder = resolve(import.meta.dirname, "../golden");
const kept = resolve(import.meta.dirname, "../../build/browser-tests");
const rewrites = process.env.UPDATE_GOLDENS === "1";

/** Pixels of a page along the side of a cell. */
export const cellSide = 8;
/** A channel of a cell may differ by that much, in steps of 1/255; the canvas of the viewer by `most.drawn`. */
export const most = { page: 8, drawn: 12 } as const;
/** Means of red, green and blue of cells, row by row; the last ones of a row or column may be smaller. */
export type Cells = { readonly columns: number; readonly rows: number; readonly rgb: readonly number[] };
/** A part of a page, in its pixels. */
export type Box = { readonly x: number; readonly y: number; readonly width: number; readonly height: number };

/** Return what is wrong with a picture, the worst first; boxes of `drawn` are held to the tolerance of the viewer. */
export function differences(found: Cells, golden: Cells, drawn: readonly Box[] = []): string[] {
  if (found.columns !== golden.columns || found.rows !== golden.rows) {
    const size = ({ columns, rows }: Cells): string => `${columns} x ${rows} cells of ${cellSide} pixels`;
    return [`it has ${size(found)}, the golden one ${size(golden)}`];
  }
  const wrong: { by: number; text: string }[] = [];
  for (let cell = 0; cell < found.columns * found.rows; cell++) {
    const [x, y] = [cellSide * (cell % found.columns), cellSide * Math.floor(cell / found.columns)];
    const isDrawn = drawn.some(
      (box) =>
        x + cellSide > box.x && x < box.x + box.width && y + cellSide > box.y && y < box.y + box.height,
    );
    const by = Math.max(
      ...[0, 1, 2].map((channel) =>
        Math.abs(found.rgb[3 * cell + channel]! - golden.rgb[3 * cell + channel]!),
      ),
    );
    if (by > (isDrawn ? most.drawn : most.page))
      wrong.push({ by, text: `by ${by.toFixed(1)} at ${x}, ${y}` });
  }
  wrong.sort((one, other) => other.by - one.by);
  const texts = wrong.map(({ text }) => text);
  return texts.length <= 5 ? texts : [...texts.slice(0, 5), `and ${texts.length - 5} more cells`];
}

/** Reads and writes pictures, in a page that shows nothing. */
export class GoldenPictures {
  readonly #seen = new Set<string>();

  private constructor(private readonly reader: Page) {}

  static async open(browser: Browser): Promise<GoldenPictures> {
    const reader = await browser.newPage();
    const width = await reader.evaluate(() => {
      const context = new OffscreenCanvas(1, 1).getContext("2d")!;
      context.font = "100px system-ui";
      return context.measureText("Lambent").width;
    });
    // The width in DejaVu Sans, in which the golden pictures are set.
    if (Math.abs(width - 442) > 1) {
      throw new Error(
        `pages are not set in DejaVu Sans (${width}); on Debian: apt-get install fonts-dejavu-core`,
      );
    }
    return new GoldenPictures(reader);
  }

  /** Return the means of cells of a picture; those of a golden one are its pixels. */
  cellsOf(picture: Buffer, type: "png" | "webp", pixels = cellSide): Promise<Cells> {
    return this.reader.evaluate(
      async ([text, format, side]) => {
        const image = new Image();
        image.src = `data:image/${format};base64,${text}`;
        await image.decode();
        const { naturalWidth: width, naturalHeight: height } = image;
        const context = new OffscreenCanvas(width, height).getContext("2d")!;
        context.drawImage(image, 0, 0);
        const { data } = context.getImageData(0, 0, width, height);
        const [columns, rows] = [Math.ceil(width / side), Math.ceil(height / side)];
        const sums = new Float64Array(4 * columns * rows);
        for (let y = 0; y < height; y++) {
          for (let x = 0; x < width; x++) {
            const cell = 4 * (Math.floor(y / side) * columns + Math.floor(x / side));
            for (let channel = 0; channel < 3; channel++) {
              sums[cell + channel]! += data[4 * (y * width + x) + channel]!;
            }
            sums[cell + 3]!++;
          }
        }
        const rgb: number[] = [];
        for (let cell = 0; cell < columns * rows; cell++) {
          for (let channel = 0; channel < 3; channel++) {
            rgb.push(Math.round((10 * sums[4 * cell + channel]!) / sums[4 * cell + 3]!) / 10);
          }
        }
        return { columns, rows, rgb };
      },
      [picture.toString("base64"), type, pixels] as const,
    );
  }

  /** Return what is wrong with what a page shows now; with UPDATE_GOLDENS=1 it becomes the golden picture. */
  async compare(
    name: string,
    page: Page,
    { whole = true, drawn = "lambent-viewer" } = {},
  ): Promise<string[]> {
    if (this.#seen.has(name)) throw new Error(`two pictures are called ${name}`);
    this.#seen.add(name);
    const picture = await taken(page, whole);
    const path = join(folder, `${name}.webp`);
    if (rewrites) {
      mkdirSync(folder, { recursive: true });
      mkdirSync(kept, { recursive: true });
      writeFileSync(path, await this.#written(await this.cellsOf(picture, "png")));
      // To be looked at.
      writeFileSync(join(kept, `${name}.png`), picture);
      return [];
    }
    const boxes = await boxesOf(page, drawn);
    const wrong = await this.against(name, picture, boxes);
    if (wrong.length > 0) {
      mkdirSync(kept, { recursive: true });
      writeFileSync(join(kept, `${name}.found.png`), picture);
      if (existsSync(path)) copyFileSync(path, join(kept, `${name}.golden.webp`));
    }
    return wrong.map((text) => `${name}: ${text}`);
  }

  /** Return how a picture, a PNG file, differs from a golden one. */
  async against(name: string, picture: Buffer, drawn: readonly Box[] = []): Promise<string[]> {
    const path = join(folder, `${name}.webp`);
    if (!existsSync(path)) return ["there is no golden picture; UPDATE_GOLDENS=1 makes it"];
    const golden = await this.cellsOf(readFileSync(path), "webp", 1);
    return differences(await this.cellsOf(picture, "png"), golden, drawn);
  }

  /** Return the names of all pictures that were compared. */
  get seen(): ReadonlySet<string> {
    return this.#seen;
  }

  /** Return a picture without loss, with a pixel for each cell. */
  async #written({ columns, rows, rgb }: Cells): Promise<Buffer> {
    const text = await this.reader.evaluate(
      async ([width, height, values]) => {
        const data = new ImageData(width, height);
        for (let pixel = 0; pixel < width * height; pixel++) {
          for (let channel = 0; channel < 3; channel++) {
            data.data[4 * pixel + channel] = Math.round(values[3 * pixel + channel]!);
          }
          data.data[4 * pixel + 3] = 255;
        }
        const canvas = new OffscreenCanvas(width, height);
        canvas.getContext("2d")!.putImageData(data, 0, 0);
        const blob = await canvas.convertToBlob({ type: "image/webp", quality: 1 });
        return btoa(String.fromCharCode(...new Uint8Array(await blob.arrayBuffer())));
      },
      [columns, rows, rgb] as const,
    );
    return Buffer.from(text, "base64");
  }
}

/** Return a picture of a page as a PNG file, without what moves; `whole` also shows what is below the window. */
export function taken(page: Page, whole: boolean): Promise<Buffer> {
  return page.screenshot({ fullPage: whole, animations: "disabled", caret: "hide", scale: "css" });
}

/** Return where the elements are that a selector finds, on the whole page. */
function boxesOf(page: Page, selector: string): Promise<Box[]> {
  return page.evaluate(
    (wanted) =>
      [...document.querySelectorAll(wanted)].map((each) => {
        const { left, top, width, height } = each.getBoundingClientRect();
        return { x: left + scrollX, y: top + scrollY, width, height };
      }),
    selector,
  );
}
