/**
 * Factors per band for smoothing spherical harmonics with the GGX lobe: the same sums as
 * `lambent_relight.baked.transport_lobes`.
 */

import { lobeMinRoughness, numLobeSteps } from "../contract/constants.js";

const numNodes = 512;

/** Return A_l for perceptual roughness 0 to 1 in equal steps, at [step * bands + l]. */
export function ggxBands(bands: number): Float32Array<ArrayBuffer> {
  const { nodes, weights } = gaussLegendre(numNodes);
  const table = new Float32Array(numLobeSteps * bands);
  for (let step = 0; step < numLobeSteps; step++) {
    const alphaSquared = Math.max(step / (numLobeSteps - 1), lobeMinRoughness) ** 4;
    const sums = new Float64Array(bands);
    nodes.forEach((node, index) => {
      // With u uniform, half vectors have density D cos; the light's direction then has density D / 4.
      const u = 0.5 * (node + 1);
      const tanSquared = (alphaSquared * u) / Math.max(1 - u, 1e-9);
      const cosine = (1 - tanSquared) / (1 + tanSquared);
      if (cosine <= 0) return;
      const weight = weights[index]! * cosine;
      let [before, value] = [0, 1];
      for (let l = 0; l < bands; l++) {
        sums[l] = sums[l]! + weight * value;
        [before, value] = [value, ((2 * l + 1) * cosine * value - l * before) / (l + 1)];
      }
    });
    for (let l = 0; l < bands; l++) table[step * bands + l] = sums[l]! / sums[0]!;
  }
  return table;
}

/** Return nodes and weights of Gauss-Legendre quadrature on [-1, 1]. */
export function gaussLegendre(count: number): { nodes: Float64Array; weights: Float64Array } {
  const nodes = new Float64Array(count);
  const weights = new Float64Array(count);
  // Nodes lie symmetrically; half of them are looked for.
  for (let index = 0; index < Math.ceil(count / 2); index++) {
    let x = Math.cos((Math.PI * (index + 0.75)) / (count + 0.5));
    let slope = 1;
    for (let iteration = 0; iteration < 8; iteration++) {
      let [before, value] = [1, x];
      for (let n = 2; n <= count; n++) {
        const next = ((2 * n - 1) * x * value - (n - 1) * before) / n;
        before = value;
        value = next;
      }
      slope = (count * (x * value - before)) / (x * x - 1);
      const step = value / slope;
      x -= step;
      if (Math.abs(step) < 1e-15) break;
    }
    const weight = 2 / ((1 - x * x) * slope * slope);
    nodes[index] = x;
    nodes[count - 1 - index] = -x;
    weights[index] = weight;
    weights[count - 1 - index] = weight;
  }
  return { nodes, weights };
}
