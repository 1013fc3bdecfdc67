in vec3 position;
uniform vec4 place;
uniform vec2 slope;
uniform float layer;
out float above;
void main() {
  above = position.z - place.z;
  vec2 shadow = position.xy - slope * (position.z - place.z);
  gl_Position = vec4((shadow - place.xy) / place.w, layer, 1.0);
}
