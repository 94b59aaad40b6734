#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_vote : require
#extension GL_EXT_control_flow_attributes : require

// Appends each visible Gaussian to the list of each tile that it reaches, where scan_tiles says that it lies (lib/tile_lists.glsl).
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

uvec2 room_of_list(uint tile) {
    return uvec2(0u, tile_start[tile + 1u]);
}

// Should a list become longer than it was counted, what is too much is left out: its end, which counts all, is then past where the
// next one begins (sort_tiles).
void put(uint at, uvec2 room, uint depth, uint instance, uint slot) {
    uint with_slots = WITH_SLOTS;
    if (with_slots == 1u) {
        gaussian_of_slot[slot] = instance;
    }
    if (at < room.y) {
        pairs[at] = uvec2(depth, with_slots == 1u ? slot : instance);
    }
}

#include "lib/tile_lists.glsl"

void main() {
    uint group = workgroup_index();
    uint t = thread_index();
    uint with_slots = WITH_SLOTS;
    uint gaussians = counters[COUNT_FAILED] == 0u ? frame.gaussians : 0u;
    uint g = group * SCAN_BLOCK + t;
    uint count = g < gaussians ? tile_count[g] : 0u;
    uint slot = 0u;
    if (with_slots == 1u) {
        uint base = instances_before(group);
        uint total;
        slot = base + workgroup_exclusive_add(count, total);
        if (count != 0u) {
            first_slot[g] = slot;
        }
    }
    uint depth = 0u;
    Ellipse e;
    if (count != 0u) {
        e = ellipse_of(g, depth);
    }
    append_block(group, t, g, count, e, depth, slot);
}
