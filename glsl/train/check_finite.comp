#version 460
#extension GL_GOOGLE_include_directive : require

// Counts the floats that are not finite and finds the first.

#include "lib/dispatch.glsl"

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

layout(std430, set = 0, binding = 0) readonly buffer ValuesBlock { uint values[]; };
layout(std430, set = 0, binding = 1) buffer FoundBlock { uint found[]; }; // count, first index

layout(push_constant) uniform PushBlock {
    uint count;
} push;

const uint FLOATS_PER_THREAD = 4u;

void main() {
    uint first = workgroup_index() * (256u * FLOATS_PER_THREAD) + gl_LocalInvocationID.x;
    uint bad = 0u;
    uint lowest = 0xffffffffu;
    for (uint k = 0u; k < FLOATS_PER_THREAD; k++) {
        uint i = first + 256u * k;
        if (i < push.count && (values[i] & 0x7f800000u) == 0x7f800000u) {
            bad += 1u;
            lowest = min(lowest, i);
        }
    }
    if (bad != 0u) {
        atomicAdd(found[0], bad);
        atomicMin(found[1], lowest);
    }
}
