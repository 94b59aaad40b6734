// Network F for every superpoint in one dispatch: (centre, time) -> (so(3) vector r, translation tau).
//
// A workgroup owns 8 superpoints; a thread owns one neuron of the current layer and all 8 superpoints, so that each weight
// is read once per workgroup, coalesced over the threads, and used 8 times. Activations live in shared memory, 8 floats
// (two vec4) per input: first the 76 encoded inputs, then the 256 hidden ones. Thus layer 0 reads [0, 76), the skip layer
// [0, 332) and every other [76, 332).
//
// `weights`, in 32-bit words: for each of the 8 layers the matrix as [inputs][256] (FP16_WEIGHTS = 1: [inputs / 2][256],
// two successive inputs per word), then its bias [256]; then the heads [256][6] (3 of r, 3 of tau) and their bias [6].
// Heads and biases are always f32. Accumulation is f32.
#version 460
#extension GL_GOOGLE_include_directive : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint FP16_WEIGHTS = 0;

#include "lib/frame.glsl"
#include "lib/dispatch.glsl"
#include "lib/angle.glsl"

layout(std430, set = 0, binding = 1) readonly buffer SuperpointPositionBlock { float superpoint_position[]; };
layout(std430, set = 0, binding = 2) readonly buffer WeightsBlock { uint weights[]; };
layout(std430, set = 0, binding = 3) writeonly buffer PoseBlock { vec4 pose[]; };

const uint GROUP_SUPERPOINTS = 8u;
const uint POSITION_INPUTS = 63u; // 3 + 3 * 2 * 10
const uint ENCODING = 76u;        // and 1 + 2 * 6 of time
const uint HIDDEN = 256u;
const uint LAYERS = 8u;
const uint SKIP_LAYER = 5u;
const uint HEADS = 6u;
const uint SLICES = 32u; // of the hidden activations, for the heads

shared vec4 activations[2 * (76 + 256)];
shared float partial_heads[32 * 8 * 6];

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
        x = frame.background.w;
        k = wave / 2u;
        part = e == POSITION_INPUTS ? 0u : 1u + wave % 2u;
    }
    vec2 wave_value = sin_cos(x * float(1u << k));
    return part == 0u ? x : part == 1u ? wave_value.x : wave_value.y;
}

void main() {
    uint thread = gl_LocalInvocationIndex;
    uint fp16 = FP16_WEIGHTS;
    uint count = frame.counts.y;
    uint first_superpoint = workgroup_index() * GROUP_SUPERPOINTS;

    for (uint item = thread; item < ENCODING * GROUP_SUPERPOINTS; item += HIDDEN) {
        uint e = item / GROUP_SUPERPOINTS;
        uint s = item % GROUP_SUPERPOINTS;
        uint superpoint = first_superpoint + s;
        activations[2u * e + s / 4u][s % 4u] = superpoint < count ? encoded_input(superpoint, e) : 0.0;
    }
    barrier();

    uint base = 0u;
    for (uint layer = 0u; layer < LAYERS; layer++) {
        uint first = layer == 0u || layer == SKIP_LAYER ? 0u : ENCODING;
        uint end = layer == 0u ? ENCODING : ENCODING + HIDDEN;
        uint words = (end - first) * (fp16 == 1u ? HIDDEN / 2u : HIDDEN);
        float bias = uintBitsToFloat(weights[base + words + thread]);
        vec4 sum_0 = vec4(bias);
        vec4 sum_1 = vec4(bias);
        uint at = base + thread;
        for (uint i = first; i < end; i += 2u) {
            vec2 w;
            if (fp16 == 1u) {
                w = unpackHalf2x16(weights[at]);
                at += HIDDEN;
            } else {
                w = vec2(uintBitsToFloat(weights[at]), uintBitsToFloat(weights[at + HIDDEN]));
                at += 2u * HIDDEN;
            }
            sum_0 += w.x * activations[2u * i];
            sum_1 += w.x * activations[2u * i + 1u];
            sum_0 += w.y * activations[2u * i + 2u];
            sum_1 += w.y * activations[2u * i + 3u];
        }
        base += words + HIDDEN;
        barrier();
        activations[2u * (ENCODING + thread)] = max(sum_0, vec4(0.0));
        activations[2u * (ENCODING + thread) + 1u] = max(sum_1, vec4(0.0));
        barrier();
    }

    // Heads: thread = (slice of 8 inputs, superpoint); the slices are added in order.
    uint s = thread % GROUP_SUPERPOINTS;
    uint slice = thread / GROUP_SUPERPOINTS;
    float head[6];
    for (uint o = 0u; o < HEADS; o++) {
        head[o] = 0.0;
    }
    for (uint j = 0u; j < HIDDEN / SLICES; j++) {
        uint i = slice * (HIDDEN / SLICES) + j;
        float h = activations[2u * (ENCODING + i) + s / 4u][s % 4u];
        for (uint o = 0u; o < HEADS; o++) {
            head[o] += h * uintBitsToFloat(weights[base + HEADS * i + o]);
        }
    }
    for (uint o = 0u; o < HEADS; o++) {
        partial_heads[(slice * HEADS + o) * GROUP_SUPERPOINTS + s] = head[o];
    }
    barrier();
    if (thread < 2u * GROUP_SUPERPOINTS) {
        // One thread per (r or tau, superpoint).
        uint which = thread / GROUP_SUPERPOINTS;
        vec3 sum = vec3(0.0);
        for (uint c = 0u; c < 3u; c++) {
            uint o = 3u * which + c;
            float total = uintBitsToFloat(weights[base + HEADS * HIDDEN + o]);
            for (uint k = 0u; k < SLICES; k++) {
                total += partial_heads[(k * HEADS + o) * GROUP_SUPERPOINTS + s];
            }
            sum[c] = total;
        }
        if (first_superpoint + s < count) {
            pose[2u * (first_superpoint + s) + which] = vec4(sum, 0.0);
        }
    }
}
