in vec2 place;
in vec3 world;
in vec3 upright;
in vec4 along;
layout(location = 0) out uvec4 result;
/** The normal in two halves, octahedral. */
layout(location = 1) out uvec4 facing;
uniform vec3 cameraPosition;
uniform float floorHeight;
uniform sampler2D albedoMap;
uniform sampler2D packedMap;
uniform sampler2D normalMap;

/**
 * Looks a texture up, trilinear, but in no version whose charts lie too near to each other: `lastLevel` is the number
 * of the last one. A texture with a single version needs no derivatives.
 */
vec4 mapAt(sampler2D map, int lastLevel) {
  if (lastLevel < 1) return textureLod(map, place, 0.0);
  vec2 size = vec2(textureSize(map, 0));
  vec2 across = dFdx(place), down = dFdy(place);
  float widest = sqrt(max(dot(across * size, across * size), dot(down * size, down * size)));
  float shrink = min(exp2(float(lastLevel)) / max(widest, 1e-9), 1.0);
  return textureGrad(map, place, across * shrink, down * shrink);
}

void main() {
  if (world.z < floorHeight) discard;
  vec3 albedo = mapAt(albedoMap, ALBEDO_LEVEL).rgb;
  vec2 material = mapAt(packedMap, PACKED_LEVEL).gb;
  // As BakedScene.normals_at of Python.
  vec3 n = normalize(upright), t = normalize(along.xyz);
  vec3 b = normalize(sign(along.w) * cross(n, t));
  vec3 local = 2.0 * mapAt(normalMap, NORMAL_LEVEL).xyz - 1.0;
  vec3 normal = normalize(local.x * t + local.y * b + local.z * n);
  result = packedSample(place, length(cameraPosition - world), albedo, material);
  facing = uvec4(packSnorm2x16(folded(normal)), 0u, 0u, 0u);
}
