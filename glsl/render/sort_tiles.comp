#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_vote : require
#extension GL_EXT_control_flow_attributes : require

// Brings the list of each tile into the order in which it is blended: by depth, ties by Gaussian. A workgroup per tile, in
// shared memory:
//
// - A list of at most CAPACITY pairs goes into buckets by its depths, whose range they divide evenly; where a pair goes within
//   its bucket follows from a look at the others there, of which there are two or so.
// - Depths that lie so close that a bucket is full make it a bitonic sort instead.
// - A longer list is first cut into parts that are as long as that, at SPLITTERS pairs of it that are sorted: those lie as dense
//   as the list does. Until a part has its order, `values` says where its pairs are.
//
// It also says in `ranges` where each list begins and ends, side by side: the ends that emit_tiles moves lie apart (TILE_PITCH).
// Lists with room of one size (frame.tile_room) are all empty where one had too little of it.
//
// The order does not depend on that of the list, which is chance: no two pairs are equal.

#include "lib/frame.glsl"
#include "lib/dispatch.glsl"
#include "lib/limits.glsl"

layout(local_size_x = 256) in;
layout(constant_id = 1) const uint TIE_MASK = 0xffffffffu; // bits of a pair's second word that stand for the Gaussian
layout(constant_id = 2) const uint THREADS = 256; // of a workgroup
layout(constant_id = 3) const uint SHORTEST = 1;          // pairs of a list that is sorted here
layout(constant_id = 4) const uint LONGEST = 0xffffffffu; // the same
layout(constant_id = 5) const uint AT_ONCE = 4; // loads of a thread that are on their way together, at most MOST_AT_ONCE

#define SCAN_THREADS THREADS
#include "lib/subgroup.glsl"

layout(std430, set = 0, binding = 1) readonly buffer TileStartBlock { uint tile_start[]; };
layout(std430, set = 0, binding = 2) readonly buffer PairsBlock { uvec2 pairs[]; };
layout(std430, set = 0, binding = 3) coherent buffer ValuesBlock { uint values[]; };
layout(std430, set = 0, binding = 4) readonly buffer TileEndBlock { uint tile_end[]; };
layout(std430, set = 0, binding = 5) writeonly buffer RangesBlock { uvec2 ranges[]; };
layout(std430, set = 0, binding = 6) readonly buffer CountersBlock { uint counters[]; };

const uint CAPACITY = 2048u;
const uint MAX_BUCKETS = 1024u;
const uint FULL_BUCKET = 256u; // past that many pairs in a bucket, looking at all the others is no longer cheap
const uint SPLITTERS = 128u;
const uint MOST_AT_ONCE = 4u;

shared uint depth_at[CAPACITY];
shared uint value_at[CAPACITY];
shared uint bucket_end[MAX_BUCKETS]; // first the pairs of each, then where it begins, at last where it ends
shared uint part_end[SPLITTERS + 1u];
shared uint lowest;
shared uint highest;
shared uint some_is_full;

bool is_before(uvec2 a, uvec2 b) {
    uint mask = TIE_MASK;
    bool tie = (a.y & mask) < (b.y & mask);
    bool less = a.x < b.x;
    return a.x == b.x ? tie : less;
}

// Pairs i, i + THREADS, … of the part at `part` of the list at `list`, the last one for those past its end: loads that wait for each
// other once. cut: the list was cut into parts.
void load_pairs(uint list, uint part, bool cut, uint i, uint n, out uvec2 pair[MOST_AT_ONCE]) {
    uint threads = THREADS;
    uint at[MOST_AT_ONCE];
    [[unroll]] for (uint r = 0u; r < AT_ONCE; r++) {
        at[r] = part + min(i + r * threads, n - 1u);
    }
    if (cut) {
        [[unroll]] for (uint r = 0u; r < AT_ONCE; r++) {
            at[r] = list + values[at[r]];
        }
    }
    [[unroll]] for (uint r = 0u; r < AT_ONCE; r++) {
        pair[r] = pairs[at[r]];
    }
}

// Grows with the distance to the lowest depth, whatever the rounding.
uint bucket_of(uint distance, float scale, uint buckets) {
    precise float at = float(distance) * scale;
    return min(uint(at), buckets - 1u);
}

// From the pairs of each bucket to where it begins, and whether one is full.
void scan_buckets(uint buckets) {
    uint threads = THREADS;
    uint per_thread = buckets / threads;
    uint first = thread_index() * per_thread;
    uint sum = 0u;
    uint most = 0u;
    for (uint b = first; b < first + per_thread; b++) {
        uint n = bucket_end[b];
        sum += n;
        most = max(most, n);
    }
    uint total;
    uint begin = workgroup_exclusive_add(sum, total);
    for (uint b = first; b < first + per_thread; b++) {
        uint n = bucket_end[b];
        bucket_end[b] = begin;
        begin += n;
    }
    if (subgroupAny(most > FULL_BUCKET) && gl_SubgroupInvocationID == 0u) {
        atomicOr(some_is_full, 1u);
    }
    barrier();
}

void clear_buckets(uint buckets) {
    uint threads = THREADS;
    uint t = thread_index();
    barrier();
    for (uint b = t; b < buckets; b += threads) {
        bucket_end[b] = 0u;
    }
    if (t == 0u) {
        lowest = 0xffffffffu;
        highest = 0u;
        some_is_full = 0u;
    }
    barrier();
}

// Exchanges the pairs in shared memory that are in the wrong order, of a bitonic network that always puts the smaller one first:
// its first step of each length compares from both ends, and what would lie past n stays there.
void sort_bitonic(uint n) {
    uint threads = THREADS;
    for (uint length = 2u; length < 2u * n; length *= 2u) {
        for (uint stride = length / 2u; stride != 0u; stride /= 2u) {
            barrier();
            uint mirror = stride == length / 2u ? length - 1u : stride;
            uint comparisons = (n + 2u * stride - 1u) / (2u * stride) * stride;
            for (uint k = thread_index(); k < comparisons; k += threads) {
                uint i = 2u * k - (k & (stride - 1u));
                uint j = i ^ mirror;
                if (j < n) {
                    uvec2 a = uvec2(depth_at[i], value_at[i]);
                    uvec2 b = uvec2(depth_at[j], value_at[j]);
                    if (is_before(b, a)) {
                        depth_at[i] = b.x;
                        value_at[i] = b.y;
                        depth_at[j] = a.x;
                        value_at[j] = a.y;
                    }
                }
            }
        }
    }
    barrier();
}

// The same in `values`, which say where the pairs are: for a part that did not come out short enough.
void sort_in_memory(uint list, uint part, uint n) {
    uint threads = THREADS;
    for (uint length = 2u; length < 2u * n; length *= 2u) {
        for (uint stride = length / 2u; stride != 0u; stride /= 2u) {
            memoryBarrierBuffer();
            barrier();
            uint mirror = stride == length / 2u ? length - 1u : stride;
            uint comparisons = (n + 2u * stride - 1u) / (2u * stride) * stride;
            for (uint k = thread_index(); k < comparisons; k += threads) {
                uint i = 2u * k - (k & (stride - 1u));
                uint j = i ^ mirror;
                if (j < n) {
                    uint a = values[part + i];
                    uint b = values[part + j];
                    if (is_before(pairs[list + b], pairs[list + a])) {
                        values[part + i] = b;
                        values[part + j] = a;
                    }
                }
            }
        }
    }
    memoryBarrierBuffer();
    barrier();
    for (uint i = thread_index(); i < n; i += threads) {
        values[part + i] = pairs[list + values[part + i]].y;
    }
}

// A part of at most CAPACITY pairs.
void sort_part(uint list, uint part, uint n, bool cut) {
    uint threads = THREADS;
    uint t = thread_index();
    // One for each pair, more or less: a power of two, and one for each thread at least.
    uint buckets = 1u << uint(findMSB(min(max(2u * n - 1u, threads), MAX_BUCKETS)));
    clear_buckets(buckets);
    uint low = 0xffffffffu;
    uint high = 0u;
    uint at_once = AT_ONCE;
    uvec2 pair[MOST_AT_ONCE];
    // Most lists are so short that threads keep their pairs; those of a longer one come from memory three times.
    bool kept = n <= at_once * threads;
    if (kept) {
        load_pairs(list, part, cut, t, n, pair);
    }
    for (uint first = t; first < n; first += at_once * threads) {
        if (!kept) {
            load_pairs(list, part, cut, first, n, pair);
        }
        [[unroll]] for (uint r = 0u; r < AT_ONCE; r++) {
            bool present = first + r * threads < n;
            low = min(low, present ? pair[r].x : low);
            high = max(high, present ? pair[r].x : high);
        }
    }
    low = subgroupMin(low);
    high = subgroupMax(high);
    if (gl_SubgroupInvocationID == 0u) {
        atomicMin(lowest, low);
        atomicMax(highest, high);
    }
    barrier();
    low = lowest;
    precise float scale = float(buckets) / (float(max(highest, low) - low) + 1.0);
    for (uint first = t; first < n; first += at_once * threads) {
        if (!kept) {
            load_pairs(list, part, cut, first, n, pair);
        }
        [[unroll]] for (uint r = 0u; r < AT_ONCE; r++) {
            if (first + r * threads < n) {
                atomicAdd(bucket_end[bucket_of(pair[r].x - low, scale, buckets)], 1u);
            }
        }
    }
    barrier();
    scan_buckets(buckets);
    for (uint first = t; first < n; first += at_once * threads) {
        if (!kept) {
            load_pairs(list, part, cut, first, n, pair);
        }
        [[unroll]] for (uint r = 0u; r < AT_ONCE; r++) {
            if (first + r * threads < n) {
                uint at = atomicAdd(bucket_end[bucket_of(pair[r].x - low, scale, buckets)], 1u);
                depth_at[at] = pair[r].x;
                value_at[at] = pair[r].y;
            }
        }
    }
    // What `values` said before this part has its order is read no more.
    if (cut) {
        memoryBarrierBuffer();
    }
    barrier();
    if (some_is_full != 0u) {
        sort_bitonic(n);
        for (uint i = t; i < n; i += threads) {
            values[part + i] = value_at[i];
        }
    } else {
        for (uint i = t; i < n; i += threads) {
            uvec2 own = uvec2(depth_at[i], value_at[i]);
            uint bucket = bucket_of(own.x - low, scale, buckets);
            uint rank = bucket == 0u ? 0u : bucket_end[bucket - 1u];
            uint end = bucket_end[bucket];
            for (uint j = rank; j < end; j++) {
                rank += is_before(uvec2(depth_at[j], value_at[j]), own) ? 1u : 0u;
            }
            values[part + rank] = own.y;
        }
    }
}

// Splitters that are not after a pair.
uint part_of(uvec2 pair) {
    uint low = 0u;
    [[unroll]] for (uint step = SPLITTERS; step != 0u; step /= 2u) {
        uint at = min(low + step, SPLITTERS);
        low = is_before(pair, uvec2(depth_at[at - 1u], value_at[at - 1u])) ? low : at;
    }
    return low;
}

// Cuts a list into SPLITTERS + 1 parts, some of them empty.
void cut_list(uint list, uint n) {
    uint threads = THREADS;
    uint t = thread_index();
    clear_buckets(MAX_BUCKETS);
    for (uint i = t; i < SPLITTERS; i += threads) {
        uvec2 pair = pairs[list + i * (n / SPLITTERS)];
        depth_at[i] = pair.x;
        value_at[i] = pair.y;
    }
    sort_bitonic(SPLITTERS);
    for (uint i = t; i < n; i += threads) {
        atomicAdd(bucket_end[part_of(pairs[list + i])], 1u);
    }
    barrier();
    scan_buckets(MAX_BUCKETS);
    for (uint i = t; i < n; i += threads) {
        values[list + atomicAdd(bucket_end[part_of(pairs[list + i])], 1u)] = i;
    }
    memoryBarrierBuffer();
    barrier();
    for (uint i = t; i <= SPLITTERS; i += threads) {
        part_end[i] = bucket_end[i];
    }
    barrier();
}

// Where the list of a tile begins and ends. What emit_tiles had too much for the room of the list was left out.
uvec2 range_of_list(uint tile) {
    uint room = frame.tile_room;
    uint end = tile_end[tile * TILE_PITCH];
    uvec2 range;
    if (room == 0u) {
        range = uvec2(tile_start[tile], min(end, tile_start[tile + 1u]));
    } else {
        uint n = counters[COUNT_FAILED] == 0u ? min(end, room) : 0u;
        range = uvec2(tile * room, tile * room + n);
    }
    return range;
}

void main() {
    uint tile = workgroup_index();
    uint list = 0u;
    uint n = 0u;
    if (tile < frame.tile_count) {
        uvec2 range = range_of_list(tile);
        list = range.x;
        n = range.y - range.x;
        if (thread_index() == 0u) {
            ranges[tile] = range;
        }
    }
    uint shortest = SHORTEST;
    uint longest = LONGEST;
    n = n >= shortest && n <= longest ? n : 0u;
    if (n <= CAPACITY) {
        if (n != 0u) {
            sort_part(list, list, n, false);
        }
    } else {
        cut_list(list, n);
        uint begin = 0u;
        uint p = 0u;
        while (begin < n) {
            // As many parts at once as fit, but one at least.
            uint end = begin;
            for (; p <= SPLITTERS; p++) {
                uint next = part_end[p];
                if (next - begin > CAPACITY && end > begin) {
                    break;
                }
                end = next;
            }
            if (end - begin <= CAPACITY) {
                sort_part(list, list + begin, end - begin, true);
            } else {
                sort_in_memory(list, list + begin, end - begin);
            }
            begin = end;
        }
    }
}
