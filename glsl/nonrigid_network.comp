// Network G for every Gaussian: its rigidly moved centre and the time to (dx, dq, ds), as planes.
//
// A workgroup owns 64 Gaussians. Activations lie in shared memory, [inputs][64 Gaussians]; a thread owns 4 Gaussians (one
// vec4) and 8 outputs of the current layer (STAGE 0: 16, and half of the threads none). Threads of a subgroup share their
// outputs, so that a weight is one broadcast read (STAGE 1), or is read once by some lane and shuffled (STAGE 0, for devices
// where a read costs the same whatever the neighbours do). Layers 84 -> 64 -> 64 -> 64 with ReLU, then 10 outputs (12 rows
// of weights, two of them 0). `parameter` holds each layer's [outputs][inputs] and bias, padded to 64 floats, as training
// keeps them.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_shuffle : require

layout(local_size_x = 128) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint MOTION = 1; // 0 static, 1 pose table
layout(constant_id = 2) const uint STAGE = 1;

#include "lib/frame.glsl"
#include "lib/dispatch.glsl"
#include "lib/quaternion.glsl"
#include "lib/encoding.glsl"
#include "lib/relu.glsl"

layout(std430, set = 0, binding = 1) readonly buffer MeanBlock { float mean[]; };
layout(std430, set = 0, binding = 2) readonly buffer SuperpointOfGaussianBlock { uint superpoint_of_gaussian[]; };
layout(std430, set = 0, binding = 3) readonly buffer PoseBlock { vec4 pose[]; };
layout(std430, set = 0, binding = 4) readonly buffer ParameterBlock { vec4 parameter[]; };
layout(std430, set = 0, binding = 5) writeonly buffer NonrigidOffsetBlock { float nonrigid_offset[]; }; // [10][N]

layout(push_constant) uniform Push { float origin_x; float origin_y; float origin_z; } push;

#include "lib/moved_centre.glsl"

const uint GROUP_THREADS = 128u;
const uint GROUP_GAUSSIANS = 64u;
const uint PARTS = 16u; // vec4 of Gaussians
const uint ENCODED = 84u;
const uint HIDDEN = 64u;
const uint HEAD_ROWS = 12u;
const uint HEADS = 10u;

shared vec4 activations[84 * 16];
shared vec4 centres[64];

// Sums of `count` outputs from first_output on, over `inputs` inputs; weights start at vec4 `base`, rows has their number.
void accumulate_outputs(uint base, uint inputs, uint rows, uint first_output, uint part, inout vec4 sum[16]) {
    uint size = SUBGROUP_SIZE;
    uint stage = STAGE;
    uint lane = gl_SubgroupInvocationID;
    if (stage == 0u) {
        for (uint k = 0u; k < inputs; k += 4u) {
            vec4 own[4]; // weights of outputs lane, lane + size, ..
            for (uint i = 0u; i < 4u; i++) {
                if (i * size < 16u) {
                    uint o = min(first_output + (i * size + lane) % 16u, rows - 1u);
                    own[i] = parameter[base + (o * inputs + k) / 4u];
                }
            }
            for (uint j = 0u; j < 4u; j++) {
                vec4 a = activations[(k + j) * PARTS + part];
                for (uint o = 0u; o < 16u; o++) {
                    sum[o] += subgroupShuffle(own[o / size][j], o % size) * a;
                }
            }
        }
    } else {
        for (uint k = 0u; k < inputs; k += 4u) {
            vec4 a_0 = activations[k * PARTS + part];
            vec4 a_1 = activations[(k + 1u) * PARTS + part];
            vec4 a_2 = activations[(k + 2u) * PARTS + part];
            vec4 a_3 = activations[(k + 3u) * PARTS + part];
            for (uint o = 0u; o < 8u; o++) {
                vec4 w = parameter[base + (min(first_output + o, rows - 1u) * inputs + k) / 4u];
                sum[o] += w.x * a_0 + w.y * a_1 + w.z * a_2 + w.w * a_3;
            }
        }
    }
}

void main() {
    uint stage = STAGE;
    uint thread = gl_LocalInvocationIndex;
    uint part = thread % PARTS;
    uint per_thread = stage == 0u ? 16u : 8u;
    uint first_output = thread / PARTS * per_thread;
    uint count = frame.counts.x;
    uint first_gaussian = workgroup_index() * GROUP_GAUSSIANS;

    if (thread < GROUP_GAUSSIANS) {
        uint g = min(first_gaussian + thread, max(count, 1u) - 1u);
        centres[thread] = vec4(moved_centre(g) + vec3(push.origin_x, push.origin_y, push.origin_z), frame.background.w);
    }
    barrier();
    for (uint item = thread; item < ENCODED * GROUP_GAUSSIANS; item += GROUP_THREADS) {
        uint g = item % GROUP_GAUSSIANS;
        EncodedElement e = encoded_element(item / GROUP_GAUSSIANS);
        activations[item / GROUP_GAUSSIANS * PARTS + g / 4u][g % 4u] = encoded_value(e, centres[g][e.axis]);
    }
    barrier();

    uint base = 0u; // vec4
    for (uint layer = 0u; layer < 4u; layer++) {
        uint inputs = layer == 0u ? ENCODED : HIDDEN;
        uint outputs = layer == 3u ? HEAD_ROWS : HIDDEN;
        vec4 sum[16];
        for (uint o = 0u; o < 16u; o++) {
            sum[o] = vec4(0.0);
        }
        bool busy = first_output < outputs;
        accumulate_outputs(base, busy ? inputs : 0u, outputs, first_output, part, sum);
        uint bias_at = base + outputs * inputs / 4u;
        base = (base + outputs * (inputs + 1u) / 4u + 15u) / 16u * 16u;
        barrier();
        for (uint o = 0u; o < per_thread; o++) {
            uint output_index = first_output + o;
            if (output_index < outputs) {
                vec4 y = sum[o] + parameter[bias_at + output_index / 4u][output_index % 4u];
                if (layer < 3u) {
                    activations[output_index * PARTS + part] = relu(y);
                } else if (output_index < HEADS) {
                    for (uint i = 0u; i < 4u; i++) {
                        uint g = first_gaussian + 4u * part + i;
                        if (g < count) {
                            nonrigid_offset[output_index * count + g] = y[i];
                        }
                    }
                }
            }
        }
        barrier();
    }
}
