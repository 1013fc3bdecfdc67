import { describe, expect, it } from "vitest";
import { type Cells, differences, most } from "./support/goldenPictures.js";

/** Two rows of three grey cells, one of them (the last of the first row) of another level. */
const cells = (level: number): Cells => ({
  columns: 3,
  rows: 2,
  rgb: Array.from({ length: 18 }, (_, index) => (index === 7 ? level : 100)),
});
const golden = cells(100);

describe("pictures are compared cell by cell", () => {
  it("and may differ by the tolerance, in every channel", () => {
    expect(differences(cells(100 + most.page), golden)).toEqual([]);
    expect(differences(cells(100 - most.page), golden)).toEqual([]);
    expect(differences(cells(100 + most.page + 0.1), golden)).toEqual(["by 8.1 at 16, 0"]);
    expect(differences(cells(100 - most.page - 0.1), golden)).toEqual(["by 8.1 at 16, 0"]);
  });

  it("with another tolerance where the viewer draws", () => {
    const drawn = [{ x: 20, y: 0, width: 8, height: 4 }];
    const beside = [{ x: 0, y: 0, width: 16, height: 16 }];
    const found = cells(100 + most.drawn);
    expect(differences(found, golden, drawn)).toEqual([]);
    expect(differences(found, golden, beside)).toEqual(["by 12.0 at 16, 0"]);
    expect(differences(cells(100 + most.drawn + 1), golden, drawn)).toEqual(["by 13.0 at 16, 0"]);
  });

  it("and must have one size", () => {
    expect(differences({ ...golden, columns: 2, rows: 3 }, golden)).toEqual([
      "it has 2 x 3 cells of 8 pixels, the golden one 3 x 2 cells of 8 pixels",
    ]);
  });

  it("and the worst differences are named", () => {
    const all: Cells = { columns: 8, rows: 1, rgb: Array.from({ length: 24 }, (_, index) => 3 * index) };
    const none: Cells = { columns: 8, rows: 1, rgb: new Array<number>(24).fill(0) };
    const told = differences(all, none);
    expect(told).toHaveLength(6);
    expect(told[0]).toBe("by 69.0 at 56, 0");
    expect(told.at(-1)).toBe("and 2 more cells");
  });
});
