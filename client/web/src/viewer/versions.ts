/** What addresses of earlier versions leave out. Never change an entry: links that people have kept rely on it. */

import type { ViewerState } from "./state.js";

/** The state of which addresses without the parameter `v` say the differences. */
export const version1: ViewerState = {
  environment: "",
  turn: { yawDeg: 0, pitchDeg: 0, rollDeg: 0, intensity: 1 },
  look: {
    channel: "final",
    tone: "neutral",
    exposureEv: 0,
    autoExposure: false,
    background: "blurred",
    backgroundSrgb: [0.93, 0.93, 0.93],
    edit: { albedoGain: [1, 1, 1], roughnessScale: 1, metalnessShift: 0 },
    indirect: true,
    ground: false,
  },
  pose: { azimuthDeg: 30, elevationDeg: 20, distance: 3.2, target: [0, 0, 0] },
  free: false,
  compare: "off",
  environmentB: "preset:studio",
  split: 0.5,
  photo: "",
  refine: false,
};
