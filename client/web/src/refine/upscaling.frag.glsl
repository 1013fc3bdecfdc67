// A pixel of the shown picture from the refined ones around it, by joint bilateral upsampling (Kopf et al. 2007) with
// the surface of the baked picture as a guide. Radiance is divided by the reflectance there and multiplied by the one
// here, so that textures are as fine as in the baked picture. At full size a pixel is its own, where it has one.
out vec4 result;
uniform sampler2D baked;
uniform usampler2D seen;
uniform usampler2D facing;
uniform sampler2D mask;
uniform bool masked;
uniform int samples;
uniform sampler2D direct;
uniform sampler2D rest;
uniform sampler2D surface;
uniform sampler2D normals;
uniform vec2 corner;
uniform vec2 shownSize;
uniform float height;
uniform int channel;
uniform vec3 albedoGain;
uniform float arrived;
uniform float settled;

float square(float value) { return value * value; }

vec3 shownOf(ivec2 place) {
  vec4 straight = texelFetch(direct, place, 0), again = texelFetch(rest, place, 0);
  if (channel == CHANNEL_DIRECT) return straight.rgb;
  if (channel == CHANNEL_INDIRECT) return again.rgb;
  if (channel == CHANNEL_VISIBILITY) return vec3(again.a);
  return straight.rgb + again.rgb;
}

/** What is refined here, and how much of it to show. */
vec4 refined(ivec2 first, vec2 at) {
  ivec2 size = textureSize(direct, 0);
  vec2 place = at * vec2(size) / shownSize;
  ivec2 middle = clamp(ivec2(place), ivec2(0), size - 1);
  if (vec2(size) == shownSize && texelFetch(direct, middle, 0).a > 0.0) {
    return vec4(shownOf(middle), texelFetch(direct, middle, 0).a);
  }
  float count = 0.0, distance = 0.0;
  vec3 albedo = vec3(0.0), normal = vec3(0.0);
  for (int index = 0; index < samples * samples; index++) {
    ivec2 sampled = first + ivec2(index % samples, index / samples);
    uvec4 found = texelFetch(seen, sampled, 0);
    if (isEmpty(found)) continue;
    count += 1.0;
    distance += distanceOf(found);
    albedo += albedoOf(found);
    normal += unfolded(texelFetch(facing, sampled, 0).r);
  }
  if (count == 0.0) return vec4(0.0);
  albedo = clamp(albedo / count * albedoGain, 0.0, 1.0);
  normal /= count;
  distance = log(distance / count);
  bool lit = channel != CHANNEL_VISIBILITY;
  vec4 sum = vec4(0.0);
  float total = 0.0;
  for (int i = -REACH; i <= REACH; i++) {
    for (int j = -REACH; j <= REACH; j++) {
      ivec2 other = middle + ivec2(j, i);
      if (any(lessThan(other, ivec2(0))) || any(greaterThanEqual(other, size))) continue;
      float share = texelFetch(direct, other, 0).a;
      if (share <= 0.0) continue;
      vec4 behind = texelFetch(surface, other, 0);
      vec2 away = vec2(other) + 0.5 - place;
      vec3 paint = behind.rgb - albedo, slope = texelFetch(normals, other, 0).rgb - normal;
      float depth = log(behind.a) - distance;
      float weight = exp(-dot(away, away) / (2.0 * square(SPREAD))
        - dot(paint, paint) / square(ALBEDO_SCALE) - dot(slope, slope) / square(NORMAL_SCALE)
        - depth * depth / square(DISTANCE_SCALE));
      vec3 reflectance = lit ? (albedo + LEAST_REFLECTANCE) / (behind.rgb + LEAST_REFLECTANCE) : vec3(1.0);
      sum += weight * vec4(reflectance * shownOf(other), share);
      total += weight;
    }
  }
  return total < LEAST_WEIGHT ? vec4(0.0) : sum / total;
}

void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  vec4 before = texelFetch(baked, pixel, 0);
  if (before.a <= 0.0) {
    result = before;
    return;
  }
  ivec2 first = firstSample(seen, pixel * samples, masked, masked ? texelFetch(mask, pixel, 0).r : 1.0);
  vec4 finer = refined(first, corner + vec2(gl_FragCoord.x, height - gl_FragCoord.y));
  float share = finer.a > 0.0 ? arrived * mix(finer.a, 1.0, settled) : 0.0;
  result = vec4(mix(min(before.rgb, 65504.0), before.a * finer.rgb, share), before.a);
}
