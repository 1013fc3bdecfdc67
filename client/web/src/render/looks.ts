import type { PhotoCamera } from "../bundle/cameras.js";

/** Numbers of the channels, as the shaders know them. */
export const channels = {
  final: 0,
  direct: 1,
  indirect: 2,
  visibility: 3,
  albedo: 4,
  roughness: 5,
  metalness: 6,
  normal: 7,
  depth: 8,
  uncertainty: 9,
} as const;
export type Channel = keyof typeof channels;

export const toneCurves = { linear: 0, neutral: 1, agx: 2, aces: 3 } as const;
export type ToneCurve = keyof typeof toneCurves;

export const backgrounds = { transparent: 0, colour: 1, environment: 2, blurred: 3 } as const;
export type BackgroundKind = keyof typeof backgrounds;

/** What the last pass writes. */
export const outputs = {
  /** sRGB-encoded, multiplied by alpha: for the canvas. */
  canvas: 0,
  /** sRGB-encoded, straight alpha: for PNG. */
  straight: 1,
  /** Linear radiance with exposure, multiplied by alpha: for EXR. */
  linear: 2,
} as const;

export type Rgb = readonly [number, number, number];

/** Changes to the bundle's material, as in `lambent_relight.edits`. */
export type MaterialEdit = {
  /** Factor on albedo; the product is clipped to [0, 1]. */
  readonly albedoGain: Rgb;
  /** Factor on perceptual roughness; the product is clipped to [0, 1]. */
  readonly roughnessScale: number;
  /** Added to metalness; the sum is clipped to [0, 1]. */
  readonly metalnessShift: number;
};

export type Look = {
  readonly channel: Channel;
  readonly tone: ToneCurve;
  /** Added to that of the light where `autoExposure` is on. */
  readonly exposureEv: number;
  /** Whether the light decides the exposure; see `exposureFor`. */
  readonly autoExposure: boolean;
  readonly background: BackgroundKind;
  /** sRGB-encoded, 0 to 1. */
  readonly backgroundSrgb: Rgb;
  readonly edit: MaterialEdit;
  /** Whether indirect light is added. */
  readonly indirect: boolean;
  /** Whether level ground under the object shows its shadow. */
  readonly ground: boolean;
};

/** Rotation and brightness of the environment. */
export type LightTurn = {
  /** About +z; the same as `--rotate-deg`. */
  readonly yawDeg: number;
  /** About +y, before the turn about +z. */
  readonly pitchDeg: number;
  /** About +x, before both. */
  readonly rollDeg: number;
  readonly intensity: number;
};

/** "baked": with transport; "plain": image-based lighting without shadows and bounces. */
export type Method = "baked" | "plain";

/** A picture's size and lens in pixels, rows from the top, and a pose: x right, y up, looking along -z. */
export type ViewCamera = Omit<PhotoCamera, "name">;

/** Return a text that is another one where light falls differently. */
export function turnKey({ yawDeg, pitchDeg, rollDeg, intensity }: LightTurn): string {
  return `${yawDeg} ${pitchDeg} ${rollDeg} ${intensity}`;
}
