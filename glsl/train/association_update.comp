#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_EXT_control_flow_attributes : require

// Adam on the association's logits when they are the weights of soft superpoints: through the softmax from the image loss'
// gradient by each weight, plus what the property losses left (PROPERTY). Remembered superpoints have gradient 0.

layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;
layout(constant_id = 3) const uint PROPERTY = 0u;

#define STEP_BINDING 0
#include "lib/step.glsl"
#include "lib/adam.glsl"
#define STATUS_BINDING 8
#include "lib/status.glsl"
#include "lib/limits.glsl"
#include "lib/dispatch.glsl"
#include "lib/thread.glsl"
#include "lib/association.glsl"

layout(local_size_x = 256) in;

layout(std430, set = 0, binding = 1) readonly buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 2) readonly buffer NeighborBlock { uint neighbor[]; };
layout(std430, set = 0, binding = 3) readonly buffer WeightBlock { float weight[]; };
layout(std430, set = 0, binding = 4) readonly buffer PoseGradientBlock { float pose_gradient[]; };
layout(std430, set = 0, binding = 5) buffer LogitBlock { float logit[]; };
layout(std430, set = 0, binding = 6) buffer LogitMoment1Block { float logit_moment_1[]; };
layout(std430, set = 0, binding = 7) buffer LogitMoment2Block { float logit_moment_2[]; };
layout(std430, set = 0, binding = 9) readonly buffer LogitGradientBlock { float logit_gradient[]; };

#include "lib/association_adam.glsl"

void main() {
    uint i = workgroup_index() * 256u + thread_index();
    uint n = step_data.gaussians;
    uint neighbors = NEIGHBORS;
    uint slots = SLOTS;
    uint property = PROPERTY;
    if (i < n && counters[COUNT_FAILED] == 0u) {
        float a[MAX_NEIGHBORS];
        float of_weight[MAX_NEIGHBORS];
        float mean = 0.0;
        [[unroll]] for (uint k = 0u; k < MAX_NEIGHBORS; k++) {
            a[k] = 0.0;
            of_weight[k] = 0.0;
            if (k < neighbors) {
                a[k] = weight[k * n + i];
                of_weight[k] = pose_gradient[(7u * k + 6u) * n + i];
                mean += a[k] * of_weight[k];
            }
        }
        [[unroll]] for (uint s = 0u; s < MAX_SLOTS; s++) {
            if (s < slots) {
                uint at = i * slots + s;
                float gradient = 0.0;
                if (s < neighbors) {
                    gradient = a[min(s, MAX_NEIGHBORS - 1u)] * (of_weight[min(s, MAX_NEIGHBORS - 1u)] - mean);
                    gradient += property != 0u ? logit_gradient[s * n + i] : 0.0;
                }
                if (s < neighbors || neighbor[at] != NO_SUPERPOINT) {
                    update_logit(at, gradient, i);
                }
            }
        }
    }
}
