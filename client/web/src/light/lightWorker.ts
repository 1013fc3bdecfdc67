/** Decodes and prepares environment maps in a worker. */

import { buffersOf } from "../page/buffers.js";
import { splitSumTable } from "../engine/splitSum.js";
import { MapFault, toldOf } from "../page/fault.js";
import type { EnvironmentMap } from "../engine/environmentMap.js";
import { openEnvironment } from "./open.js";
import { type NotedMap, type PreparedLight, prepareLight, usableMap } from "./prepare.js";
import { type PresetName, presetMap } from "./presets.js";
import { ballPicture, smallMap } from "./thumbnail.js";
import { fillIn, mapFaults } from "../words/words.js";
import { workerSpeaks } from "../words/languages.js";

/** The source of a map; the format is detected from the first bytes. */
export type MapOrigin =
  | { readonly kind: "preset"; readonly name: PresetName }
  | { readonly kind: "bytes"; readonly data: Uint8Array<ArrayBuffer> }
  | { readonly kind: "url"; readonly url: string };

export type LightQuestion =
  | {
      readonly id: number;
      readonly ask: "light";
      readonly origin: MapOrigin;
      readonly bands: number;
      readonly dominant: number;
    }
  | { readonly id: number; readonly ask: "thumbnail"; readonly origin: MapOrigin; readonly side: number }
  | { readonly id: number; readonly ask: "splitSum" };

export type LightAnswer =
  | { readonly id: number; readonly kind: "light"; readonly light: PreparedLight }
  | { readonly id: number; readonly kind: "thumbnail"; readonly pixels: Uint8ClampedArray<ArrayBuffer> }
  | { readonly id: number; readonly kind: "splitSum"; readonly table: Float32Array<ArrayBuffer> }
  | { readonly id: number; readonly kind: "failed"; readonly code: string; readonly message: string };

const maxPixels = 1 << 27;
const speaks = workerSpeaks();

self.onmessage = async ({ data: question }: MessageEvent<LightQuestion>) => {
  const { id } = question;
  const answer = (message: LightAnswer, transfer: Transferable[]): void => {
    self.postMessage(message, { transfer });
  };
  await speaks;
  try {
    if (question.ask === "splitSum") {
      const table = new Float32Array(splitSumTable());
      answer({ id, kind: "splitSum", table }, [table.buffer]);
      return;
    }
    if (question.ask === "thumbnail") {
      const pixels = ballPicture(await openSmallMap(question.origin), question.side);
      answer({ id, kind: "thumbnail", pixels }, [pixels.buffer]);
      return;
    }
    const light = prepareLight(await openMap(question.origin), question.bands, question.dominant);
    answer({ id, kind: "light", light }, buffersOf(light));
  } catch (error) {
    answer({ id, kind: "failed", ...toldOf(error, "environment", mapFaults.memory) }, []);
  }
};

async function openMap(origin: MapOrigin): Promise<NotedMap> {
  if (origin.kind === "preset") return presetMap(origin.name);
  if (origin.kind === "bytes") return openEnvironment(origin.data, maxPixels);
  const map = await openEnvironment(await fetched(origin.url), maxPixels);
  // Its small picture need not be fetched again.
  small.set(origin.url, smallMap(usableMap(map).map));
  for (const url of [...small.keys()].slice(0, -mostSmall)) small.delete(url);
  return map;
}

/** Small versions of the maps of the addresses that were read last. */
const small = new Map<string, EnvironmentMap>();
const mostSmall = 8;

async function openSmallMap(origin: MapOrigin): Promise<EnvironmentMap> {
  const known = origin.kind === "url" ? small.get(origin.url) : undefined;
  return known ?? smallMap(usableMap(await openMap(origin)).map);
}

/** Addresses that the page's content security policy has kept from being read. */
const forbidden = new Set<string>();
self.addEventListener("securitypolicyviolation", (event) => {
  if (event.effectiveDirective === "connect-src") forbidden.add(event.blockedURI);
});

/** Return whether it was the policy that kept an address from being read; browsers tell a moment after. */
async function isForbidden(url: string): Promise<boolean> {
  const address = new URL(url);
  address.hash = "";
  for (let tries = 0; tries < 10; tries++) {
    if (forbidden.delete(address.href)) return true;
    await new Promise((resolve) => setTimeout(resolve, 20));
  }
  return false;
}

async function fetched(url: string): Promise<Uint8Array<ArrayBuffer>> {
  let response: Response;
  try {
    response = await fetch(url);
  } catch {
    const { host } = new URL(url);
    if (await isForbidden(url)) {
      throw new MapFault("environment.blocked", fillIn(mapFaults.blocked, { host }));
    }
    throw new MapFault("environment.missing", fillIn(mapFaults.unreadable, { address: url }));
  }
  if (!response.ok) {
    throw new MapFault(
      "environment.missing",
      fillIn(mapFaults.notFound, { address: url, status: response.status }),
    );
  }
  return new Uint8Array(await response.arrayBuffer());
}
