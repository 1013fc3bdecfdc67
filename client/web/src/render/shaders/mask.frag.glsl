in vec3 world;
uniform float floorHeight;
out vec4 result;
void main() {
  if (world.z < floorHeight) discard;
  result = vec4(1.0);
}
