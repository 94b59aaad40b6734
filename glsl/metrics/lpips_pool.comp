// Max pool of stride 2 without padding, from a band of rows to rows of a whole map.
#version 460
#extension GL_GOOGLE_include_directive : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint KERNEL = 2;

#include "lib/dispatch.glsl"

// [channels, in_rows, in_width], from row 2·out_first_row on.
layout(std430, set = 0, binding = 0) readonly buffer FeatureInputBlock { float feature_input[]; };
// [channels, out_height, out_width]
layout(std430, set = 0, binding = 1) writeonly buffer FeatureOutputBlock { float feature_output[]; };

layout(push_constant) uniform Push {
    uint channels;
    uint in_width;
    uint in_rows;
    uint out_width;
    uint out_height;
    uint out_first_row;
    uint out_rows;
} push;

void main() {
    uint kernel = KERNEL;
    uint item = workgroup_index() * 256u + gl_LocalInvocationIndex;
    uint plane = push.out_rows * push.out_width;
    if (item < push.channels * plane) {
        uint channel = item / plane;
        uint row = item % plane / push.out_width;
        uint column = item % push.out_width;
        uint first = (channel * push.in_rows + 2u * row) * push.in_width + 2u * column;
        // Inputs have passed a ReLU, so that their bits are in their order; those of NaN are larger.
        uint largest = 0u;
        for (uint y = 0u; y < kernel; y++) {
            for (uint x = 0u; x < kernel; x++) {
                largest = max(largest, floatBitsToUint(feature_input[first + y * push.in_width + x]));
            }
        }
        feature_output[(channel * push.out_height + push.out_first_row + row) * push.out_width + column] = uintBitsToFloat(largest);
    }
}
