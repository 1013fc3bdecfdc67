// From tables to the atlas: openness beside direct light, the factor to the surroundings' radiance beside indirect.
layout(location = 0) out vec4 straight;
layout(location = 1) out vec4 again;
uniform usampler2D texelPlane;
uniform usampler2D blocksAround;
uniform sampler2D direct;
uniform sampler2D indirect;
/** Position of a texel in a table. */
ivec2 placeOf(uint texel) { return ivec2(int(texel) % TABLE_WIDTH, int(texel) / TABLE_WIDTH); }
vec3 block(uint index) { return texelFetch(indirect, placeOf(index), 0).rgb; }
void main() {
  ivec2 where = placeOf(texelFetch(texelPlane, ivec2(gl_FragCoord.xy), 0).r);
  straight = texelFetch(direct, where, 0);
  uvec4 around = texelFetch(blocksAround, where, 0);
  again.rgb = 0.5625 * block(around.x) + 0.1875 * (block(around.y) + block(around.z)) + 0.0625 * block(around.w);
  again.a = 1.0 / (pi * max(1.0 - straight.a, LEAST_BLOCKED));
}
