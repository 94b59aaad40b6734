// Backward of `blend` without float atomics: see lib/blend_backward.glsl. ACCUMULATE 0: rows of instances, each written once;
// 2: rows of Gaussians, added by compare-and-swap.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_vote : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_memory_scope_semantics : require

#include "lib/blend_backward.glsl"

layout(std430, set = 0, binding = 7) buffer GradientRowsBlock { uint gradient_rows[]; };

const uint MAX_TRIES = 65536u; // each failure is the success of another subgroup

void add_to_row(uint at, float value) {
    uint accumulate = ACCUMULATE;
    if (accumulate == 0u) {
        gradient_rows[at] = floatBitsToUint(value);
    } else {
        // Others update the word: a plain load would race with them.
        uint expected = atomicLoad(gradient_rows[at], gl_ScopeDevice, gl_StorageSemanticsBuffer, gl_SemanticsRelaxed);
        for (uint tries = 0u; tries < MAX_TRIES; tries++) {
            uint found = atomicCompSwap(gradient_rows[at], expected, floatBitsToUint(uintBitsToFloat(expected) + value));
            if (found == expected) {
                break;
            }
            expected = found;
        }
    }
}
