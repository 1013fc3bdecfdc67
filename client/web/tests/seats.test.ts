import { describe, expect, it } from "vitest";
import { type Guest, Seats } from "../src/viewer/seats.js";

/** Guests that note who draws. */
function guests(seats: Seats, visible: readonly boolean[]) {
  const drawing = new Set<number>();
  const busy = new Set<number>();
  const all = visible.map(
    (_, index): Guest => ({
      wake: () => drawing.add(index),
      rest: () => drawing.delete(index),
      isBusy: () => busy.has(index),
    }),
  );
  all.forEach((guest, index) => {
    seats.join(guest, visible[index]!);
  });
  return { all, busy, drawing: () => [...drawing].sort((a, b) => a - b) };
}

describe("seats", () => {
  it("are never more than there are", () => {
    const seats = new Seats(3);
    const { all, drawing } = guests(seats, [true, true, true, true, true]);
    expect(drawing()).toEqual([0, 1, 2]);
    for (const guest of all) seats.look(guest, false);
    for (const guest of all) seats.look(guest, true);
    for (const guest of all) seats.use(guest);
    expect(drawing()).toHaveLength(3);
  });

  it("are for anyone while there are some, and then for those who are seen", () => {
    const seats = new Seats(2);
    const { all, drawing } = guests(seats, [false, false, true, true]);
    expect(drawing()).toEqual([2, 3]);
    seats.look(all[3]!, false);
    // Nobody who is seen needs it.
    expect(drawing()).toEqual([2, 3]);
    seats.look(all[0]!, true);
    expect(drawing()).toEqual([0, 2]);
  });

  it("go to whoever is used, from the one whose use is longest ago", () => {
    const seats = new Seats(2);
    const { all, drawing } = guests(seats, [true, true, true]);
    expect([seats.use(all[0]!), seats.use(all[1]!)]).toEqual([true, true]);
    expect(seats.use(all[2]!)).toBe(true);
    expect(drawing()).toEqual([1, 2]);
    expect(seats.use(all[0]!)).toBe(true);
    expect(drawing()).toEqual([0, 2]);
  });

  it("are not taken from those who are busy", () => {
    const seats = new Seats(1);
    const { all, busy, drawing } = guests(seats, [true, true]);
    busy.add(0);
    seats.look(all[0]!, false);
    expect(seats.use(all[1]!)).toBe(false);
    expect(drawing()).toEqual([0]);
    busy.clear();
    expect(seats.use(all[1]!)).toBe(true);
    expect(drawing()).toEqual([1]);
  });

  it("of those who leave go to those who wait", () => {
    const seats = new Seats(1);
    const { all, drawing } = guests(seats, [true, false, true]);
    seats.leave(all[0]!);
    expect(drawing()).toEqual([0, 2]);
    expect(seats.use(all[0]!)).toBe(false);
  });
});
