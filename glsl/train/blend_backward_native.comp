// Backward of `blend` with the device's own float atomics (a module of its own, because it needs their capability): see
// lib/blend_backward.glsl.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_vote : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_EXT_shader_atomic_float : require

#include "lib/blend_backward.glsl"

layout(std430, set = 0, binding = 7) buffer GradientRowsBlock { float gradient_rows[]; };

void add_to_row(uint at, float value) {
    atomicAdd(gradient_rows[at], value);
}
