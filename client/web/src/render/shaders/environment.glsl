// Radiance of an environment: bilinear in a level, linear in perceptual roughness between levels.
uniform sampler2D levels;
uniform ivec4 levelPlaces[NUM_LEVELS];
uniform mat3 toMap;
uniform float lightScale;

vec3 levelAt(int index, vec3 d) {
  ivec4 place = levelPlaces[index];
  float u = 0.5 - atan(d.y, d.x) / (2.0 * pi);
  u -= floor(u);
  float v = atan(length(d.xy), d.z) / pi;
  float column = u * float(place.z) - 0.5;
  float row = clamp(v * float(place.w) - 0.5, 0.0, float(place.w - 1));
  int left = int(floor(column));
  int top = int(row);
  vec2 share = vec2(column - float(left), row - float(top));
  left = (left + place.z) % place.z;
  int right = (left + 1) % place.z;
  int bottom = min(top + 1, place.w - 1);
  vec3 upper = mix(texelFetch(levels, place.xy + ivec2(left, top), 0).rgb,
    texelFetch(levels, place.xy + ivec2(right, top), 0).rgb, share.x);
  vec3 lower = mix(texelFetch(levels, place.xy + ivec2(left, bottom), 0).rgb,
    texelFetch(levels, place.xy + ivec2(right, bottom), 0).rgb, share.x);
  return mix(upper, lower, share.y);
}

vec3 radianceFrom(vec3 direction, float roughness) {
  vec3 d = toMap * direction;
  float place = clamp(roughness, 0.0, 1.0) * float(NUM_LEVELS - 1);
  int index = min(int(place), NUM_LEVELS - 2);
  return lightScale * mix(levelAt(index, d), levelAt(index + 1, d), place - float(index));
}
