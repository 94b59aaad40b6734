#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_vote : require

// One digit of the selection of the Gaussians that may grow within the budget: counts the values of 11 bits of their keys.
// The key is the gradient's bits, or, to break a tie, the inverted index.

#include "lib/dispatch.glsl"
#include "lib/density.glsl"

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

layout(std430, set = 0, binding = 0) readonly buffer DensityBlock { float density[]; };
layout(std430, set = 0, binding = 1) readonly buffer ActionBlock { uint action[]; };
layout(std430, set = 0, binding = 2) buffer HistogramBlock { uint histogram[]; };

layout(push_constant) uniform PushBlock {
    uint gaussians;
    uint by_index;    // 0: the key is the gradient's bits; 1: it is ~index, of those whose gradient has the bits tie_key
    uint tie_key;
    uint prefix_mask; // bits of the key that are known already
    uint prefix;
    uint shift;
} push;

void main() {
    uint i = workgroup_index() * 256u + gl_LocalInvocationID.x;
    if (i < push.gaussians && action[i] >= ACTION_CLONE) {
        uint bits = floatBitsToUint(mean_gradient(density[i], density[push.gaussians + i]));
        uint key = push.by_index == 1u ? ~i : bits;
        bool candidate = push.by_index == 0u || bits == push.tie_key;
        if (candidate && (key & push.prefix_mask) == push.prefix) {
            atomicAdd(histogram[(key >> push.shift) & 2047u], 1u);
        }
    }
}
