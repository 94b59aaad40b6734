// Network F in training, from the gradient of the poses to that before the ReLU of every hidden layer, in one dispatch.
//
// A workgroup owns ROWS rows; each weight is read once per workgroup and used for all of them. A thread owns four neighbouring
// inputs of the layer at hand and every SLICES-th of its outputs; the sums of the slices meet in shared memory, where the
// gradients are as well, four rows to a vec4.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint LAYERS = 8;     // hidden ones, 1 to 8
layout(constant_id = 2) const uint WIDTH = 256;    // of each, a multiple of 32 up to 256
layout(constant_id = 3) const uint SKIP_LAYER = 5; // 0: none
layout(constant_id = 4) const uint ROWS = 4;       // of a workgroup, 4 or 8

#include "lib/dispatch.glsl"
#include "lib/network_layers.glsl"

layout(std430, set = 0, binding = 0) readonly buffer PoseGradientBlock { float pose_gradient[]; }; // [rows, 8]
layout(std430, set = 0, binding = 1) readonly buffer ParameterBlock { vec4 parameter[]; };
// [rows, WIDTH] of each hidden layer, layer_stride apart.
layout(std430, set = 0, binding = 2) readonly buffer HiddenOutputBlock { float hidden_output[]; };
layout(std430, set = 0, binding = 3) writeonly buffer HiddenGradientBlock { float hidden_gradient[]; }; // likewise

layout(push_constant) uniform Push {
    uint rows;
    uint layer_stride;
} push;

const uint THREADS = 256u;
const uint MOST_WIDTH = 256u;
const uint MOST_FOURS = 2u; // vec4 of rows of a workgroup
const uint OUTPUTS = 4u;    // that a thread has on their way at a time
const uint SLICES = 4u;     // of 64 threads
const uint PITCH = 66u;     // 256 / 4, and two to spread the banks

shared vec4 gradient[2 * 256];
shared vec4 partial_sum[4 * 4 * 66]; // of a slice, input i at i % 4 * PITCH + i / 4

// A thread's next weights. They come from memory while the sums take up those before: few threads share the work, and
// nothing else would hide that time.
vec4 next[4];

uint partial_at(uint slice, uint i) {
    return (slice * 4u + i % 4u) * PITCH + i / 4u;
}

// Of outputs o, o + SLICES, .. the thread's inputs, of the layer whose weights start at `base`.
void fetch(uint layer, uint base, uint o) {
    uint width = WIDTH;
    uint inputs = layer_inputs(layer);
    uint outputs = layer_outputs(layer);
    uint i = gl_LocalInvocationIndex % 64u * 4u;
    [[unroll]] for (uint j = 0u; j < OUTPUTS; j++) {
        uint at = base + (o + j * SLICES) * inputs + inputs - width + i;
        next[j] = i < width && o + j * SLICES < outputs ? parameter[at / 4u] : vec4(0.0);
    }
}

void main() {
    uint thread = gl_LocalInvocationIndex;
    uint layers = LAYERS;
    uint width = WIDTH;
    uint group_rows = ROWS;
    uint fours = min(group_rows / 4u, MOST_FOURS);
    uint first_row = workgroup_index() * 4u * fours;
    uint slice = thread / 64u;
    uint i_first = thread % 64u * 4u;

    uint base = 0u;
    for (uint layer = 0u; layer < layers; layer++) {
        base += layer_floats(layer);
    }
    fetch(layers, base, slice);
    if (thread < 4u * fours * HEADS) {
        uint r = thread / HEADS;
        uint o = thread % HEADS;
        float value = first_row + r < push.rows ? pose_gradient[(first_row + r) * HEADS + o] : 0.0;
        gradient[r / 4u * MOST_WIDTH + o][r % 4u] = value;
    }
    barrier();

    for (uint layer = layers; layer > 0u; layer--) {
        uint outputs = layer_outputs(layer);
        uint below = layer - 1u;
        vec4 output_below[2];
        [[unroll]] for (uint f = 0u; f < MOST_FOURS; f++) {
            output_below[f] = vec4(0.0);
            for (uint r = 0u; r < 4u; r++) {
                uint row = first_row + 4u * f + r;
                if (f < fours && row < push.rows && thread < width) {
                    output_below[f][r] = hidden_output[below * push.layer_stride + row * width + thread];
                }
            }
        }

        vec4 sum[2 * 4];
        [[unroll]] for (uint c = 0u; c < MOST_FOURS * 4u; c++) {
            sum[c] = vec4(0.0);
        }
        for (uint o = slice; o < outputs; o += OUTPUTS * SLICES) {
            vec4 weight[4];
            [[unroll]] for (uint j = 0u; j < OUTPUTS; j++) {
                weight[j] = next[j];
            }
            fetch(layer, base, o + OUTPUTS * SLICES);
            [[unroll]] for (uint j = 0u; j < OUTPUTS; j++) {
                if (o + j * SLICES < outputs) {
                    [[unroll]] for (uint f = 0u; f < MOST_FOURS; f++) {
                        if (f < fours) {
                            vec4 g = gradient[f * MOST_WIDTH + o + j * SLICES];
                            [[unroll]] for (uint c = 0u; c < 4u; c++) {
                                sum[f * 4u + c] += weight[j][c] * g;
                            }
                        }
                    }
                }
            }
        }
        base -= layer_floats(below);
        if (below > 0u) {
            fetch(below, base, slice);
        }

        [[unroll]] for (uint f = 0u; f < MOST_FOURS; f++) {
            if (f < fours) {
                if (i_first < width) {
                    [[unroll]] for (uint c = 0u; c < 4u; c++) {
                        partial_sum[partial_at(slice, i_first + c)] = sum[f * 4u + c];
                    }
                }
                barrier();
                if (thread < width) {
                    vec4 g = vec4(0.0);
                    for (uint s = 0u; s < SLICES; s++) {
                        g += partial_sum[partial_at(s, thread)];
                    }
                    g = mix(vec4(0.0), g, greaterThan(output_below[f], vec4(0.0)));
                    gradient[f * MOST_WIDTH + thread] = g;
                    for (uint r = 0u; r < 4u; r++) {
                        uint row = first_row + 4u * f + r;
                        if (row < push.rows) {
                            hidden_gradient[below * push.layer_stride + row * width + thread] = g[r];
                        }
                    }
                }
                barrier();
            }
        }
    }
}
