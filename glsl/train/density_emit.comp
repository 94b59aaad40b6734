#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_vote : require

// Where each new row comes from: old row and kind, in the order of the old rows.

#include "lib/dispatch.glsl"
#include "lib/subgroup.glsl"
#include "lib/density.glsl"

layout(local_size_x = 256) in;

layout(std430, set = 0, binding = 0) readonly buffer ActionBlock { uint action[]; };
layout(std430, set = 0, binding = 1) readonly buffer RowBlockBlock { uint row_block[]; };
layout(std430, set = 0, binding = 2) writeonly buffer SourceBlock { uint source[]; };

layout(push_constant) uniform PushBlock {
    uint gaussians;
    uint rows; // of source
} push;

void main() {
    uint group = workgroup_index();
    uint i = group * SCAN_THREADS + thread_index();
    uint what = i < push.gaussians ? action[i] : ACTION_PRUNE;
    uint count = rows_of_action(what);
    uint total;
    uint to = workgroup_exclusive_add(count, total);
    if (count != 0u) {
        to += row_block[group];
        uint kind = what == ACTION_SPLIT ? KIND_CHILD_0 : KIND_KEPT;
        if (to < push.rows) {
            source[to] = i | (kind << 30u);
        }
        if (count == 2u && to + 1u < push.rows) {
            kind = what == ACTION_SPLIT ? KIND_CHILD_1 : KIND_CLONE;
            source[to + 1u] = i | (kind << 30u);
        }
    }
}
