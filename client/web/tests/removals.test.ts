import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import { Removals, undoMs } from "../src/page/removals.js";
import { Refused } from "../src/page/rest.js";

beforeEach(() => void vi.useFakeTimers());
afterEach(() => void vi.useRealTimers());

function asked(send: (keepalive: boolean) => Promise<unknown> = async () => {}) {
  const told: unknown[] = [];
  const sent: boolean[] = [];
  const gone = vi.fn();
  const removals = new Removals((error) => told.push(error));
  const removal = {
    id: "scene_1",
    what: 'The scene "Cup"',
    gone,
    send: (keepalive: boolean) => {
      sent.push(keepalive);
      return send(keepalive);
    },
  };
  const changes = vi.fn();
  removals.listen(changes);
  removals.ask(removal);
  return { removals, removal, told, sent, gone, changes };
}

describe("a removal", () => {
  it("hides at once and is sent after the time to change one's mind", async () => {
    const { removals, sent, gone } = asked();
    expect(removals.hides("scene_1")).toBe(true);
    expect(removals.waiting.map(({ id }) => id)).toEqual(["scene_1"]);
    await vi.advanceTimersByTimeAsync(undoMs - 1);
    expect(sent).toEqual([]);
    await vi.advanceTimersByTimeAsync(1);
    expect(sent).toEqual([false]);
    expect(gone).toHaveBeenCalledOnce();
    // A list that was asked for before does not show it again.
    expect(removals.hides("scene_1")).toBe(true);
    expect(removals.waiting).toEqual([]);
  });

  it("comes back, and is then never sent", async () => {
    const { removals, sent, changes } = asked();
    changes.mockClear();
    removals.undo("scene_1");
    expect(changes).toHaveBeenCalledOnce();
    expect(removals.hides("scene_1")).toBe(false);
    await vi.advanceTimersByTimeAsync(2 * undoMs);
    removals.flush();
    removals.undo("scene_1");
    expect(sent).toEqual([]);
    expect(changes).toHaveBeenCalledOnce();
  });

  it("is sent when the page is left, once, and so that it outlives the page", async () => {
    const { removals, sent } = asked();
    removals.flush();
    removals.flush();
    await vi.advanceTimersByTimeAsync(2 * undoMs);
    expect(sent).toEqual([true]);
  });

  it("that is asked for twice is one", async () => {
    const { removals, removal, sent } = asked();
    removals.ask(removal);
    await vi.advanceTimersByTimeAsync(2 * undoMs);
    removals.ask(removal);
    await vi.advanceTimersByTimeAsync(2 * undoMs);
    expect(sent).toEqual([false]);
  });

  it("that the server refuses comes back, with the reason", async () => {
    const refused = new Refused(409, "scene_in_use", "job_1 uses this scene", false);
    const { removals, told, gone } = asked(() => Promise.reject(refused));
    await vi.advanceTimersByTimeAsync(undoMs);
    expect(removals.hides("scene_1")).toBe(false);
    expect(gone).not.toHaveBeenCalled();
    expect(String(told[0])).toContain('The scene "Cup" could not be deleted. job_1 uses this scene');
  });

  it("of what another user has deleted is done", async () => {
    const refused = new Refused(404, "scene_not_found", "there is no scene", false);
    const { removals, told, gone } = asked(() => Promise.reject(refused));
    await vi.advanceTimersByTimeAsync(undoMs);
    expect(told).toEqual([]);
    expect(gone).toHaveBeenCalledOnce();
    expect(removals.hides("scene_1")).toBe(true);
  });
});
