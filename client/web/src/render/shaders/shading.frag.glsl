// Radiance of the object towards the camera; shading.ts has the formula.
out vec4 result;
uniform usampler2D seen;
uniform usampler2D facing;
uniform sampler2D mask;
uniform bool masked;
uniform int samples;
uniform sampler2D irradiance;
uniform sampler2D bounced;
uniform vec3 plainIrradiance[9];
uniform int channel;
uniform bool plain;
uniform bool indirect;
uniform vec3 albedoGain;
uniform float roughnessScale;
uniform float metalnessShift;
uniform vec2 depthRange;
#ifdef HAS_GRID
uniform sampler3D uncertainty;
uniform vec3 gridLow;
uniform vec3 gridSize;
#endif

/** What the samples of a group show: sums first, then means. */
struct Surface {
  float count;
  float distance;
  vec3 albedo;
  float roughness;
  float metalness;
  vec3 normal;
  /** Share of the hemisphere that is open to the sky. */
  float openness;
  /** Irradiance straight from the light, and after bounces. */
  vec3 arriving;
  vec3 bounce;
  /** Factor from the irradiance after bounces to the radiance of the surroundings. */
  float surroundings;
  /** Share of each dominant light that arrives. */
  vec4 lightShares;
};

/** Irradiance without shadows, from three bands of harmonics. */
vec3 plainSum(vec3 n) {
  float x = n.x, y = n.y, z = n.z;
  vec3 sum = vec3(0.0);
  ADD_PLAIN
  return max(sum, 0.0);
}

/** Whether samples of a pixel are too unlike the first for one lobe. */
bool differing(ivec2 first) {
  bool found = false;
  vec3 facet = vec3(0.0);
  vec2 own = vec2(0.0);
  for (int index = 0; index < samples * samples; index++) {
    // From the top, as Python's.
    ivec2 at = first + ivec2(index % samples, samples - 1 - index / samples);
    uvec4 sampled = texelFetch(seen, at, 0);
    if (isEmpty(sampled)) continue;
    vec3 normal = unfolded(texelFetch(facing, at, 0).r);
    vec2 material = materialOf(sampled);
    if (!found) {
      facet = normal;
      own = material;
      found = true;
    } else if (dot(normal, facet) < SAME_LOBE_COSINE || any(greaterThan(abs(material - own), vec2(SAME_LOBE_DIFFERENCE)))) return true;
  }
  return false;
}

/** Add what the dominant lights give to one sample, each in its own shadow. */
void addDominant(inout Surface sum, ivec2 at, float distance, vec3 facet) {
  if (numLights == 0) return;
  vec2 place = (vec2(at) + 0.5) / float(samples);
  vec3 position = eye + distance * normalize(cameraTurn * rayOf(place));
  // The pattern of comparisons turns from sample to sample, so that penumbras have noise in place of steps.
  float turn = patternTurn(vec2(at.x, size.y * float(samples) - 1.0 - float(at.y)));
  for (int light = 0; light < numLights; light++) {
    float cosine = dot(facet, lightDirections[light]);
    if (cosine <= 0.0) continue;
    float share = shadowShare(light, position, facet, turn);
    sum.lightShares += share * vec4(equal(ivec4(light), ivec4(0, 1, 2, 3)));
    sum.arriving += share * cosine * lightIrradiance[light];
  }
}

/** Add a sample: its material always, and of the light what the channel shows. */
void addSample(inout Surface sum, inout vec4 open[OPEN_LAYERS], ivec2 at, bool lit) {
  uvec4 found = texelFetch(seen, at, 0);
  if (isEmpty(found)) return;
  vec3 facet = unfolded(texelFetch(facing, at, 0).r);
  vec2 material = materialOf(found);
  sum.count += 1.0;
  sum.distance += distanceOf(found);
  sum.albedo += albedoOf(found);
  sum.roughness += material.x;
  sum.metalness += material.y;
  sum.normal += facet;
  // Light without transport needs none of what follows, and of channels without light only visibility does.
  if (lit ? plain : channel != CHANNEL_VISIBILITY) return;
  vec2 where = placeOf(found);
  vec4 straight = textureLod(irradiance, where, 0.0);
  sum.openness += straight.a;
  if (!lit) return;
  sum.arriving += straight.rgb;
  for (int layer = 0; layer < OPEN_LAYERS; layer++) {
    open[layer] += textureLod(visibility, vec3(where, float(layer)), 0.0);
  }
  addDominant(sum, at, distanceOf(found), facet);
  if (indirect) {
    vec4 again = textureLod(bounced, where, 0.0);
    sum.bounce += again.rgb;
    sum.surroundings += again.a;
  }
}

/** Turn sums into means, and edit the material. */
void takeMeans(inout Surface sum, inout vec4 open[OPEN_LAYERS], vec3 toViewer) {
  float share = 1.0 / sum.count;
  sum.albedo = clamp(sum.albedo * share * albedoGain, 0.0, 1.0);
  sum.roughness = clamp(sum.roughness * share * roughnessScale, 0.0, 1.0);
  sum.metalness = clamp(sum.metalness * share + metalnessShift, 0.0, 1.0);
  sum.openness *= share;
  sum.distance *= share;
  sum.arriving = max(sum.arriving * share, 0.0);
  // Light that has bounced once more off the same colour: the edit of albedo is in it, too.
  sum.bounce = max(sum.bounce * share * albedoGain, 0.0);
  sum.surroundings *= share;
  sum.lightShares *= share;
  for (int layer = 0; layer < OPEN_LAYERS; layer++) {
    open[layer] = visibilityOffsets[layer] + visibilityScales[layer] * open[layer] * share;
  }
  sum.normal = normalize(sum.normal * share);
  // A mean normal may face away at a silhouette, where the true one cannot.
  sum.normal = normalize(sum.normal - min(dot(sum.normal, toViewer) - 1e-3, 0.0) * toViewer);
}

/** Return the radiance of a surface. */
vec3 radianceOf(Surface s, vec4 open[OPEN_LAYERS], vec3 toViewer) {
  float cosine = dot(s.normal, toViewer);
  vec3 mirror = 2.0 * cosine * s.normal - toViewer;
  vec2 table = splitSum(cosine, s.roughness);
  vec3 f0 = vec3(
    baseReflectance(s.albedo.r, s.metalness),
    baseReflectance(s.albedo.g, s.metalness),
    baseReflectance(s.albedo.b, s.metalness)
  );
  vec3 reflectance = f0 * table.x + table.y;
  vec3 diffuse = (1.0 - s.metalness) * s.albedo / pi;
  vec3 prefiltered = radianceFrom(mirror, s.roughness);
  if (plain) {
    if (channel == CHANNEL_INDIRECT) return vec3(0.0);
    return diffuse * plainSum(s.normal) + reflectance * prefiltered;
  }
  // The lobe sees the sky where it is free of the object, and what surrounds the point in the rest.
  float free = freeShare(open, mirror, s.roughness);
  float alpha = max(s.roughness * s.roughness, MIN_ALPHA);
  vec3 single = glints(s.normal, toViewer, mirror, alpha, f0, s.lightShares, prefiltered);
  vec3 straight = diffuse * s.arriving + reflectance * free * prefiltered + single;
  vec3 again = diffuse * s.bounce + reflectance * (1.0 - free) * s.surroundings * s.bounce;
  return channel == CHANNEL_DIRECT ? straight : channel == CHANNEL_INDIRECT ? again : straight + again;
}

/** Return a channel without light. */
vec3 numberOf(Surface s, vec3 toViewer) {
  if (channel == CHANNEL_VISIBILITY) return vec3(s.openness);
  if (channel == CHANNEL_ALBEDO) return s.albedo;
  if (channel == CHANNEL_ROUGHNESS) return vec3(s.roughness);
  if (channel == CHANNEL_METALNESS) return vec3(s.metalness);
  if (channel == CHANNEL_NORMAL) return 0.5 + 0.5 * s.normal;
  if (channel == CHANNEL_DEPTH) {
    return vec3(1.0 - clamp((s.distance - depthRange.x) / (depthRange.y - depthRange.x), 0.0, 1.0));
  }
#ifdef HAS_GRID
  vec3 world = eye - s.distance * toViewer;
  return vec3(min(texture(uncertainty, (world - gridLow) / gridSize).r, 1.0));
#else
  return vec3(0.0);
#endif
}

void main() {
  vec2 pixel = gl_FragCoord.xy;
  ivec2 first = ivec2(pixel) * samples;
  float covered = masked ? texelFetch(mask, first, 0).r : 1.0;
  first = firstSample(seen, first, masked, covered);
  bool lit = channel <= CHANNEL_INDIRECT;
  vec3 toViewer = -normalize(cameraTurn * rayOf(pixel));

  // All samples of a pixel are shaded as one surface; those that differ too much for one lobe each for itself.
  int all = samples * samples;
  int each = lit && differing(first) ? 1 : all;
  float total = 0.0;
  vec3 sum = vec3(0.0);
  for (int from = 0; from < all; from += each) {
    Surface group = Surface(
      0.0, 0.0, vec3(0.0), 0.0, 0.0, vec3(0.0), 0.0, vec3(0.0), vec3(0.0), 0.0, vec4(0.0));
    vec4 open[OPEN_LAYERS];
    for (int layer = 0; layer < OPEN_LAYERS; layer++) open[layer] = vec4(0.0);
    for (int index = from; index < from + each; index++) {
      addSample(group, open, first + ivec2(index % samples, index / samples), lit);
    }
    if (group.count == 0.0 || covered == 0.0) continue;
    float count = group.count;
    takeMeans(group, open, toViewer);
    sum += count * (lit ? radianceOf(group, open, toViewer) : numberOf(group, toViewer));
    total += count;
  }

  // Radiance is multiplied by coverage: the share of the samples, or what a finer mask has counted.
  float coverage = masked ? covered : total / float(all);
  result = total == 0.0 ? vec4(0.0) : vec4(sum * (coverage / total), coverage);
}
