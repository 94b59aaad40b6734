// A cube with an edge of 2 about the origin, 36 vertices without a vertex buffer.
#version 450

layout(push_constant) uniform Push { mat4 clip_from_mesh; };
layout(location = 0) out vec3 color;

void main() {
    int face = gl_VertexIndex / 6;
    int corner = int[](0, 1, 2, 2, 1, 3)[gl_VertexIndex % 6];
    vec2 square = vec2(corner & 1, corner >> 1) * 2.0 - 1.0;
    float side = float(face & 1) * 2.0 - 1.0;
    vec3 at = vec3(side, square);
    at = face / 2 == 0 ? at : face / 2 == 1 ? at.yxz : at.yzx;
    color = vec3[](vec3(0.9, 0.3, 0.2), vec3(0.2, 0.7, 0.3), vec3(0.2, 0.4, 0.9))[face / 2] * (0.75 + 0.25 * side);
    gl_Position = clip_from_mesh * vec4(at, 1.0);
}
