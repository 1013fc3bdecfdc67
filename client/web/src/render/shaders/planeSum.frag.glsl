// Sums of planes; the openness beside direct ones.
uniform isampler2DArray planes;
uniform vec4 red[LAYERS];
uniform vec4 green[LAYERS];
uniform vec4 blue[LAYERS];
uniform vec3 base;
uniform vec2 constant;
out vec4 result;
void main() {
  ivec2 where = ivec2(gl_FragCoord.xy);
  vec3 sum = base;
  for (int layer = 0; layer < LAYERS; layer++) {
    vec4 q = vec4(texelFetch(planes, ivec3(where, layer), 0));
    sum += vec3(dot(q, red[layer]), dot(q, green[layer]), dot(q, blue[layer]));
  }
  float open = 1.0;
  if (IS_DIRECT) {
    float first = float(texelFetch(planes, ivec3(where, 0), 0).r);
    open = clamp((constant.x + constant.y * first) / (0.5 * sqrt(pi)), 0.0, 1.0);
  }
  result = vec4(sum, open);
}
