/** What stands behind the pixels of a picture, as means over their points. */

import type { PixelFeatures } from "./denoise.js";
import type { SurfacePoints, SurfaceSamples } from "./surfacePoints.js";

/** Return albedo, normal and distance of every pixel; zeros where no point is. */
export function pixelFeatures(
  points: SurfacePoints,
  { camera, distance }: Pick<SurfaceSamples, "camera" | "distance">,
): PixelFeatures {
  const numPixels = camera.width * camera.height;
  const features = {
    albedo: new Float32Array(3 * numPixels),
    normal: new Float32Array(3 * numPixels),
    distance: new Float32Array(numPixels),
  };
  const counts = new Float32Array(numPixels);
  for (let point = 0; point < points.count; point++) counts[points.pixel[point]!]!++;
  for (let point = 0; point < points.count; point++) {
    const pixel = points.pixel[point]!;
    const share = 1 / counts[pixel]!;
    for (let axis = 0; axis < 3; axis++) {
      features.albedo[3 * pixel + axis]! += share * points.albedo[3 * point + axis]!;
      features.normal[3 * pixel + axis]! += share * points.normal[3 * point + axis]!;
    }
    features.distance[pixel]! += share * distance[point]!;
  }
  return features;
}
