// Light of the sky that is kept away.
uniform sampler2D tiles;
uniform sampler2D skyLight;
out vec4 result;
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec3 sum = vec3(0.0);
  for (int index = 0; index < NUM_SKY; index++) {
    ivec2 tile = ivec2(index % TILES_ACROSS, index / TILES_ACROSS) * SKY_SIDE;
    sum += texelFetch(tiles, tile + at, 0).r * texelFetch(skyLight, ivec2(index, 0), 0).rgb;
  }
  result = vec4(sum, 0.0);
}
