in vec3 position;
in vec2 uv;
in vec3 normal;
in vec4 tangent;
uniform mat4 viewMatrix;
uniform mat4 projectionMatrix;
out vec3 upright;
out vec4 along;
out vec2 place;
out vec3 world;
void main() {
  place = uv;
  world = position;
  upright = normal;
  along = tangent;
  gl_Position = projectionMatrix * viewMatrix * vec4(position, 1.0);
}
