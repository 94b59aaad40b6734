// A dense layer: output = act([input_0, input_1] W' + bias), row by row; act is ReLU or the identity.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_shuffle : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint STAGE = 1;
layout(constant_id = 2) const uint RELU = 1;
layout(constant_id = 3) const uint VECTORS = 0;
layout(constant_id = 4) const uint THREADS = 256; // of a workgroup

#define A_ALONG_K 1
#define B_ALONG_K 1
#define K_STEP 4
#define ROW_SUMS 0
#include "lib/dispatch.glsl"
#include "lib/matrix_product.glsl"
#include "lib/relu.glsl"

// input_0 as [rows, inputs_0] at 0, input_1 as [rows, inputs_1] at push.input_1_at.
layout(std430, set = 0, binding = 0) readonly buffer LayerInputBlock { vec4 layer_input[]; };
// [outputs, inputs_0 + inputs_1], then the bias.
layout(std430, set = 0, binding = 1) readonly buffer ParameterBlock { vec4 parameter[]; };
layout(std430, set = 0, binding = 2) writeonly buffer LayerOutputBlock { vec4 layer_output[]; };

layout(push_constant) uniform Push {
    uint rows;
    uint outputs;
    uint inputs_0;
    uint inputs_1;
    uint input_1_at;
} push;

uint input_at(uint row, uint k) {
    return k < push.inputs_0 ? row * push.inputs_0 + k : push.input_1_at + row * push.inputs_1 + k - push.inputs_0;
}

uint inputs() {
    return push.inputs_0 + push.inputs_1;
}

float operand_a(uint row, uint k) {
    uint at = input_at(row, k);
    return layer_input[at / 4u][at % 4u];
}

vec4 operand_a_four(uint row, uint k) {
    return layer_input[input_at(row, k) / 4u];
}

float operand_b(uint k, uint o) {
    uint at = o * inputs() + k;
    return parameter[at / 4u][at % 4u];
}

vec4 operand_b_four(uint k, uint o) {
    return parameter[(o * inputs() + k) / 4u];
}

float act(float y) {
    uint with_relu = RELU;
    return with_relu == 1u ? relu(y) : y;
}

void store_all_four(uint row, uint o, vec4 value) {
    vec4 y = value + parameter[(push.outputs * inputs() + o) / 4u];
    layer_output[(row * push.outputs + o) / 4u] = vec4(act(y.x), act(y.y), act(y.z), act(y.w));
}

void store_four(uint row, uint o, uint columns, vec4 value) {
    uint bias_at = push.outputs * inputs() + o;
    uint at = row * push.outputs + o;
    uint vectors = VECTORS;
    if (vectors == 1u && o < columns) {
        store_all_four(row, o, value);
    }
    for (uint c = 0u; c < 4u; c++) {
        if (vectors == 0u && o + c < columns) {
            uint bias = bias_at + c;
            layer_output[(at + c) / 4u][(at + c) % 4u] = act(value[c] + parameter[bias / 4u][bias % 4u]);
        }
    }
}

void main() {
    matrix_product(product_tile(), push.rows, push.outputs, 0u, inputs());
}
