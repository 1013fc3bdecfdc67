import { describe, expect, it, vi } from "vitest";
import { followAddress } from "../src/viewer/addressBar.js";
import { missingText, uploadMap } from "../src/viewer/copyLink.js";
import { addressText } from "../src/viewer/lightTexts.js";
import { type Linked, linkOf, missingOf } from "../src/viewer/links.js";
import { initialState } from "../src/viewer/state.js";
import type { Api } from "../src/page/rest.js";
import type { Viewer } from "../src/viewer/viewer.js";

const page = "https://host/viewer.html";

describe("a link", () => {
  const linked = (url: string | null, environment = "preset:sky"): Linked => ({
    state: { ...initialState, environment },
    source: url === null ? { kind: "files", files: new Map() } : { kind: "url", url },
  });
  it("keeps the bundle's address as it was written, and takes the one that is shown now", () => {
    const before = `${page}#src=bowl/&env=preset:even&ev=3`;
    expect(linkOf(linked("https://host/bowl/"), before, true)).toBe(`${page}#env=preset%3Asky&src=bowl%2F`);
    expect(linkOf(linked("https://host/cup/"), before, true)).toContain("src=https%3A%2F%2Fhost%2Fcup%2F");
    expect(linkOf(linked("https://host/bowl/"), `${page}?src=bowl/`, true)).toBe(
      `${page}#env=preset%3Asky&src=bowl%2F`,
    );
  });
  it("to a page of someone else names no bundle, and to that of a share link keeps its secret in front", () => {
    const view = linked("https://host/v1/bundles/b#share_1.ab");
    expect(linkOf(view, "https://shop/cup.html#reviews", false)).toBe(
      "https://shop/cup.html#env=preset%3Asky",
    );
    const shared = "https://host/embed/share_1#share_1.ab";
    expect(linkOf(view, `${shared}&ev=3`, true)).toBe(`${shared}&env=preset%3Asky`);
  });
  it("names no bundle where that is on this computer only", () => {
    expect(linkOf(linked(null), `${page}#src=bowl/`, true)).toBe(`${page}#env=preset%3Asky`);
    expect(missingOf(linked(null))).toEqual({ bundle: true, maps: [] });
  });
  it("cannot carry maps on this computer", () => {
    const view = linked("https://host/bowl/", "file:a.exr");
    expect(missingOf(view)).toEqual({ bundle: false, maps: ["a.exr"] });
    const both: Linked = { ...view, state: { ...view.state, environmentB: "file:b.exr" } };
    expect(missingOf(both).maps).toEqual(["a.exr"]);
    expect(missingOf({ ...both, state: { ...both.state, compare: "environment" } }).maps).toEqual([
      "a.exr",
      "b.exr",
    ]);
  });
});

describe("the page's address", () => {
  it("follows what is shown, at once and then twice a second at most", () => {
    vi.useFakeTimers();
    let yawDeg = 0;
    let change = (): void => {};
    const viewer = {
      bundle: {},
      source: { kind: "url", url: "https://host/bowl/" },
      get state() {
        return { ...initialState, turn: { ...initialState.turn, yawDeg } };
      },
      on: (name: string, listener: () => void) => {
        if (name === "change") change = listener;
        return () => {};
      },
    };
    const written: string[] = [];
    const location = { href: `${page}#src=bowl/`, reload: () => {} };
    const history = {
      replaceState: (_data: unknown, _unused: string, url?: string | URL | null) => {
        location.href = String(url);
        written.push(new URLSearchParams(new URL(location.href).hash.slice(1)).get("rotate") ?? "");
      },
    };
    const stop = new AbortController();
    followAddress(viewer as unknown as Viewer, stop.signal, { location, history });
    for (let step = 1; step <= 40; step++) {
      yawDeg = step;
      change();
      vi.advanceTimersByTime(50);
    }
    vi.advanceTimersByTime(500);
    expect(written.length).toBeGreaterThan(3);
    expect(written.length).toBeLessThanOrEqual(6);
    expect([written[0], written.at(-1)]).toEqual(["1,0,0", "40,0,0"]);
    stop.abort();
    vi.useRealTimers();
  });
});

describe("what a link cannot carry", () => {
  it("is described in a sentence", () => {
    expect(missingText({ bundle: false, maps: [] })).toBe("");
    expect(missingText({ bundle: true, maps: [] })).toBe(
      "It does not include the object, which is on this computer only.",
    );
    expect(missingText({ bundle: true, maps: ["a.exr", "b.exr"] })).toBe(
      "It does not include the object, a.exr, and b.exr, which are on this computer only.",
    );
  });
  it("is uploaded under a name that the server takes, by which the light is called", async () => {
    const sent: [string, string][] = [];
    const api = {
      createEnvironment: async (name: string, body: Blob) => {
        sent.push([name, await body.text()]);
        return { url: "/v1/blobs/0f" } as Awaited<ReturnType<Api["createEnvironment"]>>;
      },
    };
    const light = await uploadMap(api, `a\u0007b/${"c".repeat(200)}.exr`, new Uint8Array([104, 105]));
    expect(sent[0]![0]).toMatch(/^a b\/c{96}$/);
    expect(sent[0]![1]).toBe("hi");
    expect(light).toMatch(/^url:\/v1\/blobs\/0f#a%20b%2Fccc/);
    expect(addressText(light)).toBe(sent[0]![0]);
    expect(addressText("url:https://host/maps/sky%20blue.exr")).toBe("sky blue.exr");
    expect(addressText("url:https://host/maps/%zz.exr")).toBe("%zz.exr");
  });
});
