// Samples of the surface as surface.frag.glsl packs them.

/** Unit vectors to octahedral coordinates, and back from their halves. */
vec2 folded(vec3 n) {
  vec2 at = n.xy / (abs(n.x) + abs(n.y) + abs(n.z));
  vec2 away = vec2(at.x >= 0.0 ? 1.0 : -1.0, at.y >= 0.0 ? 1.0 : -1.0);
  return n.z >= 0.0 ? at : (1.0 - abs(at.yx)) * away;
}
vec3 unfolded(uint halves) {
  vec2 at = unpackSnorm2x16(halves);
  float height = 1.0 - abs(at.x) - abs(at.y);
  vec2 away = vec2(at.x >= 0.0 ? 1.0 : -1.0, at.y >= 0.0 ? 1.0 : -1.0);
  return normalize(vec3(height >= 0.0 ? at : (1.0 - abs(at.yx)) * away, height));
}

/**
 * A sample: its place in the atlas in two halves of 16 bits; the bits of the distance, zero where nothing is; 16 bits
 * for each channel of linear albedo, 8 for roughness, 8 for metalness.
 */
uvec4 packedSample(vec2 place, float distance, vec3 albedo, vec2 material) {
  uvec2 bytes = uvec2(round(clamp(material, 0.0, 1.0) * 255.0));
  uint last = (packUnorm2x16(vec2(albedo.b, 0.0)) & 0xffffu) | bytes.x << 16 | bytes.y << 24;
  return uvec4(packUnorm2x16(place), floatBitsToUint(distance), packUnorm2x16(albedo.rg), last);
}
bool isEmpty(uvec4 found) { return found.g == 0u; }
vec2 placeOf(uvec4 found) { return unpackUnorm2x16(found.r); }
float distanceOf(uvec4 found) { return uintBitsToFloat(found.g); }
vec3 albedoOf(uvec4 found) { return vec3(unpackUnorm2x16(found.b), unpackUnorm2x16(found.a).x); }
/** Perceptual roughness and metalness. */
vec2 materialOf(uvec4 found) { return vec2((found.a >> 16) & 0xffu, found.a >> 24) / 255.0; }

/**
 * The first sample of a pixel: where a border covers a part of it but not its middle, and there is one sample to a
 * pixel, a sample of the surface beside it.
 */
ivec2 firstSample(usampler2D seen, ivec2 first, bool masked, float covered) {
  if (!masked || covered <= 0.0 || !isEmpty(texelFetch(seen, first, 0))) return first;
  ivec2 last = textureSize(seen, 0) - 1;
  for (int side = 0; side < 8; side++) {
    int around = side < 4 ? side : side + 1;
    ivec2 beside = clamp(first + ivec2(around % 3, around / 3) - 1, ivec2(0), last);
    if (!isEmpty(texelFetch(seen, beside, 0))) return beside;
  }
  return first;
}
