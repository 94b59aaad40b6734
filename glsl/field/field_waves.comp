// Input of a deformation field for the points from push.first_row on: [x, sin 2^k x, cos 2^k x, ..] of the point, then of
// the time (10 octaves), or, with a network of time, its 30 outputs for 6 octaves of the time: 3 + 6 OCTAVES + 21 or 30
// values, then zeros up to a multiple of 4. [rows, columns]. A workgroup runs the network of time for itself: 11,000 products
// beside the hundred thousand of each of its 64 points.
#version 460
#extension GL_GOOGLE_include_directive : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint TIME_NETWORK = 0;
layout(constant_id = 2) const uint OCTAVES = 10;

#include "lib/frame.glsl"
#include "lib/dispatch.glsl"
#include "lib/angle.glsl"
#include "lib/encoding.glsl"
#include "lib/relu.glsl"

layout(std430, set = 0, binding = 1) readonly buffer PointBlock { float point[]; }; // [3][points]
// [256, 13], its bias, [30, 256], its bias.
layout(std430, set = 0, binding = 2) readonly buffer ParameterBlock { float parameter[]; };
layout(std430, set = 0, binding = 3) writeonly buffer EncodingBlock { float encoding[]; };

layout(push_constant) uniform Push { uint first_row; uint rows; uint points; } push;

const uint GROUP_POINTS = 64u;
const uint TIME_HIDDEN = 256u;
const uint TIME_INPUTS = 13u;
const uint TIME_OUTPUTS = 30u;

shared vec4 centres[64];
shared float hidden_value[256];
shared float time_code[32];

float time_element(uint e, float time) {
    return encoded_value(encoded_element(POSITION_ELEMENTS + e), time);
}

void main() {
    uint time_network = TIME_NETWORK;
    uint thread = gl_LocalInvocationIndex;
    uint first = workgroup_index() * GROUP_POINTS;
    float time = frame.time;
    if (thread < GROUP_POINTS) {
        uint p = push.first_row + min(first + thread, push.rows - 1u);
        centres[thread] = vec4(point[p], point[push.points + p], point[2u * push.points + p], time);
    }
    if (time_network == 1u) {
        float sum = parameter[TIME_HIDDEN * TIME_INPUTS + thread];
        for (uint i = 0u; i < TIME_INPUTS; i++) {
            sum += parameter[thread * TIME_INPUTS + i] * time_element(i, time);
        }
        hidden_value[thread] = relu(sum);
    }
    barrier();
    if (time_network == 1u && thread < TIME_OUTPUTS) {
        uint base = TIME_HIDDEN * (TIME_INPUTS + 1u);
        float sum = parameter[base + TIME_OUTPUTS * TIME_HIDDEN + thread];
        for (uint i = 0u; i < TIME_HIDDEN; i++) {
            sum += parameter[base + thread * TIME_HIDDEN + i] * hidden_value[i];
        }
        time_code[thread] = sum;
    } else if (time_network == 0u && thread < 21u) {
        time_code[thread] = time_element(thread, time);
    }
    barrier();
    uint octaves = OCTAVES;
    uint position_elements = 3u + 6u * octaves;
    uint elements = position_elements + (time_network == 1u ? TIME_OUTPUTS : 21u);
    uint columns = (elements + 3u) / 4u * 4u;
    for (uint item = thread; item < columns * GROUP_POINTS; item += 256u) {
        uint row = item / columns;
        uint e = item % columns;
        if (first + row < push.rows) {
            float value = 0.0;
            if (e < position_elements) {
                EncodedElement element = encoded_element(e);
                value = encoded_value(element, centres[row][element.axis]);
            } else if (e < elements) {
                value = time_code[e - position_elements];
            }
            encoding[first * columns + item] = value;
        }
    }
}
