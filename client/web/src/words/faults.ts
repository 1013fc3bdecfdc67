/** What can be wrong with bundles, maps and devices; workers say it, too. A program contains only those that it says. */

import { bundleFaults as bundles, deviceFaults as devices, mapFaults as maps } from "./en.json";
import { spoken } from "./languages.js";

export const bundleFaults = /* @__PURE__ */ spoken("bundleFaults", bundles);
export const mapFaults = /* @__PURE__ */ spoken("mapFaults", maps);
export const deviceFaults = /* @__PURE__ */ spoken("deviceFaults", devices);
