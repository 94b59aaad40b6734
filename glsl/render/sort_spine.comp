#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require

// In place, for each digit: exclusive prefix sum of the histogram over partitions; the digit totals go to `totals_row`.
// Runs between the count and the scatter when there are so many partitions that summing them in every workgroup of
// sort_scatter would cost more than this dispatch. A workgroup has 8 digits (32 bytes of a row) x 32 chunks of rows.

#include "lib/limits.glsl"
#include "lib/dispatch.glsl"

layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

layout(local_size_x = 256) in;

layout(std430, set = 0, binding = 0) readonly buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 1) buffer HistogramBlock { uint histogram[]; };

layout(push_constant) uniform PushBlock {
    uint count_word;
    uint totals_row;
    uint partition_shift; // log2 of the keys of a partition
} push;

const uint DIGITS_PER_GROUP = 8u;
const uint CHUNKS = 32u;

const uint ROWS_AT_ONCE = 8u; // that a thread reads before it waits for the first

shared uint sums[SORT_THREADS];

// Counts of `digit` in the rows from `first` on, 0 from `end` on.
void read_rows(uint first, uint end, uint digit, out uint n[ROWS_AT_ONCE]) {
    [[unroll]] for (uint i = 0u; i < ROWS_AT_ONCE; i++) {
        uint p = min(first + i, end - 1u);
        n[i] = first + i < end ? histogram[p * SORT_DIGITS + digit] : 0u;
    }
}

void main() {
    uint t = gl_LocalInvocationID.x;
    uint digit = workgroup_index() * DIGITS_PER_GROUP + t % DIGITS_PER_GROUP;
    uint chunk = t / DIGITS_PER_GROUP;
    uint count = counters[push.count_word];
    uint partitions = (count + (1u << push.partition_shift) - 1u) >> push.partition_shift;
    uint per_chunk = (partitions + CHUNKS - 1u) / CHUNKS;
    bool valid = digit < SORT_DIGITS;
    uint first = min(chunk * per_chunk, partitions);
    uint end = valid ? min(first + per_chunk, partitions) : first;
    uint sum = 0u;
    uint n[ROWS_AT_ONCE];
    for (uint p = first; p < end; p += ROWS_AT_ONCE) {
        read_rows(p, end, digit, n);
        [[unroll]] for (uint i = 0u; i < ROWS_AT_ONCE; i++) {
            sum += n[i];
        }
    }
    sums[t] = sum;
    barrier();
    uint before = 0u;
    for (uint c = 0u; c < chunk; c++) {
        before += sums[c * DIGITS_PER_GROUP + t % DIGITS_PER_GROUP];
    }
    for (uint p = first; p < end; p += ROWS_AT_ONCE) {
        read_rows(p, end, digit, n);
        [[unroll]] for (uint i = 0u; i < ROWS_AT_ONCE; i++) {
            if (p + i < end) {
                histogram[(p + i) * SORT_DIGITS + digit] = before;
            }
            before += n[i];
        }
    }
    if (valid && chunk == CHUNKS - 1u) {
        histogram[push.totals_row * SORT_DIGITS + digit] = before;
    }
}
