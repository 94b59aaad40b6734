// Triangles of a user interface: texture times colour, both premultiplied. See engine/src/gpu/painter.rs.
#version 460

layout(set = 0, binding = 0) uniform sampler2D picture;

layout(location = 0) in vec2 texture_uv;
layout(location = 1) in vec4 vertex_colour;

layout(location = 0) out vec4 colour;

void main() {
    colour = vertex_colour * texture(picture, texture_uv);
}
