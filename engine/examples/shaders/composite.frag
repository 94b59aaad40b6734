// Puts the engine's picture among meshes: its mean depth becomes the fragment's, so that the depth test hides what lies
// behind a mesh; premultiplied colour is blended by the pipeline.
#version 450

layout(set = 0, binding = 0) uniform sampler2D scene_color;
layout(set = 0, binding = 1) uniform sampler2D scene_depth;
layout(push_constant) uniform Push { float depth_scale; float depth_offset; };
layout(location = 0) out vec4 target;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 color = texelFetch(scene_color, at, 0);
    if (color.a <= 0.0) {
        discard;
    }
    float z = texelFetch(scene_depth, at, 0).x / color.a;
    gl_FragDepth = clamp(depth_scale + depth_offset / z, 0.0, 1.0);
    target = color;
}
