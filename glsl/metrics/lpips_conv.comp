// A convolution with bias and ReLU, as the product of the weights [outputs, depth] and the windows [depth, pixels], which
// are never stored. Input and output hold a band of the rows of their picture; zeros lie around the picture.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_shuffle : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint STAGE = 1;
layout(constant_id = 2) const uint KERNEL = 3;
layout(constant_id = 3) const uint STRIDE = 1;
layout(constant_id = 4) const uint PAD = 1;
layout(constant_id = 5) const uint THREADS = 256; // of a workgroup

#define A_ALONG_K 1
#define B_ALONG_K 0
#define K_STEP 1
#define ROW_SUMS 0
#include "lib/dispatch.glsl"
#include "lib/matrix_product.glsl"
#include "lib/relu.glsl"

// [inputs, in_rows, in_width]: rows in_first_row… of a picture of in_height rows.
layout(std430, set = 0, binding = 0) readonly buffer FeatureInputBlock { float feature_input[]; };
// [outputs, inputs, KERNEL, KERNEL], then the bias.
layout(std430, set = 0, binding = 1) readonly buffer ParameterBlock { float parameter[]; };
// [outputs, out_rows, out_width]: rows out_first_row…; channels first_output… are written.
layout(std430, set = 0, binding = 2) writeonly buffer FeatureOutputBlock { float feature_output[]; };

layout(push_constant) uniform Push {
    uint inputs;
    uint outputs;
    uint in_width;
    uint in_height;
    uint in_first_row;
    uint in_rows;
    uint out_width;
    uint out_first_row;
    uint out_rows;
    uint first_output;
    uint output_count;
} push;

uint window_size() {
    uint side = KERNEL;
    return side * side;
}

float operand_a(uint o, uint k) {
    return parameter[(push.first_output + o) * push.inputs * window_size() + k];
}

float operand_b(uint k, uint pixel) {
    uint side = KERNEL;
    uint stride = STRIDE;
    uint pad = PAD;
    uint channel = k / window_size();
    uint within = k % window_size();
    // Wraps around left of and above the picture, which is then not below its size.
    uint x = pixel % push.out_width * stride + within % side - pad;
    uint y = (push.out_first_row + pixel / push.out_width) * stride + within / side - pad;
    bool inside = x < push.in_width && y < push.in_height;
    uint at = inside ? (channel * push.in_rows + y - push.in_first_row) * push.in_width + x : 0u;
    return inside ? feature_input[at] : 0.0;
}

void store_four(uint at, uint pixel, uint columns, vec4 value) {
    uint o = push.first_output + at;
    float bias = parameter[push.outputs * push.inputs * window_size() + o];
    for (uint c = 0u; c < 4u; c++) {
        if (pixel + c < columns) {
            feature_output[o * push.out_rows * push.out_width + pixel + c] = relu(value[c] + bias);
        }
    }
}

void main() {
    matrix_product(product_tile(), push.output_count, push.out_rows * push.out_width, 0u, push.inputs * window_size());
}
