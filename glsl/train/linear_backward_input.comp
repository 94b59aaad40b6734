// Gradient of a dense layer towards its input: input_gradient = (output_gradient W) [input > 0]. Gradients are those of the
// values before the ReLU, so the mask is that of the layer before, whose output `layer_input` is.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_shuffle : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint STAGE = 1;
layout(constant_id = 2) const uint VECTORS = 0;
layout(constant_id = 3) const uint THREADS = 256; // of a workgroup

#define A_ALONG_K 1
#define B_ALONG_K 0
#define K_STEP 4
#define ROW_SUMS 0
#include "lib/dispatch.glsl"
#include "lib/matrix_product.glsl"

layout(std430, set = 0, binding = 0) readonly buffer OutputGradientBlock { vec4 output_gradient[]; }; // [rows, outputs]
layout(std430, set = 0, binding = 1) readonly buffer ParameterBlock { vec4 parameter[]; }; // [outputs, weight_stride]
layout(std430, set = 0, binding = 2) readonly buffer LayerInputBlock { vec4 layer_input[]; }; // [rows, inputs]
layout(std430, set = 0, binding = 3) writeonly buffer InputGradientBlock { vec4 input_gradient[]; }; // [rows, inputs]

layout(push_constant) uniform Push {
    uint rows;
    uint outputs;
    uint inputs;
    uint weight_stride;
    uint first_input;
} push;

float operand_a(uint row, uint k) {
    uint at = row * push.outputs + k;
    return output_gradient[at / 4u][at % 4u];
}

vec4 operand_a_four(uint row, uint k) {
    return output_gradient[(row * push.outputs + k) / 4u];
}

uint weight_at(uint k, uint i) {
    return k * push.weight_stride + push.first_input + i;
}

float operand_b(uint k, uint i) {
    uint at = weight_at(k, i);
    return parameter[at / 4u][at % 4u];
}

vec4 operand_b_four(uint k, uint i) {
    return parameter[weight_at(k, i) / 4u];
}

void store_all_four(uint row, uint i, vec4 value) {
    uint at = (row * push.inputs + i) / 4u;
    input_gradient[at] = mix(vec4(0.0), value, greaterThan(layer_input[at], vec4(0.0)));
}

void store_four(uint row, uint i, uint columns, vec4 value) {
    uint at = row * push.inputs + i;
    uint vectors = VECTORS;
    if (vectors == 1u && i < columns) {
        store_all_four(row, i, value);
    }
    for (uint c = 0u; c < 4u; c++) {
        if (vectors == 0u && i + c < columns) {
            uvec2 to = uvec2((at + c) / 4u, (at + c) % 4u);
            input_gradient[to.x][to.y] = layer_input[to.x][to.y] > 0.0 ? value[c] : 0.0;
        }
    }
}

void main() {
    matrix_product(product_tile(), push.rows, push.inputs, 0u, push.outputs);
}
