#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_vote : require
#extension GL_EXT_control_flow_attributes : require

// Appends each visible Gaussian to the list of each tile that it reaches, as a pair (depth, instance). In what order a list then
// is, is left to chance; sort_tiles gives it the one that counts. A workgroup has 256 Gaussians. The tiles of those that reach few
// are found by a thread each; for the others the threads run over instances, not Gaussians, so that one that covers the whole
// image is spread over all threads. Where subgroups are wide, what a thread finds goes into a queue in shared memory, and the threads
// run over that too: no lane waits for the atomics of one with more tiles.
//
// An instance is the Gaussian and, beside it, the quadrants of the tile that it reaches, so that whoever walks a tile list need
// not look at its ellipse again.
//
// For training (WITH_SLOTS = 1) the pair has not the instance but its slot: the instances of all Gaussians numbered in the order
// of Gaussians, so that those of one follow one another. `gaussian_of_slot` leads back, `first_slot` says where a Gaussian's begin.

#include "lib/frame.glsl"
#include "lib/limits.glsl"
#include "lib/dispatch.glsl"
#include "lib/subgroup.glsl"

layout(local_size_x = 256) in;
layout(constant_id = 1) const uint WITH_SLOTS = 0;
layout(constant_id = 2) const uint ALPHA_CUT = 0; // these two: see lib/ellipse.glsl
layout(constant_id = 3) const uint TILE_CULL = 0;
layout(constant_id = 4) const uint PACKING = 0;   // see lib/splat.glsl

#include "lib/ellipse.glsl"
#include "lib/splat.glsl"

layout(std430, set = 0, binding = 1) readonly buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 2) readonly buffer TileCountBlock { uint tile_count[]; };
layout(std430, set = 0, binding = 3) readonly buffer SplatsBlock { uvec4 splats[]; };
layout(std430, set = 0, binding = 4) readonly buffer InstanceBlockBlock { uint instance_block[]; };
layout(std430, set = 0, binding = 5) readonly buffer TileStartBlock { uint tile_start[]; };
layout(std430, set = 0, binding = 6) writeonly buffer PairsBlock { uvec2 pairs[]; };
layout(std430, set = 0, binding = 7) buffer TileEndBlock { uint tile_end[]; };
layout(std430, set = 0, binding = 8) writeonly buffer GaussianOfSlotBlock { uint gaussian_of_slot[]; };
layout(std430, set = 0, binding = 9) writeonly buffer FirstSlotBlock { uint first_slot[]; };

layout(push_constant) uniform PushBlock {
    uint block_capacity; // where the super sums of instance_block start
} push;

const uint SERIAL_TILES = 16u; // most instances that one thread finds

// Where subgroups are narrow, lanes wait little for each other, and there is no queue.
const uint QUEUE_SUBGROUP = 16u;
// Its entries: the tile, the quadrants and the Gaussian of the block. An image of more tiles has no queue either.
const uint QUEUE_QUADRANT_SHIFT = 20u;
const uint QUEUE_THREAD_SHIFT = 24u;
const uint QUEUE_TILES = (1u << QUEUE_QUADRANT_SHIFT) - 1u;
const uint ALL_QUADRANTS = 15u;
const uint NO_INSTANCE = 0xffffffffu; // of the tile past those
const uint QUEUE_BATCH = 4u; // that a thread has under way at a time

shared uint queue[SCAN_BLOCK * SERIAL_TILES];
shared uint depth_of_block[SCAN_BLOCK]; // of each Gaussian of the queue
shared uint first_shared[SCAN_BLOCK]; // of each Gaussian, among the instances that all threads find
shared uint slot_of_block[SCAN_BLOCK]; // what the place of each Gaussian's instances, in the queue or among those, is to their slots

// Instances of the blocks before this one, summed by the workgroup.
uint instances_before(uint group) {
    uint super_block = group / SCAN_SUPER;
    uint thread = thread_index();
    uint block = super_block * SCAN_SUPER + thread;
    uint sum = block < min(group, push.block_capacity) ? instance_block[block] : 0u;
    uint supers = min(super_block, (push.block_capacity + SCAN_SUPER - 1u) / SCAN_SUPER);
    for (uint s = thread; s < supers; s += SCAN_SUPER) {
        sum += instance_block[push.block_capacity + s];
    }
    uint total;
    workgroup_exclusive_add(sum, total);
    return total;
}

// The ellipse of a Gaussian and the bits of its depth, which grow with it.
Ellipse ellipse_of(uint gaussian, out uint depth) {
    uint at = splat_stride() * gaussian;
    vec4 first;
    vec4 second;
    uvec4 b = splats[at + 1u];
    depth = b.z;
    unpack_splat(splats[at], b, first, second);
    return ellipse_of_splat(first, second);
}

// Gaussian of the block that has shared instance `instance`: the last one that starts at or before it, because those
// without shared instances start where the next one does.
uint owner(uint instance) {
    uint low = 0u;
    for (uint step = SCAN_BLOCK / 2u; step != 0u; step /= 2u) {
        low += first_shared[low + step] <= instance ? step : 0u;
    }
    return low;
}

// Should a list become longer than it was counted, what is too much is left out: its end, which counts all, is then past where the
// next one begins (sort_tiles).
void put(uint at, uint room_end, uint depth, uint instance, uint slot) {
    uint with_slots = WITH_SLOTS;
    if (with_slots == 1u) {
        gaussian_of_slot[slot] = instance;
    }
    if (at < room_end) {
        pairs[at] = uvec2(depth, with_slots == 1u ? slot : instance);
    }
}

void append(uint tile, uint depth, uint instance, uint slot) {
    uint at = atomicAdd(tile_end[tile * TILE_PITCH], 1u);
    put(at, tile_start[tile + 1u], depth, instance, slot);
}

// The places of a list's end are all asked for before the first is needed: an atomic answers after hundreds of cycles.
void append_queued(uint group, uint first, uint queue_total) {
    uint entry[QUEUE_BATCH];
    uint at[QUEUE_BATCH];
    uint room_end[QUEUE_BATCH];
    [[unroll]] for (uint i = 0u; i < QUEUE_BATCH; i++) {
        uint k = first + i * SCAN_BLOCK;
        entry[i] = k < queue_total ? queue[k] : NO_INSTANCE;
        uint tile = entry[i] & QUEUE_TILES;
        at[i] = NO_INSTANCE;
        room_end[i] = 0u;
        if (entry[i] != NO_INSTANCE) {
            at[i] = atomicAdd(tile_end[tile * TILE_PITCH], 1u);
            room_end[i] = tile_start[tile + 1u];
        }
    }
    [[unroll]] for (uint i = 0u; i < QUEUE_BATCH; i++) {
        if (entry[i] != NO_INSTANCE) {
            uint from = entry[i] >> QUEUE_THREAD_SHIFT;
            uint quadrants = entry[i] >> QUEUE_QUADRANT_SHIFT & ALL_QUADRANTS;
            uint instance = group * SCAN_BLOCK + from | quadrants << INSTANCE_QUADRANT_SHIFT;
            put(at[i], room_end[i], depth_of_block[from], instance, slot_of_block[from] + first + i * SCAN_BLOCK);
        }
    }
}

bool has_queue() {
    uint size = SUBGROUP_SIZE;
    return size >= QUEUE_SUBGROUP && frame.tile_count <= QUEUE_TILES;
}

// The `count` instances of one Gaussian, row by row: into the queue from `at` on, or straight into their lists, as slots from `at` on.
void emit_serially(uint thread, uint gaussian, uint count, uint at) {
    bool queued = has_queue();
    uint depth;
    Ellipse e = ellipse_of(gaussian, depth);
    depth_of_block[thread] = depth;
    Extent extent = extent_of(e);
    uvec2 rows = tile_row_range(e, frame.size);
    uint end = at + count;
    for (uint row = rows.x; row < rows.y; row++) {
        uvec2 columns = tile_columns_of_row(e, extent, row, frame.size);
        vec4 half_rows = half_rows_of_tile_row(e, extent, row);
        for (uint column = columns.x; column < columns.y && at < end; column++) {
            uint tile = row * frame.tiles.x + column;
            uint quadrants = quadrants_of_tile(half_rows, column);
            if (queued) {
                queue[at] = tile | quadrants << QUEUE_QUADRANT_SHIFT | thread << QUEUE_THREAD_SHIFT;
            } else {
                append(tile, depth, gaussian | quadrants << INSTANCE_QUADRANT_SHIFT, at);
            }
            at++;
        }
    }
    // The count may have promised more than there are.
    for (; queued && at < end; at++) {
        queue[at] = NO_INSTANCE;
    }
}

// Instance k of a Gaussian, its tiles in row-major order; none when the count promised more than there are.
void emit_one(uint gaussian, uint k, uint slot) {
    uint depth;
    Ellipse e = ellipse_of(gaussian, depth);
    Extent extent = extent_of(e);
    uvec2 rows = tile_row_range(e, frame.size);
    uint row = rows.x;
    uint column = 0u;
    for (; row < rows.y; row++) {
        uvec2 columns = tile_columns_of_row(e, extent, row, frame.size);
        uint n = columns.y - columns.x;
        column = columns.x + k;
        if (k < n) {
            break;
        }
        k -= n;
    }
    if (row < rows.y) {
        uint quadrants = quadrants_of_tile(half_rows_of_tile_row(e, extent, row), column);
        append(row * frame.tiles.x + column, depth, gaussian | quadrants << INSTANCE_QUADRANT_SHIFT, slot);
    }
}

void main() {
    uint group = workgroup_index();
    uint t = thread_index();
    uint with_slots = WITH_SLOTS;
    uint gaussians = counters[COUNT_FAILED] == 0u ? frame.gaussians : 0u;
    uint g = group * SCAN_BLOCK + t;
    uint count = g < gaussians ? tile_count[g] : 0u;
    bool serial = count <= SERIAL_TILES;
    uint slot = 0u;
    if (with_slots == 1u) {
        uint base = instances_before(group);
        uint total;
        slot = base + workgroup_exclusive_add(count, total);
        if (count != 0u) {
            first_slot[g] = slot;
        }
    }
    uint queue_total = 0u;
    uint in_queue = 0u;
    bool queued = has_queue();
    if (queued) {
        in_queue = workgroup_exclusive_add(serial ? count : 0u, queue_total);
    }
    uint shared_total;
    uint in_shared = workgroup_exclusive_add(serial ? 0u : count, shared_total);
    first_shared[t] = in_shared;
    slot_of_block[t] = slot - (serial ? in_queue : in_shared);
    if (serial && count != 0u) {
        emit_serially(t, g, count, queued ? in_queue : slot);
    }
    barrier();

    for (uint first = t; first < queue_total; first += SCAN_BLOCK * QUEUE_BATCH) {
        append_queued(group, first, queue_total);
    }
    for (uint k = t; k < shared_total; k += SCAN_BLOCK) {
        uint from = owner(k);
        emit_one(group * SCAN_BLOCK + from, k - first_shared[from], slot_of_block[from] + k);
    }
}
