#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_vote : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_EXT_control_flow_attributes : require

// Stable compaction of the visible Gaussians into (depth key, index) pairs, 1,024 Gaussians per workgroup; also the
// histogram of the first depth digit. The first workgroup turns the totals into indirect dispatch arguments.

#include "lib/frame.glsl"
#include "lib/limits.glsl"
#include "lib/dispatch.glsl"
#include "lib/subgroup.glsl"

layout(local_size_x = 256) in;
layout(constant_id = 1) const uint DEPTH_BITS = 0; // of a key; 0: 32
layout(constant_id = 2) const uint PACKING = 0;    // see lib/splat.glsl

layout(std430, set = 0, binding = 1) readonly buffer TileCountBlock { uint tile_count[]; };
layout(std430, set = 0, binding = 2) readonly buffer SplatsBlock { uvec4 splats[]; };
layout(std430, set = 0, binding = 3) readonly buffer VisibleBlockBlock { uint visible_block[]; };
layout(std430, set = 0, binding = 4) buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 5) writeonly buffer IndirectBlock { uint indirect[]; };
layout(std430, set = 0, binding = 6) writeonly buffer KeysBlock { uint keys[]; };
layout(std430, set = 0, binding = 7) writeonly buffer ValuesBlock { uint values[]; };
layout(std430, set = 0, binding = 8) buffer NextHistogramBlock { uint next_histogram[]; };

#include "lib/count_digit.glsl"
#include "lib/splat.glsl"

layout(push_constant) uniform PushBlock {
    uint block_capacity; // where the super sums of visible_block start
    uint digit_bits;     // width of the first depth digit
    uint depth_partition_shift; // log2 of the keys of a partition of the depth sort
    uint tile_partition_shift;  // and of the tile sort
} push;

const uint ROUNDS = 4u;

// A positive float's bits grow with it. Fewer bits than 32 are spent on the range of depths that the frame may have: in
// steps of 2^shift units in the last place from its lowest one, which is exact as long as shift is 0.
uint depth_key(uint z) {
    uint bits = DEPTH_BITS;
    if (bits == 0u) {
        return z;
    }
    uint low = floatBitsToUint(frame.world_to_camera_0.w);
    uint shift = uint(frame.world_to_camera_1.w);
    return min((z - min(z, low)) >> shift, (1u << bits) - 1u);
}

// Visible Gaussians before block `first_block` (256 Gaussians each), summed by the workgroup.
uint visible_before(uint first_block) {
    uint super_block = first_block / SCAN_SUPER;
    uint thread = thread_index();
    uint block = super_block * SCAN_SUPER + thread;
    uint sum = block < min(first_block, push.block_capacity) ? visible_block[block] : 0u;
    uint supers = min(super_block, (push.block_capacity + SCAN_SUPER - 1u) / SCAN_SUPER);
    for (uint s = thread; s < supers; s += SCAN_SUPER) {
        sum += visible_block[push.block_capacity + s];
    }
    uint total;
    workgroup_exclusive_add(sum, total);
    return total;
}

// Group counts of dispatch d: depth sort, emit, tile sort, tile ranges; nothing runs in a failed frame.
void write_arguments(uint d, uint visible, uint instances) {
    uint items = d < 2u ? visible : instances;
    uint partition_shift = d < 2u ? push.depth_partition_shift : push.tile_partition_shift;
    uint per_group = 1u << ((d & 1u) == 0u ? partition_shift : 8u); // SCAN_BLOCK is 256
    uvec3 groups = folded_groups(items / per_group + (items % per_group == 0u ? 0u : 1u));
    indirect[4u * d] = groups.x;
    indirect[4u * d + 1u] = groups.y;
    indirect[4u * d + 2u] = groups.z;
    indirect[4u * d + 3u] = 0u;
}

void main() {
    uint group = workgroup_index();
    uint lane = gl_SubgroupInvocationID;
    uint size = SUBGROUP_SIZE;
    uint gaussians = frame.gaussians;

    // A subgroup takes ROUNDS consecutive runs of its size, so lane order is index order and the result is stable.
    uint first = group * (ROUNDS * SCAN_BLOCK) + gl_SubgroupID * (ROUNDS * size) + lane;
    uint offset[ROUNDS];
    uint flags = 0u;
    uint mine = 0u;
    [[unroll]] for (uint r = 0u; r < ROUNDS; r++) {
        uint i = first + r * size;
        bool visible = i < gaussians && tile_count[i] != 0u;
        uvec4 lanes = subgroupBallot(visible);
        offset[r] = mine + count_lanes_below(lanes, lane);
        flags |= visible ? 1u << r : 0u;
        mine += count_lanes(lanes);
    }
    uint before = visible_before(group * ROUNDS);
    uint total;
    uint scanned = workgroup_exclusive_add(lane == 0u ? mine : 0u, total);
    before += lane == 0u ? scanned : scanned - mine;

    [[unroll]] for (uint r = 0u; r < ROUNDS; r++) {
        uint i = first + r * size;
        bool visible = (flags & (1u << r)) != 0u;
        uint to = before + offset[r];
        uint key = 0u;
        if (visible) {
            key = depth_key(splats[splat_stride() * i + 1u].z);
            keys[to] = key;
            values[to] = i;
        }
        count_digit(to, key & ((1u << push.digit_bits) - 1u), visible, push.depth_partition_shift);
    }

    uint thread = thread_index();
    if (group == 0u && thread < 4u) {
        uint instances = atomicAdd(counters[COUNT_INSTANCES_LOW], 0u);
        // A step of training may have failed before it began, with the one before it.
        bool failed = atomicAdd(counters[COUNT_INSTANCES_HIGH], 0u) != 0u || instances > frame.instance_capacity
            || atomicOr(counters[COUNT_FAILED], 0u) != 0u;
        uint visible = failed ? 0u : atomicAdd(counters[COUNT_VISIBLE], 0u);
        instances = failed ? 0u : instances;
        write_arguments(thread, visible, instances);
        if (thread == 0u) {
            atomicExchange(counters[COUNT_INSTANCES], instances);
            atomicOr(counters[COUNT_FAILED], failed ? FAILED_INSTANCES : 0u);
        }
    }
}
