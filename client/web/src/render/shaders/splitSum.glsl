// (scale, bias) of specular reflectance.
uniform sampler2D splitSumTable;
vec2 splitSum(float cosine, float roughness) {
  vec2 place = vec2(clamp(roughness, 0.0, 1.0), sqrt(clamp(cosine, 0.0, 1.0))) * float(SPLIT_SUM_SIDE - 1);
  ivec2 corner = min(ivec2(place), ivec2(SPLIT_SUM_SIDE - 2));
  vec2 share = place - vec2(corner);
  vec2 upper = mix(texelFetch(splitSumTable, corner, 0).rg,
    texelFetch(splitSumTable, corner + ivec2(1, 0), 0).rg, share.x);
  vec2 lower = mix(texelFetch(splitSumTable, corner + ivec2(0, 1), 0).rg,
    texelFetch(splitSumTable, corner + ivec2(1, 1), 0).rg, share.x);
  return mix(upper, lower, share.y);
}
