// Adds the rows of a Gaussian's instances, in slot order, into its row: together with the stores of blend_backward
// (ACCUMULATE 0) a sum without atomics that has the same bits on every run. Three threads per Gaussian, a vec4 each:
// neighbouring threads read neighbouring words.
#version 460
#extension GL_GOOGLE_include_directive : require

#include "lib/dispatch.glsl"
#include "lib/limits.glsl"

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;

layout(std430, set = 0, binding = 0) readonly buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 1) readonly buffer TileCountBlock { uint tile_count[]; };
layout(std430, set = 0, binding = 2) readonly buffer FirstSlotBlock { uint first_slot[]; };
layout(std430, set = 0, binding = 3) readonly buffer InstanceGradientBlock { vec4 instance_gradient[]; };
layout(std430, set = 0, binding = 4) writeonly buffer SplatGradientBlock { vec4 splat_gradient[]; };

layout(push_constant) uniform PushBlock {
    uint gaussians;
} push;

const uint ROW_PARTS = 3u; // vec4 per row

void main() {
    uint part = workgroup_index() * 256u + gl_LocalInvocationID.x;
    uint gaussian = part / ROW_PARTS;
    if (gaussian >= push.gaussians) {
        return;
    }
    vec4 sum = vec4(0.0);
    uint count = counters[COUNT_FAILED] == 0u ? tile_count[gaussian] : 0u;
    if (count != 0u) {
        // Never past the instances there are, whatever the counts say.
        uint instances = counters[COUNT_INSTANCES];
        uint first = min(first_slot[gaussian], instances);
        uint end = first + min(count, instances - first);
        uint column = part - ROW_PARTS * gaussian;
        for (uint slot = first; slot < end; slot++) {
            sum += instance_gradient[ROW_PARTS * slot + column];
        }
    }
    splat_gradient[part] = sum;
}
