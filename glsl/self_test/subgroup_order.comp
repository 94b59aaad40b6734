#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_KHR_shader_subgroup_vote : require

// What the other kernels take for granted of a device: the size and the order of subgroups, what the operations within
// them give, and sums by many workgroups into the same words.

#include "lib/dispatch.glsl"
#include "lib/subgroup.glsl"

layout(local_size_x = 256) in;

layout(std430, set = 0, binding = 0) writeonly buffer ProbeBlock { uint probe[]; };
layout(std430, set = 0, binding = 1) buffer TallyBlock { uint tally[]; };

layout(push_constant) uniform PushBlock {
    uint invocations; // a multiple of 256; the length of one plane of probe
} push;

const uint TALLY_BINS = 32u;

void main() {
    uint i = workgroup_index() * SCAN_THREADS + thread_index();
    uint lane = gl_SubgroupInvocationID;
    uint value = (i * 2654435761u) >> 20;
    uint total;
    uint before = workgroup_exclusive_add(value, total);
    uint inclusive = subgroupInclusiveAdd(value);
    uint sum = subgroupAdd(value);
    uint largest = subgroupMax(value);
    uint smallest = subgroupMin(value);
    uvec4 odd = subgroupBallot((value & 1u) != 0u);
    uint neighbor = subgroupShuffle(value, lane ^ 1u);
    uint mirrored = subgroupShuffleXor(value, gl_SubgroupSize - 1u);
    uint first = subgroupBroadcastFirst(value);
    bool any = subgroupAny((value & 63u) == 0u);
    bool all = subgroupAll((value & 63u) != 63u);
    if (i < push.invocations) {
        uint n = push.invocations;
        probe[i] = gl_SubgroupSize;
        probe[n + i] = gl_SubgroupID * gl_SubgroupSize + lane;
        probe[2u * n + i] = before;
        probe[3u * n + i] = total;
        probe[4u * n + i] = inclusive;
        probe[5u * n + i] = sum;
        probe[6u * n + i] = largest << 16 | smallest;
        probe[7u * n + i] = count_lanes_below(odd, lane) << 16 | count_lanes(odd);
        probe[8u * n + i] = neighbor << 16 | mirrored;
        probe[9u * n + i] = first << 2 | (any ? 2u : 0u) | (all ? 1u : 0u);
        atomicAdd(tally[0], value);
        atomicMax(tally[1], value);
        atomicOr(tally[2], 1u << (value & 31u));
        atomicAdd(tally[3u + (value & (TALLY_BINS - 1u))], 1u);
    }
}
