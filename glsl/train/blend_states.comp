// `blend` for training that also stores each pixel's state where a segment of its tile's list begins, from which
// `blend_backward` goes on; see lib/blend_tile.glsl.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_vote : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_EXT_control_flow_attributes : require

layout(local_size_x = 128) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint STAGE = 1;
layout(constant_id = 2) const uint PIXELS_PER_LANE = 2; // at most 16
layout(constant_id = 3) const uint WITH_SLOTS = 0;      // values are slots, as emit_tiles writes them for training
layout(constant_id = 4) const uint SEGMENTS = 2;        // see lib/segments.glsl
layout(constant_id = 5) const uint LEAST_SEGMENT = 256;
// Training always draws exactly, and no depth.
const uint WITH_DEPTH = 0u;
const uint ALPHA_CUT = 0u;
const uint TRANSMITTANCE_STOP = 0u;
const uint PACKING = 0u;
const uint TILE_CULL = 0u;

#include "lib/frame.glsl"
#include "lib/dispatch.glsl"
#include "lib/limits.glsl"
#include "lib/ellipse.glsl"
#include "lib/blend.glsl"
#include "lib/splat.glsl"

layout(std430, set = 0, binding = 1) readonly buffer RangesBlock { uint ranges[]; };
layout(std430, set = 0, binding = 2) readonly buffer ValuesBlock { uint values[]; };
layout(std430, set = 0, binding = 3) readonly buffer SplatsBlock { uvec4 splats[]; };
layout(std430, set = 0, binding = 4) writeonly buffer ColorBlock { vec4 color[]; };
layout(std430, set = 0, binding = 5) readonly buffer GaussianOfSlotBlock { uint gaussian_of_slot[]; };
layout(std430, set = 0, binding = 6) writeonly buffer StatesBlock { vec4 states[]; };

#define BLEND_STATES
#include "lib/blend_tile.glsl"

void store_pixel(uvec2 pixel, uint at, vec4 value) {
    color[at] = value;
}

void store_state(uint at, vec4 state) {
    states[at] = state;
}
