// The rendered image as the step's photo was exposed: an affine map of its colours. One pixel per thread.
#version 460
#extension GL_GOOGLE_include_directive : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

#include "lib/frame.glsl"
#include "lib/dispatch.glsl"
#define STEP_BINDING 1
#include "lib/step.glsl"
#define EXPOSURE_BINDING 2
#define EXPOSURE_ACCESS readonly
#include "lib/exposure.glsl"

layout(std430, set = 0, binding = 3) readonly buffer ColorBlock { vec4 color[]; };
layout(std430, set = 0, binding = 4) writeonly buffer ExposedBlock { vec4 exposed[]; };

void main() {
    uint i = workgroup_index() * EXPOSURE_THREADS + gl_LocalInvocationIndex;
    if (i < frame.size.x * frame.size.y) {
        uint row = exposure_row();
        vec4 pixel = color[i];
        vec4 x = vec4(pixel.xyz, 1.0);
        exposed[i] = vec4(dot(exposure_channel(row, 0u), x), dot(exposure_channel(row, 1u), x),
                          dot(exposure_channel(row, 2u), x), pixel.w);
    }
}
