#version 460
#extension GL_GOOGLE_include_directive : require

// Copies rows of an array of 32-bit words to their new places: word plane * rows * width + row * width + component.

#include "lib/dispatch.glsl"
#include "lib/density.glsl"

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

layout(std430, set = 0, binding = 0) readonly buffer SourceBlock { uint source[]; };
layout(std430, set = 0, binding = 1) readonly buffer OldRowsBlock { uint old_rows[]; };
layout(std430, set = 0, binding = 2) writeonly buffer NewRowsBlock { uint new_rows[]; };

layout(push_constant) uniform PushBlock {
    uint old_count;
    uint new_count;
    uint planes;
    uint width;
    uint zero_new; // 1: rows of clones and children become 0
} push;

void main() {
    uint word = workgroup_index() * 256u + gl_LocalInvocationID.x;
    uint new_stride = push.new_count * push.width;
    if (word < new_stride) {
        uint row = word / push.width;
        uint s = source[row];
        bool zero = push.zero_new == 1u && (s >> 30u) != KIND_KEPT;
        uint from = (s & SOURCE_ROW) * push.width + (word - row * push.width);
        uint old_stride = push.old_count * push.width;
        for (uint plane = 0u; plane < push.planes; plane++) {
            uint value = zero ? 0u : old_rows[plane * old_stride + from];
            new_rows[plane * new_stride + word] = value;
        }
    }
}
