// Gradient of a dense layer towards its weights and bias: sums over rows of output_gradient' [input_0, input_1] and of
// output_gradient. OUTPUT 0 writes them, one set per slice of rows_per_slice rows; OUTPUT 1 applies Adam at once (one slice).
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_shuffle : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint STAGE = 1;
layout(constant_id = 2) const uint OUTPUT = 1;
layout(constant_id = 3) const uint NETWORK = 0;

#define STEP_BINDING 0
#define STATUS_BINDING 8
#define A_ALONG_K 0
#define B_ALONG_K 0
#define ROW_SUMS 1
#include "lib/dispatch.glsl"
#include "lib/limits.glsl"
#include "lib/step.glsl"
#include "lib/adam.glsl"
#include "lib/status.glsl"
#include "lib/matrix_product.glsl"

layout(std430, set = 0, binding = 1) readonly buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 2) readonly buffer OutputGradientBlock { float output_gradient[]; }; // [rows, outputs]
// input_0 as [rows, inputs_0] at 0, input_1 as [rows, inputs_1] at push.input_1_at.
layout(std430, set = 0, binding = 3) readonly buffer LayerInputBlock { float layer_input[]; };
// [outputs, inputs_0 + inputs_1], then the bias; the moments and each slice of the gradient alike.
layout(std430, set = 0, binding = 4) buffer ParameterBlock { float parameter[]; };
layout(std430, set = 0, binding = 5) buffer Moment1Block { float moment_1[]; };
layout(std430, set = 0, binding = 6) buffer Moment2Block { float moment_2[]; };
layout(std430, set = 0, binding = 7) writeonly buffer GradientBlock { float gradient[]; };

layout(push_constant) uniform Push {
    uint rows;
    uint outputs;
    uint inputs_0;
    uint inputs_1;
    uint input_1_at;
    uint rows_per_slice;
    uint first_slice;  // of the gradient
    uint slice_stride; // floats
    uint first_index;  // number of the layer's first weight in the network, for reports
} push;

#include "lib/network_update.glsl"

uint slice_at = 0u;

float operand_a(uint o, uint row) {
    return output_gradient[row * push.outputs + o];
}

float operand_b(uint row, uint i) {
    uint at = i < push.inputs_0 ? row * push.inputs_0 + i : push.input_1_at + row * push.inputs_1 + i - push.inputs_0;
    return layer_input[at];
}

void store(uint at, float value) {
    uint kind = OUTPUT;
    if (kind == 0u) {
        gradient[slice_at + at] = value;
    } else {
        update_weight(at, push.first_index + at, value);
    }
}

void store_element(uint o, uint i, float value) {
    store(o * (push.inputs_0 + push.inputs_1) + i, value);
}

void store_row_sum(uint o, float value) {
    store(push.outputs * (push.inputs_0 + push.inputs_1) + o, value);
}

void main() {
    uint inputs = push.inputs_0 + push.inputs_1;
    uint tiles = product_tiles(push.outputs, inputs).y;
    uint item = product_tile();
    uint slice = item / tiles;
    uint slices = (push.rows + push.rows_per_slice - 1u) / push.rows_per_slice;
    slice_at = (push.first_slice + slice) * push.slice_stride;
    uint first = min(slice * push.rows_per_slice, push.rows);
    bool runs = slice < slices && counters[COUNT_FAILED] == 0u;
    uint tile = runs ? item % tiles : 0x40000000u;
    matrix_product(tile, push.outputs, inputs, first, min(first + push.rows_per_slice, push.rows));
}
