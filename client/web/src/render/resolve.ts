/** From radiance to a picture: background, exposure, tone curve, encoding. */

import { ShaderChunk, type Texture } from "three";
import { screenProgram, setUniforms } from "./fullScreen.js";
import { cameraUniforms, lightUniforms } from "./shading.js";
import type { GroundPlace } from "./ground.js";
import { backgrounds, type LightTurn, type Look, outputs, toneCurves, type ViewCamera } from "./looks.js";
import type { StageLight } from "./light.js";
import cameraRays from "./shaders/camera.glsl?raw";
import environment from "./shaders/environment.glsl?raw";
import fragment from "./shaders/resolve.frag.glsl?raw";

/** What a picture is made of. */
type Resolved = {
  readonly picture: Texture;
  readonly camera: ViewCamera;
  readonly look: Look;
  readonly light: StageLight;
  readonly turn: LightTurn;
  readonly target: keyof typeof outputs;
  readonly ground: GroundPlace | null;
  readonly dither: boolean;
  /** Where it begins on the canvas. */
  readonly origin: readonly [number, number];
};

/** The last pass. */
export class Resolve {
  readonly material = screenProgram([
    environment,
    cameraRays,
    ShaderChunk.tonemapping_pars_fragment,
    fragment,
  ]);

  /** Set what a picture needs. */
  prepare({ picture, camera, look, light, turn, target, ground, dither, origin }: Resolved): void {
    setUniforms(this.material, {
      ...lightUniforms(light, turn),
      toneMappingExposure: 2 ** look.exposureEv,
      picture,
      ...cameraUniforms(camera),
      background: backgrounds[look.background],
      backgroundSrgb: look.backgroundSrgb,
      tone: toneCurves[look.tone],
      content: contentOf(look),
      target: outputs[target],
      dither,
      origin,
      hasGround: ground !== null,
      ground: ground === null ? null : light.ground.texture,
      groundPlace: ground === null ? [0, 0, 0, 1] : [...ground.centre, ground.height, ground.reach],
    });
  }

  dispose(): void {
    this.material.dispose();
  }
}

/** Return 0 for radiance, 1 for a colour without light, 2 for numbers that are shown as they are. */
function contentOf({ channel }: Look): number {
  if (channel === "final" || channel === "direct" || channel === "indirect") return 0;
  return channel === "albedo" ? 1 : 2;
}
