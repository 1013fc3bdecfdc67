// Dominant lights in the specular lobe, as `lambent_relight.baked.dominant_highlights`: taken out of prefiltered
// radiance, and reflected one by one, each in its own shadow. A lobe much narrower than a light sees its extent.
uniform int numLights;
uniform vec3 lightDirections[MAX_DOMINANT];
uniform vec3 lightIrradiance[MAX_DOMINANT];
float lobeScale(float square) {
  float base = 0.5 * (1.0 + square), slope = 0.5 * (square - 1.0);
  float integral = abs(slope) < 5e-3 ? 0.5 : (log(square / base) + base / square - 1.0) / (slope * slope);
  return 1.0 / (2.0 * pi * integral);
}
vec3 glints(vec3 n, vec3 o, vec3 mirror, float alpha, vec3 f0, vec4 share, inout vec3 prefiltered) {
  float trust = clamp((alpha - NARROW_ALPHA) / (WIDE_ALPHA - NARROW_ALPHA), 0.0, 1.0);
  vec3 added = vec3(0.0);
  if (trust <= 0.0 || numLights == 0) return added;
  float square = alpha * alpha;
  float scale = lobeScale(square);
  vec3 taken = vec3(0.0);
  for (int light = 0; light < numLights; light++) {
    vec3 l = lightDirections[light];
    float c = dot(mirror, l);
    if (c > 0.0) {
      float spread = 0.5 * (1.0 + c) * square + 0.5 * (1.0 - c);
      taken += scale * c / (spread * spread) * lightIrradiance[light];
    }
    float cosine = dot(n, l);
    float seen = dot(share, vec4(equal(ivec4(light), ivec4(0, 1, 2, 3))));
    if (cosine <= 0.0 || seen <= 0.0) continue;
    vec3 h = o + l;
    h /= max(length(h), 1e-6);
    vec3 sine = cross(n, h);
    float density = ggxDensity(max(dot(n, h), 0.0), dot(sine, sine), alpha);
    float lobe = specularCos(density, max(dot(n, o), 1e-6), cosine, alpha);
    vec3 fresnel = f0 + (1.0 - f0) * schlickWeight(clamp(dot(o, h), 0.0, 1.0));
    added += trust * seen * lobe * fresnel * lightIrradiance[light];
  }
  prefiltered -= trust * min(taken, prefiltered);
  return added;
}
