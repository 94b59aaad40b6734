// Input of network F: [x, sin 2^k x, cos 2^k x, ..] of each superpoint's centre (10 octaves, k-major, sine before cosine,
// each over the three axes), then the same of the time (6 octaves). One value per thread.
#version 460
#extension GL_GOOGLE_include_directive : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;

#define STEP_BINDING 0
#include "lib/dispatch.glsl"
#include "lib/step.glsl"
#include "lib/angle.glsl"
#include "lib/encoding.glsl"

layout(std430, set = 0, binding = 1) readonly buffer SuperpointPositionBlock { float superpoint_position[]; };
layout(std430, set = 0, binding = 2) writeonly buffer EncodingBlock { float encoding[]; }; // [M, 76]

layout(push_constant) uniform Push { uint rows; } push;

const uint ENCODED = 76u; // 3 + 3 * 2 * 10 and 1 + 2 * 6

void main() {
    uint item = workgroup_index() * 256u + gl_LocalInvocationIndex;
    uint row = item / ENCODED;
    EncodedElement e = encoded_element(item % ENCODED);
    if (row < push.rows) {
        float x = e.axis < 3u ? superpoint_position[3u * row + e.axis] : step_data.time;
        encoding[item] = encoded_value(e, x);
    }
}
