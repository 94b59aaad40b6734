#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_vote : require
#extension GL_KHR_shader_subgroup_shuffle : require

// Writes one (tile, Gaussian) pair for each tile that a visible Gaussian reaches, in depth order, and counts the first
// digit of the tile ids. A workgroup has 256 depth-sorted Gaussians. Those that reach few tiles are written by a thread
// each; for the others the threads run over instances, not Gaussians, so that one that covers the whole image is spread
// over all threads.
//
// Beside the Gaussian stand the quadrants of the tile that it reaches, so that whoever walks a tile list need not look at its
// ellipse again.
//
// For training (WITH_SLOTS = 1) the sorted value is not the Gaussian but the slot: the position in this order, in which the
// instances of a Gaussian follow one another. `gaussian_of_slot` leads back, `first_slot` says where a Gaussian's begin.

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
layout(std430, set = 0, binding = 3) readonly buffer OrderBlock { uint order[]; };
layout(std430, set = 0, binding = 4) readonly buffer SplatsBlock { uvec4 splats[]; };
layout(std430, set = 0, binding = 5) readonly buffer InstanceBlockBlock { uint instance_block[]; };
layout(std430, set = 0, binding = 6) writeonly buffer KeysBlock { uint keys[]; };
layout(std430, set = 0, binding = 7) writeonly buffer ValuesBlock { uint values[]; };
layout(std430, set = 0, binding = 8) buffer NextHistogramBlock { uint next_histogram[]; };
layout(std430, set = 0, binding = 9) writeonly buffer GaussianOfSlotBlock { uint gaussian_of_slot[]; };
layout(std430, set = 0, binding = 10) writeonly buffer FirstSlotBlock { uint first_slot[]; };

#include "lib/count_digit.glsl"

layout(push_constant) uniform PushBlock {
    uint block_capacity; // where the super sums of instance_block start
    uint digit_bits;     // width of the first tile digit
    uint partition_shift; // log2 of the keys of a partition of the tile sort
} push;

const uint SERIAL_TILES = 16u; // most instances that one thread writes

shared uint first_instance[SCAN_BLOCK]; // of each Gaussian, where it goes
shared uint first_shared[SCAN_BLOCK];   // of each Gaussian, among the instances that all threads share
shared uint block_order[SCAN_BLOCK];

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

Ellipse ellipse_of(uint gaussian) {
    uint at = splat_stride() * gaussian;
    vec4 first;
    vec4 second;
    unpack_splat(splats[at], splats[at + 1u], first, second);
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

// instance: the Gaussian and the quadrants that it reaches.
void emit(uint to, uint tile, uint instance, bool valid) {
    uint with_slots = WITH_SLOTS;
    if (valid) {
        keys[to] = tile;
        if (with_slots == 1u) {
            values[to] = to;
            gaussian_of_slot[to] = instance;
        } else {
            values[to] = instance;
        }
    }
    count_digit(to, tile & ((1u << push.digit_bits) - 1u), valid, push.partition_shift);
}

// The `count` instances of one Gaussian for each thread, row by row and padded where the count promised more than there
// are. Every lane of the subgroup must call it: the loops have the length of the longest lane, so that digits can be
// counted together.
void emit_serially(uint to, uint gaussian, uint count, uint capacity) {
    Ellipse e = ellipse_of(gaussian);
    Extent extent = extent_of(e);
    uvec2 rows = count == 0u ? uvec2(0u) : tile_row_range(e, frame.size);
    uint end = min(to + count, capacity);
    uint most_rows = subgroupMax(rows.y - rows.x);
    for (uint r = 0u; r < most_rows; r++) {
        uint row = rows.x + r;
        uvec2 columns = row < rows.y ? tile_columns_of_row(e, extent, row, frame.size) : uvec2(0u);
        vec4 half_rows = half_rows_of_tile_row(e, extent, row);
        uint most_columns = subgroupMax(columns.y - columns.x);
        for (uint c = 0u; c < most_columns; c++) {
            uint column = columns.x + c;
            bool in_row = column < columns.y;
            bool valid = in_row && to < end;
            uint instance = gaussian | quadrants_of_tile(half_rows, column) << INSTANCE_QUADRANT_SHIFT;
            emit(to, row * frame.tiles.x + column, instance, valid);
            to += valid ? 1u : 0u;
        }
    }
    uint most_left = subgroupMax(max(end, to) - to);
    for (uint k = 0u; k < most_left; k++) {
        emit(to + k, frame.tile_count, gaussian, to + k < end);
    }
}

// Tile number k of an ellipse in row-major order, and its quadrants; one past the last tile when the count promised more than
// there are.
uint tile_of(Ellipse e, uint k, out uint quadrants) {
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
    bool found = row < rows.y;
    quadrants = found ? quadrants_of_tile(half_rows_of_tile_row(e, extent, row), column) : 0u;
    return found ? row * frame.tiles.x + column : frame.tile_count;
}

void main() {
    uint group = workgroup_index();
    uint t = thread_index();
    uint visible = counters[COUNT_FAILED] == 0u ? counters[COUNT_VISIBLE] : 0u;
    uint capacity = min(counters[COUNT_INSTANCES], frame.instance_capacity);
    uint i = group * SCAN_BLOCK + t;
    uint gaussian = i < visible ? order[i] : 0u;
    uint base = instances_before(group);
    uint count = i < visible ? tile_count[gaussian] : 0u;
    bool serial = count <= SERIAL_TILES;
    uint total;
    uint to = base + workgroup_exclusive_add(count, total);
    uint shared_total;
    first_instance[t] = to;
    first_shared[t] = workgroup_exclusive_add(serial ? 0u : count, shared_total);
    block_order[t] = gaussian;
    uint with_slots = WITH_SLOTS;
    if (with_slots == 1u && i < visible) {
        first_slot[gaussian] = to;
    }
    barrier();

    emit_serially(to, gaussian, serial ? count : 0u, capacity);
    uint rounds = shared_total / SCAN_BLOCK + (shared_total % SCAN_BLOCK == 0u ? 0u : 1u);
    for (uint r = 0u; r < rounds; r++) {
        uint k = r * SCAN_BLOCK + t;
        uint from = k < shared_total ? owner(k) : 0u;
        uint local = k - first_shared[from];
        to = first_instance[from] + local;
        bool valid = k < shared_total && to < capacity;
        uint tile = 0u;
        uint quadrants = 0u;
        uint g = block_order[from];
        if (valid) {
            tile = tile_of(ellipse_of(g), local, quadrants);
        }
        emit(to, tile, g | quadrants << INSTANCE_QUADRANT_SHIFT, valid);
    }
}
