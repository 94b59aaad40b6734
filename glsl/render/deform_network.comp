// Network F for every superpoint in one dispatch: (centre, time) -> (so(3) vector r, translation tau).
//
// A workgroup owns 8 superpoints; a thread owns one neuron of the current layer and all 8 superpoints, so that each weight
// is read once per workgroup, in 16-byte loads coalesced over the threads, and used 8 times. Activations live in shared memory,
// 8 floats (two vec4) per input: first the 76 encoded inputs and 4 zeros, then the WIDTH hidden ones. Thus layer 0 reads
// [0, 80), the skip layer [0, 80 + WIDTH) and every other [80, 80 + WIDTH). In a narrow network the last threads only
// help with the encoding.
//
// `weights`, in words of 16 bytes: for each layer the matrix as [inputs / 4][WIDTH], four successive inputs of one
// output per word (FP16_WEIGHTS = 1: [inputs / 8][WIDTH], eight halves per word, the first in the lowest bits), the padded
// inputs 0, then its bias [WIDTH / 4]; then the heads [WIDTH][2], (r, 0) and (tau, 0), and their bias [2]. Heads and biases are
// always f32. Accumulation is f32.
#version 460
#extension GL_GOOGLE_include_directive : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint FP16_WEIGHTS = 0;
layout(constant_id = 2) const uint LAYERS = 8;     // 1 to 8
layout(constant_id = 3) const uint WIDTH = 256;    // a multiple of 32 up to 256
layout(constant_id = 4) const uint SKIP_LAYER = 5; // LAYERS: none

#include "lib/frame.glsl"
#include "lib/dispatch.glsl"
#include "lib/angle.glsl"
#include "lib/relu.glsl"

layout(std430, set = 0, binding = 1) readonly buffer SuperpointPositionBlock { float superpoint_position[]; };
layout(std430, set = 0, binding = 2) readonly buffer WeightsBlock { uvec4 weights[]; };
layout(std430, set = 0, binding = 3) writeonly buffer PoseBlock { vec4 pose[]; };

const uint GROUP_SUPERPOINTS = 8u;
const uint POSITION_INPUTS = 63u; // 3 + 3 * 2 * 10
const uint ENCODED = 76u;         // and 1 + 2 * 6 of time
const uint ENCODING = 80u;        // padded to a multiple of 8
const uint THREADS = 256u;
const uint SLICES = 32u; // of the hidden activations, for the heads

shared vec4 activations[2 * (80 + 256)];
shared vec4 partial_heads[2 * 32 * 8];

// Element e of [x, sin x, cos x, sin 2x, cos 2x, ..] of the centre, then of time.
float encoded_input(uint superpoint, uint e) {
    float x;
    uint k;
    uint part; // 0 the value itself, 1 sine, 2 cosine
    if (e < POSITION_INPUTS) {
        uint wave = e < 3u ? 0u : e - 3u;
        x = superpoint_position[3u * superpoint + (e < 3u ? e : wave % 3u)];
        k = wave / 6u;
        part = e < 3u ? 0u : 1u + (wave % 6u) / 3u;
    } else {
        uint wave = e == POSITION_INPUTS ? 0u : e - POSITION_INPUTS - 1u;
        x = frame.time;
        k = wave / 2u;
        part = e == POSITION_INPUTS ? 0u : 1u + wave % 2u;
    }
    vec2 wave_value = sin_cos(x * float(1u << k));
    return part == 0u ? x : part == 1u ? wave_value.x : wave_value.y;
}

// Adds inputs i .. i + 3 with their weights to the sums of the 8 superpoints.
void accumulate(uint i, vec4 w, inout vec4 sum_0, inout vec4 sum_1) {
    for (uint k = 0u; k < 4u; k++) {
        sum_0 += w[k] * activations[2u * (i + k)];
        sum_1 += w[k] * activations[2u * (i + k) + 1u];
    }
}

void main() {
    uint thread = gl_LocalInvocationIndex;
    uint fp16 = FP16_WEIGHTS;
    uint layers = min(LAYERS, 8u);
    uint width = min(WIDTH, THREADS);
    uint skip_layer = SKIP_LAYER;
    bool has_neuron = thread < width;
    uint count = frame.superpoints;
    uint first_superpoint = workgroup_index() * GROUP_SUPERPOINTS;

    for (uint item = thread; item < ENCODING * GROUP_SUPERPOINTS; item += THREADS) {
        uint e = item / GROUP_SUPERPOINTS;
        uint s = item % GROUP_SUPERPOINTS;
        uint superpoint = first_superpoint + s;
        activations[2u * e + s / 4u][s % 4u] = e < ENCODED && superpoint < count ? encoded_input(superpoint, e) : 0.0;
    }
    barrier();

    uint base = 0u;
    for (uint layer = 0u; layer < layers; layer++) {
        uint first = layer == 0u || layer == skip_layer ? 0u : ENCODING;
        uint end = layer == 0u ? ENCODING : ENCODING + width;
        uint words = (end - first) * (fp16 == 1u ? width / 8u : width / 4u);
        vec4 sum_0 = vec4(0.0);
        vec4 sum_1 = vec4(0.0);
        uint at = base + thread;
        if (has_neuron) {
            float bias = uintBitsToFloat(weights[base + words + thread / 4u][thread % 4u]);
            sum_0 = vec4(bias);
            sum_1 = vec4(bias);
        } else {
            end = first;
        }
        if (fp16 == 1u) {
            for (uint i = first; i < end; i += 8u) {
                uvec4 word = weights[at];
                accumulate(i, vec4(unpackHalf2x16(word.x), unpackHalf2x16(word.y)), sum_0, sum_1);
                accumulate(i + 4u, vec4(unpackHalf2x16(word.z), unpackHalf2x16(word.w)), sum_0, sum_1);
                at += width;
            }
        } else {
            for (uint i = first; i < end; i += 4u) {
                accumulate(i, uintBitsToFloat(weights[at]), sum_0, sum_1);
                at += width;
            }
        }
        base += words + width / 4u;
        barrier();
        if (has_neuron) {
            activations[2u * (ENCODING + thread)] = relu(sum_0);
            activations[2u * (ENCODING + thread) + 1u] = relu(sum_1);
        }
        barrier();
    }

    // Heads: thread = (slice of width / 32 inputs, superpoint); the slices are added in order.
    uint s = thread % GROUP_SUPERPOINTS;
    uint slice = thread / GROUP_SUPERPOINTS;
    vec4 turn = vec4(0.0);
    vec4 move = vec4(0.0);
    for (uint j = 0u; j < width / SLICES; j++) {
        uint i = slice * (width / SLICES) + j;
        float h = activations[2u * (ENCODING + i) + s / 4u][s % 4u];
        turn += h * uintBitsToFloat(weights[base + 2u * i]);
        move += h * uintBitsToFloat(weights[base + 2u * i + 1u]);
    }
    partial_heads[2u * thread] = turn;
    partial_heads[2u * thread + 1u] = move;
    barrier();
    if (thread < 2u * GROUP_SUPERPOINTS) {
        // One thread per (r or tau, superpoint).
        uint which = thread / GROUP_SUPERPOINTS;
        vec4 sum = uintBitsToFloat(weights[base + 2u * width + which]);
        for (uint k = 0u; k < SLICES; k++) {
            sum += partial_heads[2u * (k * GROUP_SUPERPOINTS + s) + which];
        }
        if (first_superpoint + s < count) {
            pose[2u * (first_superpoint + s) + which] = sum;
        }
    }
}
