import { describe, expect, it } from "vitest";
import type { MapOrigin } from "../src/light/lightWorker.js";
import type { PreparedLight } from "../src/light/prepare.js";
import { EarlyLight, lightFor } from "../src/viewer/earlyLight.js";

const opened = { kind: "opened", name: "box", totalBytes: 1, bands: 7, lights: ["sky"] } as const;
const map = { kind: "map", map: { name: "sky", data: new Uint8Array([1]) } } as const;

/** Return one that hears of a bundle, and what it asked to be prepared. */
function listening(wanted: string, prepare = async () => ({ bands: 7 }) as PreparedLight) {
  const asked: [MapOrigin, number][] = [];
  const early = new EarlyLight({
    wanted: () => wanted,
    originOf: (name) => {
      if (name === "file:gone") throw new Error("gone");
      return { kind: "url", url: name };
    },
    prepare: (...given) => {
      asked.push(given);
      return prepare();
    },
  });
  return { early, asked };
}

describe("the light to show", () => {
  it("is the wanted one, the bundle's first, or a preset", () => {
    expect(lightFor("", ["a", "b"])).toBe("trained:a");
    expect(lightFor("trained:b", ["a", "b"])).toBe("trained:b");
    expect(lightFor("trained:c", ["a", "b"])).toBe("trained:a");
    expect(lightFor("preset:sky", ["a"])).toBe("preset:sky");
    expect(lightFor("", [])).toBe("preset:softboxes");
  });
});

describe("light that is prepared early", () => {
  it("begins with the bundle's own map, and is taken once", async () => {
    const { early, asked } = listening("");
    early.hear(opened);
    expect(asked).toEqual([]);
    early.hear(map);
    expect(asked).toEqual([[{ kind: "bytes", data: map.map.data }, 7]]);
    expect(early.take("trained:sky", 6)).toBeNull();
  });

  it("fits only what was asked for", async () => {
    const { early } = listening("");
    early.hear(opened);
    early.hear(map);
    const light = early.take("trained:sky", 7);
    expect(await light).toEqual({ bands: 7 });
    expect(early.take("trained:sky", 7)).toBeNull();
  });

  it("does not wait for the bundle where it is another one", () => {
    const { early, asked } = listening("preset:sky");
    early.hear(opened);
    expect(asked).toEqual([[{ kind: "url", url: "preset:sky" }, 7]]);
    early.hear(map);
    expect(asked.length).toBe(1);
  });

  it("leaves faults to whoever shows the light", async () => {
    const failing = listening("", () => Promise.reject(new Error("no map")));
    failing.early.hear(opened);
    failing.early.hear(map);
    await expect(failing.early.take("trained:sky", 7)).rejects.toThrow("no map");
    const { early } = listening("file:gone");
    early.hear(opened);
    expect(early.take("file:gone", 7)).toBeNull();
    const odd = listening("preset:sky");
    odd.early.hear({ ...opened, bands: 99 });
    expect(odd.asked).toEqual([]);
  });
});
