#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_vote : require

// Exclusive prefix sum of row_block, in place. One workgroup.

#include "lib/subgroup.glsl"

layout(local_size_x = 256) in;

layout(std430, set = 0, binding = 0) buffer RowBlockBlock { uint row_block[]; };

layout(push_constant) uniform PushBlock {
    uint blocks;
} push;

void main() {
    uint carry = 0u;
    uint thread = thread_index();
    for (uint first = 0u; first < push.blocks; first += SCAN_THREADS) {
        uint i = first + thread;
        uint value = i < push.blocks ? row_block[i] : 0u;
        uint total;
        uint before = workgroup_exclusive_add(value, total);
        if (i < push.blocks) {
            row_block[i] = carry + before;
        }
        carry += total;
    }
}
