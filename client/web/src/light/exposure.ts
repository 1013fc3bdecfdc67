/** The exposure that suits a light. */

import { basis, cosineFactors } from "../engine/harmonics.js";
import type { Direction } from "../engine/environment.js";
import type { PreparedLight } from "./prepare.js";

/** What a diffuse surface of half the light's reflectance becomes where it faces the light, as linear display value. */
const target = 0.42;
const albedo = 0.5;
const luminance = [0.2126, 0.7152, 0.0722] as const;
/** Lights are made brighter or darker by at most so much. */
const mostEv = 10;

/**
 * Return the exposure, in EV, at which a grey surface that faces `main` is well exposed in a light of intensity 1; 0 for
 * no light. It depends on the light only, so that it does not change while the camera moves.
 *
 * Irradiance is that of three bands of harmonics.
 */
export function exposureFor({ plainRgb }: Pick<PreparedLight, "plainRgb">, main: Direction | null): number {
  const factors = cosineFactors(3);
  const shares = main === null ? null : basis(main, 3);
  let irradiance = 0;
  for (let index = 0; index < (shares === null ? 1 : 9); index++) {
    const share = shares === null ? Math.sqrt(0.25 / Math.PI) : shares[index]!;
    for (const [channel, weight] of luminance.entries()) {
      irradiance += weight * share * factors[index]! * plainRgb[3 * index + channel]!;
    }
  }
  if (!(irradiance > 0)) return 0;
  const ev = Math.log2((target * Math.PI) / (albedo * irradiance));
  return Math.min(Math.max(ev, -mostEv), mostEv);
}
