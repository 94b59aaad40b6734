// Planes of a gradient as rows, for the products: rows[r][column] = planes[p][first_row + r]; columns without a plane are 0.
// A number that is not finite counts as 0 and is reported. push.columns: how many of network G's columns get a gradient.
#version 460
#extension GL_GOOGLE_include_directive : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint NETWORK = 0; // 0: F, planes r, tau to columns 0-2, 4-6 of 8; 1: G, 10 planes to 12 columns

#define STATUS_BINDING 2
#include "lib/dispatch.glsl"
#include "lib/status.glsl"

layout(std430, set = 0, binding = 0) readonly buffer PlaneBlock { float plane[]; };
layout(std430, set = 0, binding = 1) writeonly buffer RowGradientBlock { float row_gradient[]; };

layout(push_constant) uniform Push {
    uint rows;
    uint first_row;
    uint plane_stride;
    uint columns;
} push;

void main() {
    uint network = NETWORK;
    uint columns = network == 0u ? 8u : 12u;
    uint item = workgroup_index() * 256u + gl_LocalInvocationIndex;
    uint row = push.first_row + item / columns;
    uint column = item % columns;
    bool padding = network == 0u ? column % 4u == 3u : column >= push.columns;
    uint plane_number = network == 0u ? column - column / 4u : column;
    if (item < push.rows * columns) {
        float value = padding ? 0.0 : plane[plane_number * push.plane_stride + row];
        bool finite = number_is_finite(value);
        if (!finite) {
            report_not_finite(network == 0u ? STATUS_POSE : STATUS_NETWORK_G, row);
        }
        row_gradient[item] = finite ? value : 0.0;
    }
}
