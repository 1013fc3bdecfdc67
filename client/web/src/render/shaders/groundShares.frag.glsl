// Shares of red, green, blue and luminance that are kept away.
uniform sampler2D sky;
uniform sampler2D lights;
uniform vec3 lightsRgb[MAX_DOMINANT];
uniform int numLights;
uniform vec3 whole;
out vec4 result;
void main() {
  vec2 at = gl_FragCoord.xy / float(LIGHT_SIDE);
  // Four bilinear looks around the point hide the steps between the tiles' pixels.
  vec2 step = vec2(0.5, -0.5) / float(SKY_SIDE);
  vec3 blocked = 0.25 * (texture(sky, at + step.xx).rgb + texture(sky, at + step.xy).rgb
    + texture(sky, at + step.yx).rgb + texture(sky, at + step.yy).rgb);
  for (int light = 0; light < numLights; light++) {
    ivec2 tile = ivec2(light % 2, light / 2) * LIGHT_SIDE;
    blocked += texelFetch(lights, tile + ivec2(gl_FragCoord.xy), 0).r * lightsRgb[light];
  }
  vec3 weights = vec3(0.2126, 0.7152, 0.0722);
  result = clamp(vec4(blocked / max(whole, 1e-20), dot(blocked, weights) / max(dot(whole, weights), 1e-20)), 0.0, 1.0);
}
