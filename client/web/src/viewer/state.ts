/** Everything that a viewer shows, as one plain value, and its form in an address. */

import { type PresetName, presetNames } from "../light/presets.js";
import {
  type BackgroundKind,
  backgrounds,
  type Channel,
  channels,
  type LightTurn,
  type Look,
  type Rgb,
  type ToneCurve,
  toneCurves,
} from "../render/looks.js";

export const comparisons = ["off", "environment", "plain", "photo"] as const;
export type Comparison = (typeof comparisons)[number];

/** A camera that turns about a point; angles in degrees, azimuth from +x towards +y. */
export type OrbitPose = {
  readonly azimuthDeg: number;
  readonly elevationDeg: number;
  /** In radii of the object's box. */
  readonly distance: number;
  /** From the middle of the object's box, in its radii. */
  readonly target: Rgb;
};

export type ViewerState = {
  /** The source of the light: "trained:NAME", "preset:NAME", "url:ADDRESS", or "file:NAME" of a dropped file. */
  readonly environment: string;
  readonly turn: LightTurn;
  readonly look: Look;
  readonly pose: OrbitPose;
  /** Whether one may look from where no photograph was taken. */
  readonly free: boolean;
  readonly compare: Comparison;
  /** The light on the right of a comparison of two. */
  readonly environmentB: string;
  /** Position of the divider, 0 to 1. */
  readonly split: number;
  /** The photograph on the right of a comparison with one. */
  readonly photo: string;
  /** Whether the picture is refined while nothing moves. */
  readonly refine: boolean;
};

export const initialState: ViewerState = {
  environment: "preset:softboxes",
  turn: { yawDeg: 0, pitchDeg: 0, rollDeg: 0, intensity: 1 },
  look: {
    channel: "final",
    tone: "neutral",
    exposureEv: 0,
    autoExposure: true,
    background: "blurred",
    backgroundSrgb: [0.93, 0.93, 0.93],
    edit: { albedoGain: [1, 1, 1], roughnessScale: 1, metalnessShift: 0 },
    indirect: true,
    ground: true,
  },
  pose: { azimuthDeg: 30, elevationDeg: 20, distance: 3.2, target: [0, 0, 0] },
  free: false,
  compare: "off",
  environmentB: "preset:studio",
  split: 0.5,
  photo: "",
  refine: false,
};

type Limits = readonly [least: number, most: number];

export const limits = {
  angle: [-180, 180],
  elevation: [-89, 89],
  distance: [0.3, 20],
  intensity: [0, 8],
  exposure: [-8, 8],
  gain: [0.05, 4],
  roughness: [0, 3],
  metalness: [-1, 1],
} as const satisfies Record<string, Limits>;

/** Return a value inside its limits; what is not a number becomes `otherwise`. */
export function within(value: number, [least, most]: Limits, otherwise: number): number {
  return Number.isFinite(value) ? Math.min(Math.max(value, least), most) : otherwise;
}

/** Return an angle from -180 up to 180. */
export function wrapped(degrees: number): number {
  return degrees - 360 * Math.floor((degrees + 180) / 360);
}

function round(value: number): string {
  return String(Number(value.toFixed(3)));
}

/** Return a state as the parameters of an address; what is as at the start is left out. */
export function toParameters(state: ViewerState): URLSearchParams {
  const found = new URLSearchParams();
  const first = flat(initialState);
  for (const [name, value] of Object.entries(flat(state))) {
    // A dropped file is not at any address.
    if (value !== first[name] && !value.startsWith("file:")) found.set(name, value);
  }
  // Without a camera the object is framed, wherever that puts the camera, and the light turned for it.
  if (state.pose !== initialState.pose) found.set("camera", flat(state).camera!);
  if (state.turn !== initialState.turn) found.set("rotate", flat(state).rotate!);
  return found;
}

/** Return a state as texts, by the names of parameters. */
export function flat(state: ViewerState): Record<string, string> {
  const { turn, look, pose } = state;
  return {
    env: state.environment,
    rotate: [turn.yawDeg, turn.pitchDeg, turn.rollDeg].map(round).join(","),
    intensity: round(turn.intensity),
    channel: look.channel,
    tone: look.tone,
    ev: round(look.exposureEv),
    auto: look.autoExposure ? "1" : "0",
    background: look.background,
    colour: look.backgroundSrgb.map(round).join(","),
    gain: look.edit.albedoGain.map(round).join(","),
    roughness: round(look.edit.roughnessScale),
    metalness: round(look.edit.metalnessShift),
    indirect: look.indirect ? "1" : "0",
    ground: look.ground ? "1" : "0",
    camera: [pose.azimuthDeg, pose.elevationDeg, pose.distance, ...pose.target].map(round).join(","),
    free: state.free ? "1" : "0",
    compare: state.compare,
    envB: state.environmentB,
    split: round(state.split),
    photo: state.photo,
    refine: state.refine ? "1" : "0",
  };
}

/**
 * Return the state of an address; what it does not say, or says wrongly, is as in `from`. Where no camera is stated
 * the pose is that of `from`, the same object, and so is the turn of the light where none is.
 */
export function fromParameters(parameters: URLSearchParams, from: ViewerState = initialState): ViewerState {
  const numbers = (name: string, fallback: readonly number[]): readonly number[] => {
    const parts = (parameters.get(name) ?? "")
      .split(",")
      .map((part) => (part === "" ? Number.NaN : Number(part)));
    return parts.length === fallback.length && parts.every(Number.isFinite) ? parts : fallback;
  };
  const one = (name: string, fallback: number, range: Limits): number =>
    within(numbers(name, [fallback])[0]!, range, fallback);
  const choice = <T extends string>(name: string, all: readonly T[], fallback: T): T =>
    all.find((each) => each === parameters.get(name)) ?? fallback;
  const flag = (name: string, fallback: boolean): boolean =>
    choice(name, ["0", "1"], fallback ? "1" : "0") === "1";
  const { look, turn, pose } = from;
  const [yaw, pitch, roll] = numbers("rotate", [turn.yawDeg, turn.pitchDeg, turn.rollDeg]);
  const camera = numbers("camera", [pose.azimuthDeg, pose.elevationDeg, pose.distance, ...pose.target]);
  return {
    environment: parameters.get("env") ?? from.environment,
    turn:
      parameters.has("rotate") || parameters.has("intensity")
        ? {
            yawDeg: wrapped(yaw!),
            pitchDeg: wrapped(pitch!),
            rollDeg: wrapped(roll!),
            intensity: one("intensity", turn.intensity, limits.intensity),
          }
        : turn,
    look: {
      channel: choice("channel", Object.keys(channels) as Channel[], look.channel),
      tone: choice("tone", Object.keys(toneCurves) as ToneCurve[], look.tone),
      exposureEv: one("ev", look.exposureEv, limits.exposure),
      autoExposure: flag("auto", look.autoExposure),
      background: choice("background", Object.keys(backgrounds) as BackgroundKind[], look.background),
      backgroundSrgb: rgb(numbers("colour", look.backgroundSrgb), [0, 1]),
      edit: {
        albedoGain: rgb(numbers("gain", look.edit.albedoGain), limits.gain),
        roughnessScale: one("roughness", look.edit.roughnessScale, limits.roughness),
        metalnessShift: one("metalness", look.edit.metalnessShift, limits.metalness),
      },
      indirect: flag("indirect", look.indirect),
      ground: flag("ground", look.ground),
    },
    pose: parameters.has("camera")
      ? {
          azimuthDeg: wrapped(camera[0]!),
          elevationDeg: within(camera[1]!, limits.elevation, pose.elevationDeg),
          distance: within(camera[2]!, limits.distance, pose.distance),
          target: rgb(camera.slice(3), [-5, 5]),
        }
      : pose,
    free: flag("free", from.free),
    compare: choice("compare", comparisons, from.compare),
    environmentB: parameters.get("envB") ?? from.environmentB,
    split: one("split", from.split, [0, 1]),
    photo: parameters.get("photo") ?? from.photo,
    refine: flag("refine", from.refine),
  };
}

function rgb(values: readonly number[], range: Limits): Rgb {
  const [red, green, blue] = values.map((value) => within(value, range, 1));
  return [red!, green!, blue!];
}

/** Return whether a word names a preset light. */
export function isPreset(name: string): name is PresetName {
  return presetNames.some((each) => each === name);
}
