#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require

// Copies, to measure the rate of the device's memory: four loads of a thread on their way at once, lanes side by side.

#include "lib/dispatch.glsl"

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

layout(std430, set = 0, binding = 0) readonly buffer SourceBlock { uvec4 source[]; };
layout(std430, set = 0, binding = 1) writeonly buffer DestinationBlock { uvec4 destination[]; };

layout(push_constant) uniform PushBlock {
    uint count; // of vectors
} push;

const uint OF_THREAD = 4u;

void main() {
    uint first = workgroup_index() * 256u * OF_THREAD + gl_LocalInvocationID.x;
    uvec4 words[OF_THREAD];
    [[unroll]] for (uint i = 0u; i < OF_THREAD; i++) {
        uint at = first + i * 256u;
        words[i] = at < push.count ? source[at] : uvec4(0u);
    }
    [[unroll]] for (uint i = 0u; i < OF_THREAD; i++) {
        uint at = first + i * 256u;
        if (at < push.count) {
            destination[at] = words[i];
        }
    }
}
