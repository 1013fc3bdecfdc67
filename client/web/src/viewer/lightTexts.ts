/** Display names of lights. */

import { presetNames } from "../light/presets.js";
import type { Viewer } from "./viewer.js";

/** Return all lights that can be chosen now, by their name in the state, and what people read. */
export function lightTexts(viewer: Viewer): [string, string][] {
  const { environment, environmentB } = viewer.state;
  const addresses = new Set([environment, environmentB].filter((name) => name.startsWith("url:")));
  return [
    ...(viewer.bundle?.trainedMaps ?? []).map(({ name }): [string, string] => [
      `trained:${name}`,
      `As photographed (${name})`,
    ]),
    ...Object.entries(presetNames).map(([name, text]): [string, string] => [`preset:${name}`, text]),
    ...viewer.mapNames.map((name): [string, string] => [`file:${name}`, name]),
    ...[...addresses].map((name): [string, string] => [name, name.split("/").at(-1) ?? name]),
  ];
}

/** Return the display name of a light of the state. */
export function lightText(viewer: Viewer, light: string): string {
  return lightTexts(viewer).find(([name]) => name === light)?.[1] ?? light;
}
