// Gradients of the loss back through the photo's exposure: by the rendered image, in place, and by the 12 numbers of the affine
// map, as sums of each workgroup.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_EXT_control_flow_attributes : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

#include "lib/frame.glsl"
#include "lib/dispatch.glsl"
#include "lib/thread.glsl"
#define STEP_BINDING 1
#include "lib/step.glsl"
#define EXPOSURE_BINDING 2
#define EXPOSURE_ACCESS readonly
#include "lib/exposure.glsl"

layout(std430, set = 0, binding = 3) readonly buffer ColorBlock { vec4 color[]; };
layout(std430, set = 0, binding = 4) buffer ImageGradientBlock { vec4 image_gradient[]; };
layout(std430, set = 0, binding = 5) writeonly buffer ExposurePartialBlock { float exposure_partial[]; }; // [groups][12]

shared vec4 sums[3u * 64u]; // of up to 64 subgroups: 256 / 4

void main() {
    uint size = SUBGROUP_SIZE;
    uint thread = thread_index();
    uint group = workgroup_index();
    uint pixels = frame.size.x * frame.size.y;
    uint row = exposure_row();
    vec4 red = exposure_channel(row, 0u);
    vec4 green = exposure_channel(row, 1u);
    vec4 blue = exposure_channel(row, 2u);
    vec4 by_red = vec4(0.0);
    vec4 by_green = vec4(0.0);
    vec4 by_blue = vec4(0.0);
    for (uint k = 0u; k < EXPOSURE_PIXELS / EXPOSURE_THREADS; k++) {
        uint i = group * EXPOSURE_PIXELS + k * EXPOSURE_THREADS + thread;
        if (i < pixels) {
            vec3 g = image_gradient[i].xyz;
            // Without a gradient there may be no number in the image, either.
            bool counts = any(notEqual(g, vec3(0.0)));
            vec4 x = counts ? vec4(color[i].xyz, 1.0) : vec4(0.0);
            by_red += g.x * x;
            by_green += g.y * x;
            by_blue += g.z * x;
            image_gradient[i] = vec4(g.x * red.xyz + g.y * green.xyz + g.z * blue.xyz, 0.0);
        }
    }
    by_red = subgroupAdd(by_red);
    by_green = subgroupAdd(by_green);
    by_blue = subgroupAdd(by_blue);
    if (gl_SubgroupInvocationID == 0u) {
        sums[3u * gl_SubgroupID] = by_red;
        sums[3u * gl_SubgroupID + 1u] = by_green;
        sums[3u * gl_SubgroupID + 2u] = by_blue;
    }
    barrier();
    uint groups = (pixels + EXPOSURE_PIXELS - 1u) / EXPOSURE_PIXELS;
    if (thread < EXPOSURE_VALUES && group < groups) {
        float sum = 0.0;
        for (uint s = 0u; s < EXPOSURE_THREADS / size; s++) {
            sum += sums[3u * s + thread / 4u][thread % 4u];
        }
        exposure_partial[group * EXPOSURE_VALUES + thread] = sum;
    }
}
