#version 460
#extension GL_GOOGLE_include_directive : require

// End of a step: the assignment and the superpoint centres that the next step uses. A superpoint that no Gaussian has as
// a neighbour keeps its place. Nothing changes when the forward pass failed.

layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

#define STEP_BINDING 0
#include "lib/step.glsl"
#define STATUS_BINDING 6
#include "lib/status.glsl"
#include "lib/limits.glsl"
#include "lib/dispatch.glsl"

layout(local_size_x = 256) in;

layout(std430, set = 0, binding = 1) readonly buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 2) readonly buffer SuperpointSumBlock { float superpoint_sum[]; };
layout(std430, set = 0, binding = 3) readonly buffer NextSuperpointBlock { uint next_superpoint[]; };
layout(std430, set = 0, binding = 4) buffer SuperpointOfGaussianBlock { uint superpoint_of_gaussian[]; };
layout(std430, set = 0, binding = 5) buffer SuperpointPositionBlock { float superpoint_position[]; };

// Least sum of weights that a centre is divided by.
const float LEAST_WEIGHT = 1e-5;

void main() {
    uint i = workgroup_index() * 256u + gl_LocalInvocationID.x;
    uint m = step_data.superpoints;
    bool failed = counters[COUNT_FAILED] != 0u;
    if (i < step_data.gaussians && !failed) {
        superpoint_of_gaussian[i] = next_superpoint[i];
    }
    if (i < m && !failed) {
        float total = superpoint_sum[i];
        vec3 center;
        for (uint c = 0u; c < 3u; c++) {
            center[c] = superpoint_sum[(1u + c) * m + i] / max(total, LEAST_WEIGHT);
        }
        bool finite = number_is_finite(center.x) && number_is_finite(center.y) && number_is_finite(center.z);
        if (total > 0.0 && finite) {
            for (uint c = 0u; c < 3u; c++) {
                superpoint_position[3u * i + c] = center[c];
            }
        } else if (!finite) {
            report_not_finite(STATUS_POSE, i);
        }
    }
}
