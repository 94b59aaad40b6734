#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_EXT_control_flow_attributes : require

// The image loss from the partial sums of its workgroups, in a fixed order. One workgroup.

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;
layout(constant_id = 1) const uint WITH_SSIM = 1u; // 0: lambda is 0 and there are no sums of SSIM
layout(constant_id = 2) const uint STAGE = 1u;     // of the kernels before

#include "lib/frame.glsl"
#include "lib/thread.glsl"
#define STEP_BINDING 1
#include "lib/step.glsl"
#include "lib/ssim.glsl"

layout(std430, set = 0, binding = 2) readonly buffer LossPartialBlock { float loss_partial[]; };
layout(std430, set = 0, binding = 3) writeonly buffer LossBlock { float loss[]; };

shared vec3 sums[64]; // one per subgroup: 256 / 4

void main() {
    uint with_ssim = WITH_SSIM;
    uint size = SUBGROUP_SIZE;
    uint groups = 3u * loss_groups(frame.size);
    uint thread = thread_index();
    vec3 total = vec3(0.0); // L1, SSIM, MSE
    for (uint g = thread; g < groups; g += 256u) {
        float ssim = with_ssim == 1u ? loss_partial[g] : 0.0;
        total += vec3(loss_partial[groups + g], ssim, loss_partial[2u * groups + g]);
    }
    vec3 of_subgroup = subgroupAdd(total);
    if (gl_SubgroupInvocationID == 0u) {
        sums[gl_SubgroupID] = of_subgroup;
    }
    barrier();
    if (gl_WorkGroupID.x == 0u && thread == 0u) {
        vec3 sum = vec3(0.0);
        for (uint s = 0u; s < 256u / size; s++) {
            sum += sums[s];
        }
        vec3 mean = sum / (3.0 * float(frame.size.x * frame.size.y));
        float lambda = with_ssim == 1u ? step_data.weight_dssim : 0.0;
        loss[0] = (1.0 - lambda) * mean.x + lambda * (1.0 - mean.y);
        loss[1] = mean.x;
        loss[2] = mean.y;
        loss[3] = mean.z;
        for (uint i = 4u; i < 8u; i++) {
            loss[i] = 0.0;
        }
    }
}
