#version 460
#extension GL_GOOGLE_include_directive : require

// Histogram of one digit for each partition of keys: the first pass of a sort whose keys were not counted by the
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
    uint partition_shift; // log2 of the keys of a partition
} push;

shared uint bins[SORT_DIGITS];

void main() {
    uint group = workgroup_index();
    uint d = gl_LocalInvocationID.x;
    uint count = counters[push.count_word];
    uint per_partition = 1u << push.partition_shift;
    uint partitions = (count + per_partition - 1u) >> push.partition_shift;
    uint present = group < partitions ? min(count - group * per_partition, per_partition) : 0u;
    uint mask = (1u << push.digit_bits) - 1u;
    atomicExchange(bins[d], 0u);
    barrier();
    for (uint i = d; i < present; i += SORT_THREADS) {
        atomicAdd(bins[(keys[group * per_partition + i] >> push.shift) & mask], 1u);
    }
    barrier();
    if (group < partitions) {
        histogram[group * SORT_DIGITS + d] = atomicAdd(bins[d], 0u);
    }
}
