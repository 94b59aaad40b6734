// Gradient of a dense layer towards its weights and bias: sums over rows of output_gradient' [input_0, input_1] and of
// output_gradient, one set per slice of rows_per_slice rows. Adam is left to `linear_update`: 64 copies of it behind the sums
// of a thread cost a CPU device more than the product.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_shuffle : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint STAGE = 1;
layout(constant_id = 2) const uint VECTORS = 0;
layout(constant_id = 3) const uint THREADS = 256; // of a workgroup

#define A_ALONG_K 0
#define B_ALONG_K 0
#define K_STEP 4
#define ROW_SUMS 1
#include "lib/dispatch.glsl"
#include "lib/matrix_product.glsl"

layout(std430, set = 0, binding = 0) readonly buffer OutputGradientBlock { vec4 output_gradient[]; }; // [rows, outputs]
// input_0 as [rows, inputs_0] at 0, input_1 as [rows, inputs_1] at push.input_1_at.
layout(std430, set = 0, binding = 1) readonly buffer LayerInputBlock { vec4 layer_input[]; };
// Per slice [outputs, inputs_0 + inputs_1], then the bias.
layout(std430, set = 0, binding = 2) writeonly buffer GradientBlock { vec4 gradient[]; };

layout(push_constant) uniform Push {
    uint rows;
    uint outputs;
    uint inputs_0;
    uint inputs_1;
    uint input_1_at;
    uint rows_per_slice;
    uint first_slice;  // of the gradient
    uint slice_stride; // floats
} push;

uint slice_at = 0u;

float operand_a(uint o, uint row) {
    uint at = row * push.outputs + o;
    return output_gradient[at / 4u][at % 4u];
}

vec4 operand_a_four(uint o, uint row) {
    return output_gradient[(row * push.outputs + o) / 4u];
}

uint input_at(uint row, uint i) {
    return i < push.inputs_0 ? row * push.inputs_0 + i : push.input_1_at + row * push.inputs_1 + i - push.inputs_0;
}

float operand_b(uint row, uint i) {
    uint at = input_at(row, i);
    return layer_input[at / 4u][at % 4u];
}

vec4 operand_b_four(uint row, uint i) {
    return layer_input[input_at(row, i) / 4u];
}

uint gradient_at(uint o, uint i) {
    return slice_at + o * (push.inputs_0 + push.inputs_1) + i;
}

void store_all_four(uint o, uint i, vec4 value) {
    gradient[gradient_at(o, i) / 4u] = value;
}

void store_four(uint o, uint i, uint columns, vec4 value) {
    uint at = gradient_at(o, i);
    uint vectors = VECTORS;
    if (vectors == 1u && i < columns) {
        store_all_four(o, i, value);
    }
    for (uint c = 0u; c < 4u; c++) {
        if (vectors == 0u && i + c < columns) {
            gradient[(at + c) / 4u][(at + c) % 4u] = value[c];
        }
    }
}

void store_row_sum(uint o, float value) {
    uint at = slice_at + push.outputs * (push.inputs_0 + push.inputs_1) + o;
    gradient[at / 4u][at % 4u] = value;
}

void main() {
    uint inputs = push.inputs_0 + push.inputs_1;
    uint tiles = product_tiles(push.outputs, inputs).y;
    uint item = product_tile();
    uint slice = item / tiles;
    uint slices = (push.rows + push.rows_per_slice - 1u) / push.rows_per_slice;
    slice_at = (push.first_slice + slice) * push.slice_stride;
    uint first = min(slice * push.rows_per_slice, push.rows);
    uint tile = slice < slices ? item % tiles : 0x40000000u;
    matrix_product(tile, push.outputs, inputs, first, min(first + push.rows_per_slice, push.rows));
}
