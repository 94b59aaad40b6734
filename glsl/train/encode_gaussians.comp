// Input of network G for the Gaussians from push.first_row on: [x, sin 2^k x, cos 2^k x, ..] of the rigidly moved centre and
// of the time (10 octaves each), [rows, 84]. A workgroup moves 64 centres, then its threads write side by side.
#version 460
#extension GL_GOOGLE_include_directive : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint MOTION = 1; // 0 static, 1 pose table
layout(constant_id = 2) const uint BLEND = 0; // see lib/superpoint_motion.glsl

#include "lib/frame.glsl"
#include "lib/dispatch.glsl"
#include "lib/quaternion.glsl"
#include "lib/encoding.glsl"

layout(std430, set = 0, binding = 1) readonly buffer MeanBlock { float mean[]; };
layout(std430, set = 0, binding = 2) readonly buffer SuperpointOfGaussianBlock { uint superpoint_of_gaussian[]; };
layout(std430, set = 0, binding = 3) readonly buffer PoseBlock { vec4 pose[]; };
layout(std430, set = 0, binding = 4) writeonly buffer EncodingBlock { float encoding[]; };
layout(std430, set = 0, binding = 5) readonly buffer BlendIndexBlock { uint blend_index[]; };
layout(std430, set = 0, binding = 6) readonly buffer BlendWeightBlock { float blend_weight[]; };

layout(push_constant) uniform Push { uint first_row; uint rows; } push;

#include "lib/moved_centre.glsl"

const uint GROUP_GAUSSIANS = 64u;
const uint ENCODED = 84u;

shared vec4 centres[64];

void main() {
    uint thread = gl_LocalInvocationIndex;
    uint first = workgroup_index() * GROUP_GAUSSIANS;
    if (thread < GROUP_GAUSSIANS) {
        centres[thread] = vec4(moved_centre(push.first_row + min(first + thread, push.rows - 1u)), frame.time);
    }
    barrier();
    for (uint item = thread; item < ENCODED * GROUP_GAUSSIANS; item += 256u) {
        uint row = item / ENCODED;
        EncodedElement e = encoded_element(item % ENCODED);
        if (first + row < push.rows) {
            encoding[first * ENCODED + item] = encoded_value(e, centres[row][e.axis]);
        }
    }
}
