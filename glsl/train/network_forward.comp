// Network F in training, all layers in one dispatch: from the encoding to the hidden layers' outputs, which the backward pass
// reads, and the poses.
//
// A workgroup owns ROWS rows; each weight is read once per workgroup and used for all of them. Neighbouring threads, the lanes of a
// slot, share four outputs of a layer: slot, slot + slots, .. Each takes four inputs of every 4 * lanes, so that what they load
// together is a run of a row of weights, and their sums meet in shared memory. Activations live there too, four rows to a vec4: the
// encoding, then the outputs of the layer before; layer 0 reads the former, the skip layer both, every other the latter.
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
#include "lib/relu.glsl"

layout(std430, set = 0, binding = 0) readonly buffer EncodingBlock { vec4 encoding[]; }; // [rows, 76]
layout(std430, set = 0, binding = 1) readonly buffer ParameterBlock { vec4 parameter[]; };
// [rows, WIDTH] of each hidden layer, layer_stride apart.
layout(std430, set = 0, binding = 2) writeonly buffer HiddenOutputBlock { float hidden_output[]; };
layout(std430, set = 0, binding = 3) writeonly buffer PoseBlock { float pose[]; }; // [rows, 8]

layout(push_constant) uniform Push {
    uint rows;
    uint layer_stride;
} push;

const uint THREADS = 256u;
const uint MOST_FOURS = 2u; // vec4 of rows of a workgroup
const uint OUTPUTS = 4u;    // of a thread
const uint LANES_LOG2 = 2u; // of a slot
const uint PITCH = 258u;    // of a lane's sums: 256, and two to spread the banks
// The heads have but 8 outputs.
const uint HEAD_LANES_LOG2 = 5u;
const uint HEAD_PITCH = 9u;
const uint ACTIVATION_PITCH = 86u; // (76 + 256) / 4, and three to spread the banks

shared vec4 activation[2 * 4 * 86];
shared vec4 partial_sum[4 * 258]; // [lanes][pitch]

// A thread's next weights. They come from memory while the sums take up those before: few threads share the work, and
// nothing else would hide that time.
vec4 next[4];

uint activation_at(uint four, uint k) {
    return (four * 4u + k % 4u) * ACTIVATION_PITCH + k / 4u;
}

uint lanes_log2(uint layer) {
    return is_hidden(layer) ? LANES_LOG2 : HEAD_LANES_LOG2;
}

// First input that a thread takes.
uint lane_input(uint layer) {
    return 4u * (gl_LocalInvocationIndex & ((1u << lanes_log2(layer)) - 1u));
}

// Inputs k to k + 3 of the thread's outputs, of the layer whose weights start at `base`.
void fetch(uint layer, uint base, uint k) {
    uint inputs = layer_inputs(layer);
    uint outputs = layer_outputs(layer);
    uint slots = THREADS >> lanes_log2(layer);
    uint o = gl_LocalInvocationIndex >> lanes_log2(layer);
    [[unroll]] for (uint i = 0u; i < OUTPUTS; i++) {
        uint at = base + (o + i * slots) * inputs + k;
        next[i] = k < inputs && o + i * slots < outputs ? parameter[at / 4u] : vec4(0.0);
    }
}

void main() {
    uint thread = gl_LocalInvocationIndex;
    uint layers = LAYERS;
    uint width = WIDTH;
    uint group_rows = ROWS;
    uint fours = min(group_rows / 4u, MOST_FOURS);
    uint first_row = workgroup_index() * 4u * fours;

    for (uint item = thread; item < 4u * fours * (ENCODED / 4u); item += THREADS) {
        uint r = item / (ENCODED / 4u);
        uint k = item % (ENCODED / 4u) * 4u;
        vec4 value = first_row + r < push.rows ? encoding[((first_row + r) * ENCODED + k) / 4u] : vec4(0.0);
        for (uint c = 0u; c < 4u; c++) {
            activation[activation_at(r / 4u, k + c)][r % 4u] = value[c];
        }
    }
    fetch(0u, 0u, lane_input(0u));
    barrier();

    uint base = 0u;
    for (uint layer = 0u; layer <= layers; layer++) {
        uint inputs = layer_inputs(layer);
        uint outputs = layer_outputs(layer);
        uint lanes = 1u << lanes_log2(layer);
        uint slots = THREADS >> lanes_log2(layer);
        uint slot = thread >> lanes_log2(layer);
        uint pitch = is_hidden(layer) ? PITCH : HEAD_PITCH;
        uint first_input = inputs == width ? ENCODED : 0u;
        uint bias_at = base + outputs * inputs + thread;
        float bias = thread < outputs ? parameter[bias_at / 4u][bias_at % 4u] : 0.0;

        vec4 sum[2 * 4];
        [[unroll]] for (uint i = 0u; i < MOST_FOURS * OUTPUTS; i++) {
            sum[i] = vec4(0.0);
        }
        for (uint k = lane_input(layer); k < inputs; k += 4u * lanes) {
            vec4 weight[4];
            [[unroll]] for (uint i = 0u; i < OUTPUTS; i++) {
                weight[i] = next[i];
            }
            fetch(layer, base, k + 4u * lanes);
            [[unroll]] for (uint f = 0u; f < MOST_FOURS; f++) {
                if (f < fours) {
                    [[unroll]] for (uint c = 0u; c < 4u; c++) {
                        vec4 x = activation[(f * 4u + c) * ACTIVATION_PITCH + (first_input + k) / 4u];
                        [[unroll]] for (uint i = 0u; i < OUTPUTS; i++) {
                            sum[f * OUTPUTS + i] += weight[i][c] * x;
                        }
                    }
                }
            }
        }
        base += layer_floats(layer);
        if (layer < layers) {
            fetch(layer + 1u, base, lane_input(layer + 1u));
        }

        [[unroll]] for (uint f = 0u; f < MOST_FOURS; f++) {
            if (f < fours) {
                [[unroll]] for (uint i = 0u; i < OUTPUTS; i++) {
                    if (slot + i * slots < outputs) {
                        partial_sum[(lane_input(layer) / 4u) * pitch + slot + i * slots] = sum[f * OUTPUTS + i];
                    }
                }
                barrier();
                if (thread < outputs) {
                    vec4 y = vec4(bias);
                    for (uint l = 0u; l < lanes; l++) {
                        y += partial_sum[l * pitch + thread];
                    }
                    if (layer < layers) {
                        y = relu(y);
                        activation[activation_at(f, ENCODED + thread)] = y;
                    }
                    for (uint r = 0u; r < 4u; r++) {
                        uint row = first_row + 4u * f + r;
                        if (row < push.rows && layer < layers) {
                            hidden_output[layer * push.layer_stride + row * width + thread] = y[r];
                        } else if (row < push.rows) {
                            pose[row * HEADS + thread] = y[r];
                        }
                    }
                }
                barrier();
            }
        }
    }
}
