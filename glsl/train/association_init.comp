#version 460
#extension GL_GOOGLE_include_directive : require

// First assignment and logits, after nearest_superpoints has filled rows that remembered nothing: every Gaussian moves
// with its nearest superpoint, whose logit is push.logit where the rule of push.paper says so; all others keep 0.1.

layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

#define STEP_BINDING 0
#include "lib/step.glsl"
#include "lib/dispatch.glsl"
#include "lib/association.glsl"

layout(local_size_x = 256) in;

layout(std430, set = 0, binding = 1) readonly buffer NeighborBlock { uint neighbor[]; };
layout(std430, set = 0, binding = 2) readonly buffer ChosenBlock { uint chosen[]; };
layout(std430, set = 0, binding = 3) buffer LogitBlock { float logit[]; };
layout(std430, set = 0, binding = 4) writeonly buffer SuperpointOfGaussianBlock { uint superpoint_of_gaussian[]; };

layout(push_constant) uniform PushBlock {
    float logit;   // of the chosen entries
    uint paper;    // 0: the nearest superpoint of every Gaussian; 1: the superpoint that the Gaussian seeded
} push;

void main() {
    uint i = workgroup_index() * 256u + gl_LocalInvocationID.x;
    uint neighbors = NEIGHBORS;
    uint slots = SLOTS;
    if (i < step_data.gaussians) {
        superpoint_of_gaussian[i] = neighbor[i * slots];
        for (uint k = 0u; k < neighbors; k++) {
            uint at = i * slots + k;
            bool pick = push.paper == 0u ? k == 0u : chosen[neighbor[at]] == i;
            if (pick) {
                logit[at] = push.logit;
            }
        }
    }
}
