uniform vec2 size;
uniform vec4 lens;
uniform mat3 cameraTurn;
uniform vec3 eye;

/** The ray of a place in the picture, in the camera's axes. */
vec3 rayOf(vec2 place) {
  return vec3((place.x - lens.z) / lens.x, -(size.y - place.y - lens.w) / lens.y, -1.0);
}
