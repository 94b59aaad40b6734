#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_EXT_control_flow_attributes : require

// Property reconstruction losses: how far each Gaussian's position, so(3) vector and translation are from the weighted
// mean of its neighbouring superpoints' properties. Writes the residuals scaled to gradients, and sums of squares per
// workgroup. In the code's form (superpoints' properties are network F's outputs) the logits are updated here, unless DEFER.

layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;
layout(constant_id = 3) const uint PAPER = 0u; // superpoints' properties are means over Gaussians (property_sum)
layout(constant_id = 4) const uint DEFER = 0u; // the logits' gradient goes to logit_gradient: association_update adds to it

#define STEP_BINDING 0
#include "lib/step.glsl"
#include "lib/adam.glsl"
#define STATUS_BINDING 14
#include "lib/status.glsl"
#include "lib/limits.glsl"
#include "lib/dispatch.glsl"
#include "lib/thread.glsl"
#include "lib/quaternion.glsl"
#include "lib/association.glsl"
#define SUM_VALUES 3
#include "lib/workgroup_sum.glsl"

layout(local_size_x = 256) in;

layout(std430, set = 0, binding = 1) readonly buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 2) readonly buffer MeanBlock { float mean[]; };
layout(std430, set = 0, binding = 3) readonly buffer SuperpointOfGaussianBlock { uint superpoint_of_gaussian[]; };
layout(std430, set = 0, binding = 4) readonly buffer PoseBlock { vec4 pose[]; };
layout(std430, set = 0, binding = 5) readonly buffer SuperpointPositionBlock { float superpoint_position[]; };
layout(std430, set = 0, binding = 6) readonly buffer PropertySumBlock { float property_sum[]; };
layout(std430, set = 0, binding = 7) readonly buffer NeighborBlock { uint neighbor[]; };
layout(std430, set = 0, binding = 8) readonly buffer WeightBlock { float weight[]; };
layout(std430, set = 0, binding = 9) buffer LogitBlock { float logit[]; };
layout(std430, set = 0, binding = 10) buffer LogitMoment1Block { float logit_moment_1[]; };
layout(std430, set = 0, binding = 11) buffer LogitMoment2Block { float logit_moment_2[]; };
layout(std430, set = 0, binding = 12) writeonly buffer ResidualBlock { float residual[]; };
layout(std430, set = 0, binding = 13) writeonly buffer LossPartialBlock { vec4 loss_partial[]; };
layout(std430, set = 0, binding = 15) writeonly buffer LogitGradientBlock { float logit_gradient[]; };

#include "lib/property.glsl"
#include "lib/property_mean.glsl"
#include "lib/association_adam.glsl"

void superpoint_properties(uint j, out vec3 position, out vec3 rotation, out vec3 translation) {
    uint paper = PAPER;
    if (paper != 0u) {
        mean_properties(j, position, rotation, translation);
    } else {
        vec3 x = vec3(superpoint_position[3u * j], superpoint_position[3u * j + 1u], superpoint_position[3u * j + 2u]);
        vec3 turned;
        moved_properties(j, x, turned, position, rotation, translation);
    }
}

// dL/d logit_k = a_k (dL/da_k - sum a dL/da) with dL/da_k = -g . u_k, the sum being -g . reconstruction.
void update_logits(uint i, float gradient[MAX_NEIGHBORS]) {
    uint neighbors = NEIGHBORS;
    uint slots = SLOTS;
    [[unroll]] for (uint s = 0u; s < MAX_SLOTS; s++) {
        if (s < slots) {
            uint at = i * slots + s;
            bool in_use = s < neighbors;
            if (in_use || neighbor[at] != NO_SUPERPOINT) {
                update_logit(at, in_use ? gradient[min(s, MAX_NEIGHBORS - 1u)] : 0.0, i);
            }
        }
    }
}

void main() {
    uint thread = thread_index();
    uint i = workgroup_index() * 256u + thread;
    uint n = step_data.gaussians;
    uint neighbors = NEIGHBORS;
    uint slots = SLOTS;
    uint paper = PAPER;
    float squares[SUM_VALUES];
    squares[0] = 0.0;
    squares[1] = 0.0;
    squares[2] = 0.0;
    if (i < n) {
        vec3 turned, position, rotation, translation;
        moved_properties(own_superpoint(i), canonical_mean(i), turned, position, rotation, translation);
        vec3 p[MAX_NEIGHBORS];
        vec3 r[MAX_NEIGHBORS];
        vec3 t[MAX_NEIGHBORS];
        float a[MAX_NEIGHBORS];
        vec3 mean_p = vec3(0.0);
        vec3 mean_r = vec3(0.0);
        vec3 mean_t = vec3(0.0);
        [[unroll]] for (uint k = 0u; k < MAX_NEIGHBORS; k++) {
            if (k < neighbors) {
                superpoint_properties(min(neighbor[i * slots + k], step_data.superpoints - 1u), p[k], r[k], t[k]);
                a[k] = weight[k * n + i];
                mean_p += a[k] * p[k];
                mean_r += a[k] * r[k];
                mean_t += a[k] * t[k];
            }
        }
        vec3 error_p = position - mean_p;
        vec3 error_r = rotation - mean_r;
        vec3 error_t = translation - mean_t;
        squares[0] = dot(error_p, error_p);
        squares[1] = dot(error_r, error_r);
        squares[2] = dot(error_t, error_t);
        float scale = 2.0 / (3.0 * float(n));
        vec3 g_p = step_data.weight_position * scale * error_p;
        vec3 g_r = step_data.weight_rotation * scale * error_r;
        vec3 g_t = step_data.weight_translation * scale * error_t;
        for (uint c = 0u; c < 3u; c++) {
            residual[9u * i + c] = g_p[c];
            residual[9u * i + 3u + c] = g_r[c];
            residual[9u * i + 6u + c] = g_t[c];
        }
        if (paper == 0u && counters[COUNT_FAILED] == 0u) {
            float gradient[MAX_NEIGHBORS];
            [[unroll]] for (uint k = 0u; k < MAX_NEIGHBORS; k++) {
                gradient[k] = 0.0;
                if (k < neighbors) {
                    gradient[k] = -a[k] * (dot(g_p, p[k] - mean_p) + dot(g_r, r[k] - mean_r) + dot(g_t, t[k] - mean_t));
                }
            }
            uint defer = DEFER;
            if (defer == 0u) {
                update_logits(i, gradient);
            } else {
                [[unroll]] for (uint k = 0u; k < MAX_NEIGHBORS; k++) {
                    if (k < neighbors) {
                        logit_gradient[k * n + i] = gradient[k];
                    }
                }
            }
        }
    }
    float total = workgroup_sums(squares);
    if (thread < 3u && workgroup_index() * 256u < n) {
        loss_partial[workgroup_index()][thread] = total;
    }
}
