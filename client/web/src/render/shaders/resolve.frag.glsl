const float maxBlur = 0.6;
out vec4 result;
uniform sampler2D picture;
uniform int background;
uniform vec3 backgroundSrgb;
uniform int tone;
uniform int content;
uniform int target;
uniform bool hasGround;
uniform sampler2D ground;
uniform vec4 groundPlace;
uniform bool dither;
uniform vec2 origin;

/** Two even numbers, 0 to 1, of a pixel and a channel. Source: Jarzynski and Olano 2020 (pcg2d). */
vec2 even(uvec2 v) {
  v = v * 1664525u + 1013904223u;
  v.x += v.y * 1664525u;
  v.y += v.x * 1664525u;
  v ^= v >> 16u;
  v.x += v.y * 1664525u;
  v.y += v.x * 1664525u;
  v ^= v >> 16u;
  return vec2(v) / 4294967295.0;
}
/** Triangular noise of one code value to either side: rounding then leaves neither bands nor a bias. */
vec3 noise() {
  uvec2 at = uvec2(gl_FragCoord.xy) * uvec2(3u, 1u);
  vec2 r = even(at), g = even(at + uvec2(1u, 0u)), b = even(at + uvec2(2u, 0u));
  return (vec3(r.x, g.x, b.x) - vec3(r.y, g.y, b.y)) / 255.0;
}
vec3 toSrgb(vec3 c) {
  c = clamp(c, 0.0, 1.0);
  return mix(1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, 12.92 * c, vec3(lessThanEqual(c, vec3(0.0031308))));
}
vec3 fromSrgb(vec3 c) {
  return mix(pow((c + 0.055) / 1.055, vec3(2.4)), c / 12.92, vec3(lessThanEqual(c, vec3(0.04045))));
}
vec3 curve(vec3 c) {
  if (tone == TONE_NEUTRAL) return NeutralToneMapping(c);
  if (tone == TONE_AGX) return AgXToneMapping(c);
  if (tone == TONE_ACES) return ACESFilmicToneMapping(c);
  return c * toneMappingExposure;
}
/** Shares of the ground's light that the object keeps away: red, green, blue, luminance. */
vec4 keptAway(vec3 ray) {
  if (!hasGround || ray.z >= 0.0 || eye.z <= groundPlace.z) return vec4(0.0);
  vec2 at = (eye.xy + ray.xy * ((groundPlace.z - eye.z) / ray.z) - groundPlace.xy) / groundPlace.w;
  float fade = 1.0 - smoothstep(0.75, 1.0, length(at));
  return fade > 0.0 ? fade * texture(ground, 0.5 + 0.5 * at) : vec4(0.0);
}
void main() {
  vec2 at = gl_FragCoord.xy - origin;
  vec4 sum = texelFetch(picture, ivec2(at), 0);
  bool radiance = content == 0;
  vec3 ray = cameraTurn * rayOf(at);
  vec4 shadow = sum.a < 1.0 ? keptAway(ray) : vec4(0.0);
  if (background >= BACKGROUND_ENVIRONMENT && sum.a < 1.0) {
    float blur = background == BACKGROUND_BLURRED ? maxBlur : 0.0;
    vec3 behind = radianceFrom(normalize(ray), blur) * (1.0 - shadow.rgb);
    // Behind channels without light the surroundings are dark.
    sum = vec4(sum.rgb + (1.0 - sum.a) * (radiance ? behind : vec3(0.02)), 1.0);
  }
  // Where nothing is behind, the shadow is black that covers as much as the ground loses of luminance.
  float covered = sum.a + (1.0 - sum.a) * shadow.a;
  if (target == OUTPUT_LINEAR) {
    result = vec4(sum.rgb * (radiance ? toneMappingExposure : 1.0), covered);
    return;
  }
  vec3 straight = sum.a > 0.0 ? sum.rgb / sum.a : vec3(0.0);
  vec3 linear = radiance ? curve(straight) : straight;
  float alpha = sum.a;
  if (background == BACKGROUND_COLOUR) {
    vec3 colour = content == 2 ? backgroundSrgb : fromSrgb(backgroundSrgb) * (1.0 - shadow.rgb);
    linear = mix(colour, linear, alpha);
    alpha = 1.0;
  }
  vec3 encoded = content == 2 ? clamp(linear, 0.0, 1.0) : toSrgb(linear);
  if (covered > alpha) {
    encoded *= alpha / covered;
    alpha = covered;
  }
  vec3 levels = target == OUTPUT_CANVAS ? encoded * alpha : encoded;
  // Only radiance is dithered: a plain background keeps its exact colour, and other channels their values.
  bool shaded = radiance && (sum.a > 0.0 || shadow.a > 0.0);
  if (dither && shaded) levels = clamp(levels + noise(), 0.0, target == OUTPUT_CANVAS ? alpha : 1.0);
  result = vec4(levels, alpha);
}
