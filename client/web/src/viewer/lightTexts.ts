/** Display names of lights. */

import type { Viewer } from "./viewer.js";
import { fillIn, texts } from "../words/words.js";

/** Return all lights that can be chosen now, by their name in the state, and what people read. */
export function lightTexts(viewer: Viewer): [string, string][] {
  const { environment, environmentB } = viewer.state;
  const named = [environment, environmentB].filter((name) => name.startsWith("url:"));
  const addresses = new Set([...viewer.lights.addresses, ...named]);
  const trained = viewer.bundle?.trainedMaps ?? [];
  return [
    ...trained.map(({ name }): [string, string] => [
      `trained:${name}`,
      trained.length === 1 ? texts.light.asPhotographed : fillIn(texts.light.asPhotographedOf, { name }),
    ]),
    ...Object.entries(texts.light.presets).map(([name, text]): [string, string] => [`preset:${name}`, text]),
    ...viewer.lights.mapNames.map((name): [string, string] => [`file:${name}`, name]),
    ...[...addresses].map((name): [string, string] => [name, addressText(name)]),
  ];
}

/** Return the display name of a light of the state. */
export function lightText(viewer: Viewer, light: string): string {
  return lightTexts(viewer).find(([name]) => name === light)?.[1] ?? light;
}

/** Return the name of a light at an address: what the address calls it after "#", or the file's. */
export function addressText(light: string): string {
  const [path = "", given = ""] = light.slice(light.indexOf(":") + 1).split("#");
  const name = given || path.split("/").at(-1) || path;
  try {
    return decodeURIComponent(name);
  } catch {
    return name;
  }
}
