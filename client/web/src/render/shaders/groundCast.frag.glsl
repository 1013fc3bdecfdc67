in float above;
out vec4 result;
uniform float share;
void main() {
  // What lies under the ground throws no shadow onto it.
  if (above < 0.0) discard;
  result = vec4(share);
}
