#version 460
#extension GL_GOOGLE_include_directive : require

// Multiply-adds that depend on nothing but registers, to measure the device's f32 rate.

#include "lib/dispatch.glsl"

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

layout(std430, set = 0, binding = 0) writeonly buffer SumsBlock { float sums[]; };

layout(push_constant) uniform PushBlock {
    uint count;
    uint rounds; // of 16 multiply-adds
} push;

const uint MAX_ROUNDS = 4096u;

void main() {
    uint i = workgroup_index() * 256u + gl_LocalInvocationID.x;
    // Sixteen different chains: enough to hide the latency of one, and none that a compiler could take for another.
    vec4 seed = float(i & 255u) * (1.0 / 256.0) + vec4(0.0, 0.125, 0.25, 0.375);
    vec4 a = seed;
    vec4 b = seed + 1.0;
    vec4 c = seed + 2.0;
    vec4 d = seed + 3.0;
    for (uint k = 0u; k < min(push.rounds, MAX_ROUNDS); k++) {
        a = a * 0.96875 + 0.25;
        b = b * 0.96875 + 0.5;
        c = c * 0.9375 + 0.25;
        d = d * 0.9375 + 0.5;
    }
    if (i < push.count) {
        vec4 sum = (a + b) + (c + d);
        sums[i] = (sum.x + sum.y) + (sum.z + sum.w);
    }
}
