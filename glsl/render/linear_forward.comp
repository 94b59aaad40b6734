// A dense layer: output = act([input_0, input_1] W' + bias), row by row; act is ReLU or the identity.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_shuffle : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint STAGE = 1;
layout(constant_id = 2) const uint RELU = 1;

#define A_ALONG_K 1
#define B_ALONG_K 1
#define ROW_SUMS 0
#include "lib/dispatch.glsl"
#include "lib/matrix_product.glsl"
#include "lib/relu.glsl"

// input_0 as [rows, inputs_0] at 0, input_1 as [rows, inputs_1] at push.input_1_at.
layout(std430, set = 0, binding = 0) readonly buffer LayerInputBlock { float layer_input[]; };
// [outputs, inputs_0 + inputs_1], then the bias.
layout(std430, set = 0, binding = 1) readonly buffer ParameterBlock { float parameter[]; };
layout(std430, set = 0, binding = 2) writeonly buffer LayerOutputBlock { float layer_output[]; };

layout(push_constant) uniform Push {
    uint rows;
    uint outputs;
    uint inputs_0;
    uint inputs_1;
    uint input_1_at;
} push;

float operand_a(uint row, uint k) {
    uint at = k < push.inputs_0 ? row * push.inputs_0 + k : push.input_1_at + row * push.inputs_1 + k - push.inputs_0;
    return layer_input[at];
}

float operand_b(uint k, uint o) {
    return parameter[o * (push.inputs_0 + push.inputs_1) + k];
}

void store_element(uint row, uint o, float value) {
    uint with_relu = RELU;
    float y = value + parameter[push.outputs * (push.inputs_0 + push.inputs_1) + o];
    layer_output[row * push.outputs + o] = with_relu == 1u ? relu(y) : y;
}

void main() {
    matrix_product(product_tile(), push.rows, push.outputs, 0u, push.inputs_0 + push.inputs_1);
}
