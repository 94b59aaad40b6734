#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

// Property losses of the step from the workgroups' sums of squares: position, rotation, translation (means over
// components), and the weighted total. One workgroup.

layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

#define STEP_BINDING 0
#include "lib/step.glsl"
#include "lib/thread.glsl"
#define SUM_VALUES 3
#include "lib/workgroup_sum.glsl"

layout(local_size_x = 256) in;

layout(std430, set = 0, binding = 1) readonly buffer LossPartialBlock { vec4 loss_partial[]; };
layout(std430, set = 0, binding = 2) writeonly buffer PropertyLossBlock { float property_loss[]; };

shared float loss[3];

void main() {
    uint n = step_data.gaussians;
    uint groups = n / 256u + (n % 256u == 0u ? 0u : 1u);
    float sums[SUM_VALUES];
    sums[0] = 0.0;
    sums[1] = 0.0;
    sums[2] = 0.0;
    for (uint g = thread_index(); g < groups; g += 256u) {
        vec4 partial = loss_partial[g];
        sums[0] += partial.x;
        sums[1] += partial.y;
        sums[2] += partial.z;
    }
    float total = workgroup_sums(sums);
    uint thread = thread_index();
    if (thread < 3u) {
        float value = total / (3.0 * float(n));
        loss[thread] = value;
        property_loss[thread] = value;
    }
    barrier();
    if (thread == 0u) {
        property_loss[3] = step_data.weight_position * loss[0] + step_data.weight_rotation * loss[1]
            + step_data.weight_translation * loss[2];
    }
}
