// The free part of a specular lobe: harmonics of the sky's openness, smoothed by the lobe. Four numbers to a vector.
uniform sampler2DArray visibility;
uniform vec4 visibilityScales[OPEN_LAYERS];
uniform vec4 visibilityOffsets[OPEN_LAYERS];
uniform sampler2D lobeTable;
float freeShare(vec4 open[OPEN_LAYERS], vec3 r, float roughness) {
  float x = r.x, y = r.y, z = r.z;
  float place = clamp(roughness, 0.0, 1.0) * float(NUM_LOBE_STEPS - 1);
  int step = min(int(place), NUM_LOBE_STEPS - 2);
  vec4 lobe[LOBE_ROWS];
  for (int row = 0; row < LOBE_ROWS; row++) {
    vec4 wider = texelFetch(lobeTable, ivec2(step + 1, row), 0);
    lobe[row] = mix(texelFetch(lobeTable, ivec2(step, row), 0), wider, place - float(step));
  }
  float total = 0.0;
  ADD_OPENNESS
  return clamp(total, 0.0, 1.0);
}
