/** Monte Carlo passes over the points of a picture: `lambent_relight.refined.shading`, one pass at a time. */

import type { Hits } from "./hitRadiance.js";
import type { LightSampler } from "./lightSampler.js";
import { Randoms } from "./randoms.js";
import { Scattering } from "./scattering.js";
import type { SkyLight } from "./skyLight.js";
import { drawSeeds, ranksOf, sobolElements } from "./sobol.js";
import type { SurfacePoints } from "./surfacePoints.js";
import type { Traced, Tracer } from "./tracer.js";
import { type Vector, vector } from "./vectors.js";

/** The scene of an estimate. */
export type RefineScene = {
  readonly points: SurfacePoints;
  readonly light: SkyLight;
  readonly sampler: LightSampler;
  /** Radiance of hit points; null leaves out light from other parts of the object. */
  readonly hits: Hits | null;
  /** Secondary rays start this far along the normal, scene units. */
  readonly originOffset: number;
};

/** Means over the directions of one pass, per point. */
export type PassMeans = {
  readonly directRgb: Float32Array<ArrayBuffer>;
  readonly indirectRgb: Float32Array<ArrayBuffer>;
  /** Cosine-weighted share of free directions. */
  readonly visibility: Float32Array<ArrayBuffer>;
};

/** Directions of some points, before they are traced. */
type Drawn = {
  readonly count: number;
  readonly rays: Float32Array<ArrayBuffer>;
  readonly point: Uint32Array;
  /** BRDF times cosine over density, triples; the share of the hemisphere; a number for the hit. */
  readonly weight: Float32Array;
  readonly open: Float32Array;
  readonly chance: Float32Array;
};

/**
 * Make one pass with `perPass` directions per point; null where `stopped` said so in between. Equal seeds and pass
 * numbers give equal results.
 */
export async function onePass(
  scene: RefineScene,
  tracer: Tracer,
  perPass: number,
  seed: number,
  pass: number,
  stopped: () => boolean,
): Promise<PassMeans | null> {
  const { count } = scene.points;
  const means: PassMeans = {
    directRgb: new Float32Array(3 * count),
    indirectRgb: new Float32Array(3 * count),
    visibility: new Float32Array(count),
  };
  const draw = drawing(scene, perPass, seed, pass);
  let before: { drawn: Drawn; traced: Promise<Traced> } | null = null;
  for (let first = 0; first < count || before !== null; ) {
    if (stopped()) {
      await before?.traced.catch(() => null);
      return null;
    }
    const many = Math.max(1, Math.floor(tracer.raysPerCall / perPass));
    // While graphics hardware traces these, the next ones are drawn.
    const drawn = first < count ? draw(first, Math.min(first + many, count)) : null;
    const next = drawn === null ? null : { drawn, traced: tracer.trace(drawn.rays) };
    if (before !== null) add(scene, before.drawn, await before.traced, perPass, means);
    before = next;
    first += many;
  }
  return means;
}

/** Return what draws directions for points [from, to). */
function drawing(scene: RefineScene, perPass: number, seed: number, pass: number) {
  const { points, originOffset } = scene;
  const randoms = new Randoms();
  const u = new Float64Array(3 * perPass);
  const seeds = new Uint32Array(6);
  const ranks = ranksOf(points.pixel);
  const scattering = new Scattering(points, scene.sampler, scene.light.turn);
  return (from: number, to: number): Drawn => {
    const most = (to - from) * perPass;
    const rays = new Float32Array(6 * most);
    const point = new Uint32Array(most);
    const weight = new Float32Array(3 * most);
    const open = new Float32Array(most);
    const chance = new Float32Array(most);
    let count = 0;
    for (let index = from; index < to; index++) {
      // The sequence is its pixel's; what else is drawn is the point's own.
      randoms.begin(seed, 2 * pass, points.pixel[index]!);
      drawSeeds(randoms, seeds);
      sobolElements(seeds, perPass * ranks[index]!, perPass, u);
      randoms.begin(seed, 2 * pass + 1, index);
      scattering.aim(index);
      for (let sample = 0; sample < perPass; sample++) {
        const above = scattering.draw(u[3 * sample]!, u[3 * sample + 1]!, u[3 * sample + 2]!);
        const hit = randoms.next();
        if (!above) continue;
        for (let axis = 0; axis < 3; axis++) {
          const at = 3 * index + axis;
          rays[6 * count + axis] = points.position[at]! + originOffset * points.normal[at]!;
          rays[6 * count + 3 + axis] = scattering.omegaI[axis]!;
          weight[3 * count + axis] = scattering.weight[axis]!;
        }
        point[count] = index;
        open[count] = scattering.openWeight;
        chance[count] = hit;
        count++;
      }
    }
    return { count, rays: rays.slice(0, 6 * count), point, weight, open, chance };
  };
}

const [direction, backwards, arriving]: readonly [Vector, Vector, Vector] = [vector(), vector(), vector()];

function add(scene: RefineScene, drawn: Drawn, traced: Traced, perPass: number, means: PassMeans): void {
  const { rays, point, weight, open, chance } = drawn;
  for (let ray = 0; ray < drawn.count; ray++) {
    const index = point[ray]!;
    const opacity = traced.opacity[ray]!;
    for (let axis = 0; axis < 3; axis++) direction[axis] = rays[6 * ray + 3 + axis]!;
    scene.light.radiance(direction, arriving);
    for (let channel = 0; channel < 3; channel++) {
      means.directRgb[3 * index + channel]! +=
        (weight[3 * ray + channel]! * (1 - opacity) * arriving[channel]!) / perPass;
    }
    means.visibility[index]! += (open[ray]! * (1 - opacity)) / perPass;
    // Following a hit with probability a, at full weight, has the mean of following all at weight a.
    if (scene.hits === null || chance[ray]! >= opacity) continue;
    const distance = traced.distance[ray]!;
    for (let axis = 0; axis < 3; axis++) backwards[axis] = -direction[axis]!;
    const at = (axis: number): number => rays[6 * ray + axis]! + distance * direction[axis]!;
    const texel = traced.texel?.[ray] ?? scene.hits.texelAt(at(0), at(1), at(2));
    scene.hits.radiance(texel, backwards, arriving);
    for (let channel = 0; channel < 3; channel++) {
      means.indirectRgb[3 * index + channel]! += (weight[3 * ray + channel]! * arriving[channel]!) / perPass;
    }
  }
}
