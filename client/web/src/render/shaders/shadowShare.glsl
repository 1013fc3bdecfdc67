// The share of a dominant light that reaches a point which faces it; needs the uniforms of glints.glsl.
uniform sampler2D shadowDepths;
uniform vec3 lightRight[MAX_DOMINANT];
uniform vec3 lightUp[MAX_DOMINANT];
uniform float lightTangents[MAX_DOMINANT];
uniform vec3 ballCentre;
uniform float ballRadius;
const float goldenAngle = 2.399963230;
float depthAt(int light, vec2 place) {
  ivec2 at = clamp(ivec2((place + 1.0) * (0.5 * float(SHADOW_MAP_SIDE))), ivec2(0), ivec2(SHADOW_MAP_SIDE - 1));
  return texelFetch(shadowDepths, at + ivec2(light % 2, light / 2) * SHADOW_MAP_SIDE, 0).r;
}
vec2 tap(int index, int count, float turn) {
  float angle = float(index) * goldenAngle + turn;
  return sqrt((float(index) + 0.5) / float(count)) * vec2(cos(angle), sin(angle));
}
/** Interleaved gradient noise, as a turn of the pattern of comparisons. */
float patternTurn(vec2 sampleFromTop) {
  return 2.0 * pi * fract(52.9829189 * fract(0.06711056 * sampleFromTop.x + 0.00583715 * sampleFromTop.y));
}
float shadowShare(int light, vec3 position, vec3 n, float turn) {
  const float texel = 2.0 / float(SHADOW_MAP_SIDE);
  const float least = SHADOW_LEAST_RADIUS * texel;
  vec3 right = lightRight[light], up = lightUp[light], towards = lightDirections[light];
  vec3 from = (position - ballCentre) / ballRadius;
  vec2 place = vec2(dot(from, right), dot(from, up));
  float height = dot(from, towards);
  float cosine = dot(n, towards);
  float steep = max(cosine, SHADOW_LEAST_COSINE);
  vec2 slope = 0.5 / steep * vec2(dot(n, right), dot(n, up));
  float own = 0.5 - 0.5 * height - 0.5 * SHADOW_BIAS * texel * (1.0 + (1.0 - cosine) / steep);
  float reach = max(lightTangents[light] * (1.0 - height), least);
  // Blockers in the cone of the light's disc give the width of the penumbra,
  float count = 0.0, width = 0.0;
  for (int index = 0; index < BLOCKER_TAPS; index++) {
    vec2 away = reach * tap(index, BLOCKER_TAPS, turn);
    float gap = own + dot(slope, away) - depthAt(light, place + away);
    count += gap > 0.0 ? 1.0 : 0.0;
    width += max(gap, 0.0);
  }
  if (count == 0.0) return 1.0;
  if (count == float(BLOCKER_TAPS)) return 0.0;
  float spread = min(max(2.0 * lightTangents[light] * width / count, least), reach);
  // and the lit texels inside of it the share of the light.
  float free = 0.0;
  for (int index = 0; index < FILTER_TAPS; index++) {
    vec2 away = spread * tap(index, FILTER_TAPS, turn);
    free += own + dot(slope, away) <= depthAt(light, place + away) ? 1.0 : 0.0;
  }
  return free / float(FILTER_TAPS);
}
