#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require

// Backward of the paper's property losses through both reconstructions: logits (with Adam), each Gaussian's own pose and
// its mean.

layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

#define STEP_BINDING 0
#include "lib/step.glsl"
#include "lib/adam.glsl"
#define STATUS_BINDING 15
#include "lib/status.glsl"
#include "lib/limits.glsl"
#include "lib/dispatch.glsl"
#include "lib/quaternion.glsl"
#include "lib/association.glsl"

layout(local_size_x = 256) in;

layout(std430, set = 0, binding = 1) readonly buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 2) readonly buffer MeanBlock { float mean[]; };
layout(std430, set = 0, binding = 3) readonly buffer SuperpointOfGaussianBlock { uint superpoint_of_gaussian[]; };
layout(std430, set = 0, binding = 4) readonly buffer PoseBlock { vec4 pose[]; };
layout(std430, set = 0, binding = 5) readonly buffer PropertySumBlock { float property_sum[]; };
layout(std430, set = 0, binding = 6) readonly buffer ResidualSumBlock { float residual_sum[]; };
layout(std430, set = 0, binding = 7) readonly buffer NeighborBlock { uint neighbor[]; };
layout(std430, set = 0, binding = 8) readonly buffer WeightBlock { float weight[]; };
layout(std430, set = 0, binding = 9) buffer LogitBlock { float logit[]; };
layout(std430, set = 0, binding = 10) buffer LogitMoment1Block { float logit_moment_1[]; };
layout(std430, set = 0, binding = 11) buffer LogitMoment2Block { float logit_moment_2[]; };
layout(std430, set = 0, binding = 12) readonly buffer ResidualBlock { float residual[]; };
layout(std430, set = 0, binding = 13) writeonly buffer OwnGradientBlock { float own_gradient[]; };
layout(std430, set = 0, binding = 14) writeonly buffer PropertyMeanGradientBlock { float property_mean_gradient[]; };

#include "lib/property.glsl"
#include "lib/property_mean.glsl"
#include "lib/association_adam.glsl"

vec3 residual_vector(uint first, uint i) {
    uint at = 9u * i + first;
    return vec3(residual[at], residual[at + 1u], residual[at + 2u]);
}

// Gradient of a superpoint's mean property over the weight sum: -Σ a g / Σ a.
vec3 pulled(uint plane, uint j) {
    uint m = step_data.superpoints;
    vec3 sum = vec3(residual_sum[plane * m + j], residual_sum[(plane + 1u) * m + j], residual_sum[(plane + 2u) * m + j]);
    return -inverse_weight(j) * sum;
}

void write_vector(uint first, uint i, vec3 value) {
    uint at = 9u * i + first;
    own_gradient[at] = value.x;
    own_gradient[at + 1u] = value.y;
    own_gradient[at + 2u] = value.z;
}

void main() {
    uint i = workgroup_index() * 256u + gl_LocalInvocationID.x;
    uint n = step_data.gaussians;
    uint neighbors = NEIGHBORS;
    uint slots = SLOTS;
    if (i < n) {
        vec3 turned, position, rotation, translation;
        uint own = own_superpoint(i);
        moved_properties(own, canonical_mean(i), turned, position, rotation, translation);
        vec3 g_p = residual_vector(0u, i);
        vec3 g_r = residual_vector(3u, i);
        vec3 g_t = residual_vector(6u, i);
        // The Gaussian's properties act directly and through the superpoints' means.
        vec3 d_p = g_p;
        vec3 d_r = g_r;
        vec3 d_t = g_t;
        float a[MAX_NEIGHBORS];
        float d_a[MAX_NEIGHBORS];
        float d_mean = 0.0;
        [[unroll]] for (uint k = 0u; k < MAX_NEIGHBORS; k++) {
            if (k < neighbors) {
                uint j = min(neighbor[i * slots + k], step_data.superpoints - 1u);
                vec3 p, r, t;
                mean_properties(j, p, r, t);
                vec3 s_p = pulled(4u, j);
                vec3 s_r = pulled(7u, j);
                vec3 s_t = pulled(10u, j);
                a[k] = weight[k * n + i];
                // -g . u_k shifted by the constant g . v, which the softmax does not see: nothing cancels later.
                d_a[k] = dot(g_p + s_p, position - p) + dot(g_r + s_r, rotation - r) + dot(g_t + s_t, translation - t);
                d_mean += a[k] * d_a[k];
                d_p += a[k] * s_p;
                d_r += a[k] * s_r;
                d_t += a[k] * s_t;
            }
        }
        write_vector(0u, i, cross(turned, d_p));
        write_vector(3u, i, d_r);
        write_vector(6u, i, d_p + d_t);
        vec4 back = quaternion_exp(-rotation);
        vec3 d_canonical = d_p + quaternion_displacement(back, d_p);
        property_mean_gradient[i] = d_canonical.x;
        property_mean_gradient[n + i] = d_canonical.y;
        property_mean_gradient[2u * n + i] = d_canonical.z;
        if (counters[COUNT_FAILED] == 0u) {
            [[unroll]] for (uint s = 0u; s < MAX_SLOTS; s++) {
                if (s < slots) {
                    uint at = i * slots + s;
                    bool in_use = s < neighbors;
                    if (in_use || neighbor[at] != NO_SUPERPOINT) {
                        uint k = min(s, MAX_NEIGHBORS - 1u);
                        update_logit(at, in_use ? a[k] * (d_a[k] - d_mean) : 0.0, i);
                    }
                }
            }
        }
    }
}
