#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_vote : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_EXT_control_flow_attributes : require

// One stable pass of a least-significant-digit radix sort: 256 threads scatter the keys of a partition (and their values) to
// their places and count the next pass's digits. Needs the histogram of this digit for each partition; no workgroup waits for
// another. A small sort has small partitions, so that more processors have a part of it and each is done sooner. A large one is bound by
// memory: its partitions are put in order in shared memory first, so that they are written in runs and not key by key.

#include "lib/limits.glsl"
#include "lib/dispatch.glsl"
#include "lib/subgroup.glsl"

layout(constant_id = 1) const uint HAS_VALUES = 1u;
layout(constant_id = 2) const uint HAS_NEXT = 1u;   // count the next digit
layout(constant_id = 3) const uint RANK_BY_BALLOT = 1u; // else by comparing with each lane: at most 16 lanes
layout(constant_id = 4) const uint ROUNDS = 16u;     // keys per thread, a power of two: at most SORT_ROUNDS
layout(constant_id = 5) const uint STAGED = 0u;      // put in order in shared memory first, then written in runs

layout(local_size_x = 256) in;

layout(std430, set = 0, binding = 0) readonly buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 1) readonly buffer HistogramBlock { uvec4 histogram[]; }; // four digits at a time
layout(std430, set = 0, binding = 2) readonly buffer KeysInBlock { uint keys_in[]; };
layout(std430, set = 0, binding = 3) readonly buffer ValuesInBlock { uint values_in[]; };
layout(std430, set = 0, binding = 4) writeonly buffer KeysOutBlock { uint keys_out[]; };
layout(std430, set = 0, binding = 5) writeonly buffer ValuesOutBlock { uint values_out[]; };
layout(std430, set = 0, binding = 6) buffer NextHistogramBlock { uint next_histogram[]; };

#include "lib/count_digit.glsl"

layout(push_constant) uniform PushBlock {
    uint shift;           // first bit of this digit
    uint digit_bits;      // 1..8
    uint count_word;      // counters[count_word] = number of keys
    uint next_shift;
    uint next_digit_bits;
    uint totals_row;      // row of the digit totals once sort_spine has run on `histogram`, else NOT_PRESCANNED
} push;

const uint NOT_PRESCANNED = 0xffffffffu;
const uint QUADS = SORT_DIGITS / 4u;
const uint ROWS_AT_ONCE = 8u; // that a thread reads before it waits for the first
const uint MAX_ROWS = 16u; // 16 KiB of counters: subgroups of fewer than 16 lanes share a row, taking turns
shared uint rank_rows[MAX_ROWS * SORT_DIGITS]; // as many words as the largest partition has keys: STAGED puts them here
shared uint run_start[SORT_DIGITS]; // STAGED: what is added to a key's place in the ordered partition to have its place among all

// A digit that no key has, for lanes without a key.
const uint NO_DIGIT = 0xffffffffu;

// Lanes with the same digit as this one: how many below it, how many in all, and the lowest; from one ballot per bit of the
// digit.
uvec3 find_peers_by_ballot(uint digit, uint lane) {
    uvec4 peers = subgroupBallot(digit != NO_DIGIT);
    // All eight bits, though those past digit_bits are 0 in every digit: around a loop of unknown length a compiler cannot
    // unroll the one over the keys, which then are in memory instead of registers.
    [[unroll]] for (uint b = 0u; b < 8u; b++) {
        bool bit = ((digit >> b) & 1u) != 0u;
        uvec4 vote = subgroupBallot(bit);
        peers &= bit ? vote : ~vote;
    }
    return uvec3(count_lanes_below(peers, lane), count_lanes(peers), lowest_lane(peers));
}

// The same for small subgroups, by comparing with each lane: on a CPU device a ballot is a loop over lanes, a broadcast
// of a fixed lane is one instruction.
uvec3 find_peers_by_broadcast(uint digit, uint lane) {
    uint size = SUBGROUP_SIZE;
    uvec3 found = uvec3(0u, 0u, lane);
#define FIND_PEER(j)                                    \
    {                                                   \
        bool same = subgroupShuffle(digit, j) == digit; \
        found.x += same && j < lane ? 1u : 0u;          \
        found.y += same ? 1u : 0u;                      \
        found.z = same ? min(found.z, j) : found.z;     \
    }
    FIND_PEER(0u) FIND_PEER(1u) FIND_PEER(2u) FIND_PEER(3u)
    if (size > 4u) {
        FIND_PEER(4u) FIND_PEER(5u) FIND_PEER(6u) FIND_PEER(7u)
    }
    if (size > 8u) {
        FIND_PEER(8u) FIND_PEER(9u) FIND_PEER(10u) FIND_PEER(11u)
        FIND_PEER(12u) FIND_PEER(13u) FIND_PEER(14u) FIND_PEER(15u)
    }
    return found;
}

// Of the thread's digit: how many keys of earlier partitions have it, and how many of all (x, y). Summed by all threads: each takes four
// digits of every fourth row, and several rows are on their way from memory at once. Uses rank_rows; contains a barrier.
uvec2 sum_partitions(uint group, uint partitions) {
    uint d = thread_index();
    uint quad = d % QUADS;
    uvec4 before = uvec4(0u);
    uvec4 all = uvec4(0u);
    uint earlier = min(group, partitions);
    for (uint first = d / QUADS; first < partitions; first += 4u * ROWS_AT_ONCE) {
        uvec4 n[ROWS_AT_ONCE];
        [[unroll]] for (uint i = 0u; i < ROWS_AT_ONCE; i++) {
            n[i] = histogram[min(first + 4u * i, partitions - 1u) * QUADS + quad];
        }
        [[unroll]] for (uint i = 0u; i < ROWS_AT_ONCE; i++) {
            uint row = first + 4u * i;
            all += row < partitions ? n[i] : uvec4(0u);
            before += row < earlier ? n[i] : uvec4(0u);
        }
    }
    uint at = d / QUADS * SORT_DIGITS + 4u * quad;
    [[unroll]] for (uint c = 0u; c < 4u; c++) {
        rank_rows[at + c] = before[c];
        rank_rows[4u * SORT_DIGITS + at + c] = all[c];
    }
    barrier();
    uvec2 sums = uvec2(0u);
    [[unroll]] for (uint k = 0u; k < 4u; k++) {
        sums += uvec2(rank_rows[k * SORT_DIGITS + d], rank_rows[(4u + k) * SORT_DIGITS + d]);
    }
    return sums;
}

// First output position of digit d in partition `group`, for thread d: all smaller digits, then the same digit in
// earlier partitions. Uses rank_rows until its last barrier but one.
uint digit_base(uint group, uint partitions) {
    uint d = thread_index();
    uvec2 sums = uvec2(0u);
    // Not a specialisation constant: one pipeline serves small sorts and large ones.
    if (push.totals_row != NOT_PRESCANNED) {
        sums.x = group < partitions ? histogram[group * QUADS + d / 4u][d % 4u] : 0u;
        sums.y = histogram[push.totals_row * QUADS + d / 4u][d % 4u];
    } else {
        sums = sum_partitions(group, partitions);
    }
    uint total;
    return workgroup_exclusive_add(sums.y, total) + sums.x;
}

void main() {
    uint group = workgroup_index();
    uint d = thread_index();
    uint lane = gl_SubgroupInvocationID;
    uint size = SUBGROUP_SIZE;
    uint has_values = HAS_VALUES;
    uint has_next = HAS_NEXT;
    uint count = counters[push.count_word];
    uint rounds = ROUNDS;
    uint per_partition = SORT_THREADS * rounds;
    uint partition_shift = uint(findMSB(per_partition));
    uint partitions = (count + per_partition - 1u) >> partition_shift;
    uint mask = (1u << push.digit_bits) - 1u;
    uint next_mask = (1u << push.next_digit_bits) - 1u;

    // Subgroups that share a row are neighbours in key order, and the earlier one counts first: ranks stay stable.
    uint subgroups = SORT_THREADS / size;
    uint share = max(subgroups / MAX_ROWS, 1u);
    uint rows = subgroups / share;
    uint row = gl_SubgroupID / share * SORT_DIGITS;

    // Each subgroup owns `rounds` times its size consecutive keys; the last partition may be partial, and a surplus
    // workgroup of a folded grid has none.
    uint first = gl_SubgroupID * (rounds * size) + lane;
    uint present = group < partitions ? min(count - group * per_partition, per_partition) : 0u;
    uint start = group * per_partition + first;
    uint key[SORT_ROUNDS];
    [[unroll]] for (uint r = 0u; r < ROUNDS; r++) {
        key[r] = first + r * size < present ? keys_in[start + r * size] : 0u;
    }
    uint base = digit_base(group, partitions);
    for (uint i = 0u; i < rows; i++) {
        rank_rows[i * SORT_DIGITS + d] = 0u;
    }

    uint by_ballot = RANK_BY_BALLOT;
    uint rank[SORT_ROUNDS];
    for (uint turn = 0u; turn < share; turn++) {
        barrier();
        if (gl_SubgroupID % share == turn) {
            // The lowest lane of each digit counts for its peers and hands them what was there: no barrier, because a round
            // cannot begin before the shuffle has its result. Only subgroups take turns here, and some drivers make a barrier
            // of the whole workgroup of a subgroup's.
            [[unroll]] for (uint r = 0u; r < ROUNDS; r++) {
                bool valid = first + r * size < present;
                uint digit = (key[r] >> push.shift) & mask;
                uint own = valid ? digit : NO_DIGIT;
                uvec3 peers = by_ballot != 0u ? find_peers_by_ballot(own, lane) : find_peers_by_broadcast(own, lane);
                uint seen = 0u;
                if (valid && peers.x == 0u) {
                    seen = atomicAdd(rank_rows[row + digit], peers.y);
                }
                rank[r] = subgroupShuffle(seen, valid ? peers.z : lane) + peers.x;
            }
        }
    }

    barrier();
    // Where each digit's keys begin: among all, or in the ordered partition.
    uint begin = base;
    uint staged = STAGED;
    if (staged != 0u) {
        uint own = 0u;
        for (uint i = 0u; i < rows; i++) {
            own += rank_rows[i * SORT_DIGITS + d];
        }
        uint all;
        begin = workgroup_exclusive_add(own, all);
        run_start[d] = base - begin; // modulo 2^32
    }
    for (uint i = 0u; i < rows; i++) {
        uint n = rank_rows[i * SORT_DIGITS + d];
        rank_rows[i * SORT_DIGITS + d] = begin;
        begin += n;
    }
    barrier();

    // All at once: a load after a store would wait for it, as far as the compiler knows.
    uint value[SORT_ROUNDS];
    [[unroll]] for (uint r = 0u; r < ROUNDS; r++) {
        value[r] = has_values != 0u && first + r * size < present ? values_in[start + r * size] : 0u;
    }
    [[unroll]] for (uint r = 0u; r < ROUNDS; r++) {
        rank[r] += rank_rows[row + ((key[r] >> push.shift) & mask)];
    }
    if (staged == 0u) {
        [[unroll]] for (uint r = 0u; r < ROUNDS; r++) {
            uint to = rank[r];
            bool valid = first + r * size < present && to < count;
            if (valid) {
                keys_out[to] = key[r];
                if (has_values != 0u) {
                    values_out[to] = value[r];
                }
            }
            if (has_next != 0u) {
                count_digit(to, (key[r] >> push.next_shift) & next_mask, valid, partition_shift);
            }
        }
    } else {
        // Thread t takes the keys t, t + 256, ... of the ordered partition: neighbours have the same digit, mostly, and write side by side.
        barrier(); // ranks were read
        [[unroll]] for (uint r = 0u; r < ROUNDS; r++) {
            if (first + r * size < present) {
                rank_rows[rank[r]] = key[r];
            }
        }
        barrier();
        uint to[SORT_ROUNDS];
        [[unroll]] for (uint r = 0u; r < ROUNDS; r++) {
            uint at = r * SORT_THREADS + d;
            uint ordered = at < present ? rank_rows[at] : 0u;
            to[r] = run_start[(ordered >> push.shift) & mask] + at;
            bool valid = at < present && to[r] < count;
            if (valid) {
                keys_out[to[r]] = ordered;
            }
            if (has_next != 0u) {
                count_digit(to[r], (ordered >> push.next_shift) & next_mask, valid, partition_shift);
            }
        }
        if (has_values != 0u) {
            barrier();
            [[unroll]] for (uint r = 0u; r < ROUNDS; r++) {
                if (first + r * size < present) {
                    rank_rows[rank[r]] = value[r];
                }
            }
            barrier();
            [[unroll]] for (uint r = 0u; r < ROUNDS; r++) {
                uint at = r * SORT_THREADS + d;
                if (at < present && to[r] < count) {
                    values_out[to[r]] = rank_rows[at];
                }
            }
        }
    }
}
