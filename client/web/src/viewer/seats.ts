/** Who may draw: browsers keep few graphics contexts on a page, and silently take the oldest one for the next. */

/** One element that would like to draw. */
export type Guest = {
  readonly wake: () => void;
  /** Give the context back, and show a still picture from now on. */
  readonly rest: () => void;
  /** Whether it must keep drawing: a user's own file or a film would be lost. */
  readonly isBusy: () => boolean;
};

type Entry = { visible: boolean; usedAt: number; seated: boolean };

/** How many elements of a page draw at a time. Chromium and Safari keep 16 contexts, of all scripts of the page. */
export const mostSeats = 8;

/**
 * Seats of a page. Those who see the page get them: a visible element takes the seat of one that is not, and the one that
 * someone used takes that of the one whose use is longest ago.
 */
export class Seats {
  readonly #guests = new Map<Guest, Entry>();
  #clock = 0;

  constructor(private readonly most = mostSeats) {}

  /** Ask for a seat, for as long as the element is there. */
  join(guest: Guest, visible: boolean): void {
    const entry = { visible, usedAt: 0, seated: false };
    this.#guests.set(guest, entry);
    // A free seat is for everyone; only those who are seen take others'.
    if (!this.#seat(guest, entry)) this.#serve();
  }

  /** The element is gone, and its context with it. */
  leave(guest: Guest): void {
    if (this.#guests.delete(guest)) this.#serve();
  }

  /** The element came into view, or left it. */
  look(guest: Guest, visible: boolean): void {
    const entry = this.#guests.get(guest);
    if (entry === undefined || entry.visible === visible) return;
    entry.visible = visible;
    this.#serve();
  }

  /** Someone uses the element: it has a seat afterwards, unless all others are busy. Returns whether it has. */
  use(guest: Guest): boolean {
    const entry = this.#guests.get(guest);
    if (entry === undefined) return false;
    entry.usedAt = ++this.#clock;
    if (!entry.seated && !this.#seat(guest, entry)) {
      const [other, least] = this.#seated(() => true)[0] ?? [];
      if (other === undefined || least === undefined) return false;
      this.#unseat(other, least);
      this.#seat(guest, entry);
    }
    return entry.seated;
  }

  #serve(): void {
    for (const [guest, entry] of this.#guests) {
      if (entry.seated || !entry.visible || this.#seat(guest, entry)) continue;
      const [other, hidden] = this.#seated(({ visible }) => !visible)[0] ?? [];
      if (other === undefined || hidden === undefined) return;
      this.#unseat(other, hidden);
      this.#seat(guest, entry);
    }
  }

  #seat(guest: Guest, entry: Entry): boolean {
    const taken = [...this.#guests.values()].filter(({ seated }) => seated).length;
    if (taken >= this.most) return false;
    entry.seated = true;
    guest.wake();
    return true;
  }

  #unseat(guest: Guest, entry: Entry): void {
    entry.seated = false;
    guest.rest();
  }

  /** Return those with seats that could give them up, hidden ones first, then by their last use. */
  #seated(which: (entry: Entry) => boolean): [Guest, Entry][] {
    return [...this.#guests]
      .filter(([guest, entry]) => entry.seated && which(entry) && !guest.isBusy())
      .sort(([, a], [, b]) => Number(a.visible) - Number(b.visible) || a.usedAt - b.usedAt);
  }
}

export const seats = new Seats();
