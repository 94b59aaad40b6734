#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_arithmetic : require

// Tile instances of each block of 256 depth-sorted Gaussians, and of each 256 blocks: where emit_tiles starts writing.

#include "lib/limits.glsl"
#include "lib/dispatch.glsl"
#include "lib/subgroup.glsl"

layout(local_size_x = 256) in;

layout(std430, set = 0, binding = 0) readonly buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 1) readonly buffer TileCountBlock { uint tile_count[]; };
layout(std430, set = 0, binding = 2) readonly buffer OrderBlock { uint order[]; };
layout(std430, set = 0, binding = 3) buffer InstanceBlockBlock { uint instance_block[]; };

layout(push_constant) uniform PushBlock {
    uint block_capacity; // where the super sums of instance_block start
} push;

void main() {
    uint group = workgroup_index();
    uint visible = counters[COUNT_FAILED] == 0u ? counters[COUNT_VISIBLE] : 0u;
    uint thread = thread_index();
    uint i = group * SCAN_BLOCK + thread;
    uint total;
    workgroup_exclusive_add(i < visible ? tile_count[order[i]] : 0u, total);
    if (thread == 0u && i < visible) {
        atomicExchange(instance_block[group], total);
        atomicAdd(instance_block[push.block_capacity + group / SCAN_SUPER], total);
    }
}
