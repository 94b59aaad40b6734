// Gradient of a dense layer towards its input: input_gradient = (output_gradient W) [input > 0]. Gradients are those of the
// values before the ReLU, so the mask is that of the layer before, whose output `layer_input` is.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_shuffle : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint STAGE = 1;

#define A_ALONG_K 1
#define B_ALONG_K 0
#define ROW_SUMS 0
#include "lib/dispatch.glsl"
#include "lib/matrix_product.glsl"

layout(std430, set = 0, binding = 0) readonly buffer OutputGradientBlock { float output_gradient[]; }; // [rows, outputs]
layout(std430, set = 0, binding = 1) readonly buffer ParameterBlock { float parameter[]; }; // [outputs, weight_stride]
layout(std430, set = 0, binding = 2) readonly buffer LayerInputBlock { float layer_input[]; }; // [rows, inputs]
layout(std430, set = 0, binding = 3) writeonly buffer InputGradientBlock { float input_gradient[]; }; // [rows, inputs]

layout(push_constant) uniform Push {
    uint rows;
    uint outputs;
    uint inputs;
    uint weight_stride;
    uint first_input;
} push;

float operand_a(uint row, uint k) {
    return output_gradient[row * push.outputs + k];
}

float operand_b(uint k, uint i) {
    return parameter[k * push.weight_stride + push.first_input + i];
}

void store_element(uint row, uint i, float value) {
    uint at = row * push.inputs + i;
    input_gradient[at] = layer_input[at] > 0.0 ? value : 0.0;
}

void main() {
    matrix_product(product_tile(), push.rows, push.inputs, 0u, push.outputs);
}
