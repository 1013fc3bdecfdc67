in vec3 position;
uniform mat3 axes;
uniform vec3 ballCentre;
uniform float ballRadius;
void main() {
  vec3 place = (position - ballCentre) * axes / ballRadius;
  gl_Position = vec4(place.xy, -place.z, 1.0);
}
