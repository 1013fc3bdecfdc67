/**
 * The reflection model of `lambent_relight.brdf`: Lambert plus GGX with Schlick's Fresnel and shadowing terms.
 *
 * All vectors are unit and point away from the surface; alpha is the GGX width. Results go into arrays that are given,
 * because this runs for every light direction.
 */

import { brdfFloor, minAlpha } from "../contract/constants.js";
import { ggxDensity, schlickWeight, specularCos } from "../contract/reflectance.js";
import { mirrorOf, type Vector } from "./vectors.js";

/** Return the GGX width of a perceptual roughness. */
export function alphaOf(perceptualRoughness: number): number {
  return Math.max(Math.min(Math.max(perceptualRoughness, 0), 1) ** 2, minAlpha);
}

/** Write x tangent + y bitangent + z normal; (tangent, bitangent, normal) is right-handed. */
function fromFrame(x: number, y: number, z: number, normal: Vector, out: Vector): void {
  const [nx, ny, nz] = [normal[0]!, normal[1]!, normal[2]!];
  // up x normal, with up = z unless the normal is steep, then y.
  let [tx, ty, tz] = [-ny, nx, 0];
  if (Math.abs(nz) >= 0.9) [tx, ty, tz] = [nz, 0, -nx];
  const length = Math.hypot(tx, ty, tz);
  tx /= length;
  ty /= length;
  tz /= length;
  out[0] = x * tx + y * (ny * tz - nz * ty) + z * nx;
  out[1] = x * ty + y * (nz * tx - nx * tz) + z * ny;
  out[2] = x * tz + y * (nx * ty - ny * tx) + z * nz;
}

/** Draw a direction with density cos / pi about `normal`. */
export function cosineSample(u1: number, u2: number, normal: Vector, out: Vector): void {
  const radius = Math.sqrt(u1);
  const angle = 2 * Math.PI * u2;
  fromFrame(radius * Math.cos(angle), radius * Math.sin(angle), Math.sqrt(Math.max(1 - u1, 0)), normal, out);
}

/** Draw `omegaO` mirrored at a half vector of density D(h) cos; it may lie below the surface. */
export function ggxSample(
  u1: number,
  u2: number,
  omegaO: Vector,
  normal: Vector,
  alpha: number,
  out: Vector,
): void {
  const tanSquared = alpha * alpha * (u1 / Math.max(1 - u1, 1e-12));
  const cosine = 1 / Math.sqrt(1 + tanSquared);
  const sine = Math.sqrt(tanSquared) * cosine;
  const angle = 2 * Math.PI * u2 - Math.PI;
  fromFrame(sine * Math.cos(angle), sine * Math.sin(angle), cosine, normal, out);
  mirrorOf(out, omegaO, out);
}

/** The values of a surface's lobes for a pair of directions. */
export class Reflection {
  /** Density of `ggxSample`, 1/sr. */
  ggxPdf = 0;
  /** n.omega_i / pi, zero below the surface: the density of `cosineSample`. */
  cosinePdf = 0;
  /** Specular BRDF times cosine is F0 `specular` + `grazing`, in every channel. */
  specular = 0;
  grazing = 0;

  /** Set everything for a pair of directions. */
  set(omegaO: Vector, omegaI: Vector, normal: Vector, alpha: number): void {
    const [nx, ny, nz] = [normal[0]!, normal[1]!, normal[2]!];
    let [hx, hy, hz] = [omegaO[0]! + omegaI[0]!, omegaO[1]! + omegaI[1]!, omegaO[2]! + omegaI[2]!];
    const length = Math.max(Math.sqrt(hx * hx + hy * hy + hz * hz), 1e-10);
    hx /= length;
    hy /= length;
    hz /= length;
    const nDotH = Math.max(nx * hx + ny * hy + nz * hz, 0);
    const [cx, cy, cz] = [ny * hz - nz * hy, nz * hx - nx * hz, nx * hy - ny * hx];
    const oDotH = Math.min(Math.max(omegaO[0]! * hx + omegaO[1]! * hy + omegaO[2]! * hz, 0), 1);
    const nDotI = Math.max(nx * omegaI[0]! + ny * omegaI[1]! + nz * omegaI[2]!, 0);
    const nDotO = Math.max(nx * omegaO[0]! + ny * omegaO[1]! + nz * omegaO[2]!, 0);
    // cos^2 and sin^2 both: 1 - cos^2 would lose every digit of a narrow lobe.
    const density = ggxDensity(nDotH, cx * cx + cy * cy + cz * cz, alpha);
    this.ggxPdf = (density * nDotH) / (4 * Math.max(oDotH, brdfFloor));
    this.cosinePdf = nDotI / Math.PI;
    const lobe = specularCos(density, nDotO, nDotI, alpha);
    const fresnel = schlickWeight(oDotH);
    this.specular = lobe * (1 - fresnel);
    this.grazing = lobe * fresnel;
  }
}
