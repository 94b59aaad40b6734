// Triangles of a user interface: from points to clip space. See engine/src/gpu/painter.rs.
#version 460

layout(push_constant) uniform PainterPush { vec2 clip_from_points; };

layout(location = 0) in vec2 position; // points, from the top left corner
layout(location = 1) in vec2 uv;
layout(location = 2) in vec4 colour;   // premultiplied

layout(location = 0) out vec2 texture_uv;
layout(location = 1) out vec4 vertex_colour;

void main() {
    gl_Position = vec4(position * clip_from_points - 1.0, 0.0, 1.0);
    texture_uv = uv;
    vertex_colour = colour;
}
