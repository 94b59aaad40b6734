#version 460
#extension GL_GOOGLE_include_directive : require

// Histogram of one digit for each partition of 4,096 keys: the first pass of a sort whose keys were not counted by the
// kernel that wrote them.

#include "lib/limits.glsl"
#include "lib/dispatch.glsl"

layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

layout(local_size_x = 256) in;

layout(std430, set = 0, binding = 0) readonly buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 1) readonly buffer KeysBlock { uint keys[]; };
layout(std430, set = 0, binding = 2) writeonly buffer HistogramBlock { uint histogram[]; };

layout(push_constant) uniform PushBlock {
    uint shift;
    uint digit_bits;
    uint count_word;
} push;

shared uint bins[SORT_DIGITS];

void main() {
    uint group = workgroup_index();
    uint d = gl_LocalInvocationID.x;
    uint count = counters[push.count_word];
    uint partitions = count / SORT_PARTITION + (count % SORT_PARTITION == 0u ? 0u : 1u);
    uint present = group < partitions ? min(count - group * SORT_PARTITION, SORT_PARTITION) : 0u;
    uint mask = (1u << push.digit_bits) - 1u;
    atomicExchange(bins[d], 0u);
    barrier();
    for (uint i = d; i < present; i += SORT_THREADS) {
        atomicAdd(bins[(keys[group * SORT_PARTITION + i] >> push.shift) & mask], 1u);
    }
    barrier();
    if (group < partitions) {
        histogram[group * SORT_DIGITS + d] = atomicAdd(bins[d], 0u);
    }
}
