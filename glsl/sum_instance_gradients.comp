// Adds the rows of a Gaussian's instances, in slot order, into its row: together with the stores of blend_backward
// (ACCUMULATE 0) a sum without atomics that has the same bits on every run. A thread per word of the result: neighbouring
// threads read neighbouring words. Twin: engine/src/train/blend_backward.rs.
#version 460
#extension GL_GOOGLE_include_directive : require

#include "lib/dispatch.glsl"
#include "lib/limits.glsl"

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;

layout(std430, set = 0, binding = 0) readonly buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 1) readonly buffer TileCountBlock { uint tile_count[]; };
layout(std430, set = 0, binding = 2) readonly buffer FirstSlotBlock { uint first_slot[]; };
layout(std430, set = 0, binding = 3) readonly buffer InstanceGradientBlock { float instance_gradient[]; };
layout(std430, set = 0, binding = 4) writeonly buffer SplatGradientBlock { float splat_gradient[]; };

layout(push_constant) uniform PushBlock {
    uint gaussians;
} push;

const uint ROW = 12u;

void main() {
    uint word = workgroup_index() * 256u + gl_LocalInvocationID.x;
    uint gaussian = word / ROW;
    if (gaussian >= push.gaussians) {
        return;
    }
    uint count = counters[COUNT_FAILED] == 0u ? tile_count[gaussian] : 0u;
    float sum = 0.0;
    if (count != 0u) {
        uint first = first_slot[gaussian];
        // Never past the instances there are, whatever the counts say.
        uint instances = counters[COUNT_INSTANCES];
        first = min(first, instances);
        count = min(count, instances - first);
        uint at = ROW * first + word - ROW * gaussian;
        // Four sums at a time keep four loads in flight for a Gaussian that fills the image.
        vec4 four = vec4(0.0);
        uint k = 0u;
        for (; k + 4u <= count; k += 4u) {
            four += vec4(instance_gradient[at], instance_gradient[at + ROW], instance_gradient[at + 2u * ROW],
                instance_gradient[at + 3u * ROW]);
            at += 4u * ROW;
        }
        sum = (four.x + four.y) + (four.z + four.w);
        for (; k < count; k++) {
            sum += instance_gradient[at];
            at += ROW;
        }
    }
    splat_gradient[word] = sum;
}
