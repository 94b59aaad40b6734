#version 460
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_vote : require
#extension GL_KHR_shader_subgroup_shuffle : require

// Structured flow and subgroup operations; tests/flow.rs computes the same on its own.
// Compiled by: glslc --target-env=vulkan1.2 -O0

layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;
layout(local_size_x = 128) in;
layout(std430, set = 0, binding = 0) readonly buffer SeedBlock { uint seed[]; };
layout(std430, set = 0, binding = 1) writeonly buffer ResultBlock { uint result[]; };
layout(push_constant) uniform PushBlock { uint limit; uint step; } push;

// Loops with breaks, continues and returns in them.
uint collatz(uint n) {
    uint steps = 0u;
    for (uint k = 0u; k < push.limit; k++) {
        if (n == 1u) {
            return steps;
        }
        if (n % 7u == 3u && k > 5u) {
            break;
        }
        steps++;
        if ((n & 1u) == 0u) {
            n /= 2u;
            continue;
        }
        n = 3u * n + push.step;
        for (uint j = 0u; j < n % 4u; j++) {
            if (j == 2u) {
                return steps + 1000u * j;
            }
            steps += 10u;
        }
    }
    do {
        steps += 100u;
        n /= 3u;
    } while (n > 50u);
    return steps;
}

void bump(inout uint x, uint by) {
    x = by > 3u ? x + by : x * 2u;
}

void main() {
    uint i = gl_LocalInvocationID.x;
    uint s = seed[i];
    uint own[5];
    for (uint k = 0u; k < 5u; k++) {
        own[k] = s >> k;
    }
    own[s % 5u] += 17u;
    uvec3 v = uvec3(own[0], own[s % 5u], own[4]);
    v = v.zxy;
    bump(v.y, s % 8u);
    uint steps = collatz(1u + s % 1000u);
    uint votes = 0u;
    uint sum = 0u;
    uint scan = 0u;
    uint first = 0u;
    if (s % 3u != 0u) {
        uvec4 ballot = subgroupBallot(s % 2u == 0u);
        votes = bitCount(ballot.x) + bitCount(ballot.y) + bitCount(ballot.z) + bitCount(ballot.w);
        sum = subgroupAdd(s % 100u);
        scan = subgroupInclusiveAdd(s % 100u);
        first = subgroupBroadcastFirst(s);
    } else {
        first = subgroupMax(s);
    }
    uint other = subgroupShuffleXor(s, 1u);
    bool both = s % 2u == 0u && (s % 3u == 1u || s % 5u == 2u);
    uint at = 8u * i;
    result[at] = steps;
    result[at + 1u] = v.x ^ v.y ^ v.z;
    result[at + 2u] = votes;
    result[at + 3u] = sum;
    result[at + 4u] = scan;
    result[at + 5u] = first;
    result[at + 6u] = other;
    result[at + 7u] = uint(both) + 2u * uint(subgroupAny(s % 64u == 0u));
}
