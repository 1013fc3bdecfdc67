/** The graphics context of a canvas. */

import { WebGLRenderer } from "three";
import { GraphicsFault } from "./fault.js";
import { deviceFaults } from "../words/words.js";

/** Return what draws on a canvas; throws GraphicsFault where there is no WebGL2 or no target for radiance. */
export function rendererOn(canvas: HTMLCanvasElement): WebGLRenderer {
  let renderer: WebGLRenderer;
  try {
    renderer = new WebGLRenderer({ canvas, antialias: false, alpha: true, premultipliedAlpha: true });
  } catch {
    throw new GraphicsFault(`${deviceFaults.noWebgl}; ${deviceFaults.advice}`);
  }
  const context = renderer.getContext();
  if (
    !context.getExtension("EXT_color_buffer_float") &&
    !context.getExtension("EXT_color_buffer_half_float")
  ) {
    renderer.dispose();
    throw new GraphicsFault(`${deviceFaults.noHalfFloats}; ${deviceFaults.advice}`);
  }
  renderer.autoClear = false;
  renderer.debug.checkShaderErrors = true;
  return renderer;
}
