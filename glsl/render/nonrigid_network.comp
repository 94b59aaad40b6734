// Network G for every Gaussian: its rigidly moved centre and the time to (dx, dq, ds), as planes.
//
// A workgroup owns 64 Gaussians. Activations lie in shared memory, [64 inputs][64 Gaussians]: with the 84 encoded inputs at
// once there would be too few subgroups in flight, so the last 20 of them follow when the first 64 have been summed. A thread
// owns 4 Gaussians (one vec4) and 8 outputs of the current layer (STAGE 0: 16, and half of the threads none). Threads of a subgroup share their
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
layout(constant_id = 3) const uint BLEND = 0; // see lib/superpoint_motion.glsl

#include "lib/frame.glsl"
#include "lib/dispatch.glsl"
#include "lib/thread.glsl"
#include "lib/quaternion.glsl"
#include "lib/encoding.glsl"
#include "lib/relu.glsl"

layout(std430, set = 0, binding = 1) readonly buffer MeanBlock { float mean[]; };
layout(std430, set = 0, binding = 2) readonly buffer SuperpointOfGaussianBlock { uint superpoint_of_gaussian[]; };
layout(std430, set = 0, binding = 3) readonly buffer PoseBlock { vec4 pose[]; };
layout(std430, set = 0, binding = 4) readonly buffer ParameterBlock { vec4 parameter[]; };
layout(std430, set = 0, binding = 5) writeonly buffer NonrigidOffsetBlock { float nonrigid_offset[]; }; // [10][N]
layout(std430, set = 0, binding = 6) readonly buffer BlendIndexBlock { uint blend_index[]; };
layout(std430, set = 0, binding = 7) readonly buffer BlendWeightBlock { float blend_weight[]; };

layout(push_constant) uniform Push { float origin_x; float origin_y; float origin_z; } push;

#include "lib/moved_centre.glsl"

const uint GROUP_THREADS = 128u;
const uint GROUP_GAUSSIANS = 64u;
const uint PARTS = 16u; // vec4 of Gaussians
const uint ENCODED = 84u;
const uint HIDDEN = 64u;
const uint HEAD_ROWS = 12u;
const uint HEADS = 10u;

shared vec4 activations[64 * 16];

// Adds inputs [first, end) of `inputs` to the sums of the outputs from first_output on; activations begin with input `first`,
// weights at vec4 `base`, rows has their number.
void accumulate_outputs(
    uint base, uint inputs, uint first, uint end, uint rows, uint first_output, uint part, inout vec4 sum[16]
) {
    uint size = SUBGROUP_SIZE;
    uint stage = STAGE;
    uint lane = gl_SubgroupInvocationID;
    if (stage == 0u) {
        for (uint k = first; k < end; k += 4u) {
            vec4 own[4]; // weights of outputs lane, lane + size, ..
            for (uint i = 0u; i < 4u; i++) {
                if (i * size < 16u) {
                    uint o = min(first_output + (i * size + lane) % 16u, rows - 1u);
                    own[i] = parameter[base + (o * inputs + k) / 4u];
                }
            }
            for (uint j = 0u; j < 4u; j++) {
                vec4 a = activations[(k - first + j) * PARTS + part];
                for (uint o = 0u; o < 16u; o++) {
                    sum[o] += subgroupShuffle(own[o / size][j], o % size) * a;
                }
            }
        }
    } else {
        for (uint k = first; k < end; k += 4u) {
            uint at = (k - first) * PARTS + part;
            vec4 a_0 = activations[at];
            vec4 a_1 = activations[at + PARTS];
            vec4 a_2 = activations[at + 2u * PARTS];
            vec4 a_3 = activations[at + 3u * PARTS];
            for (uint o = 0u; o < 8u; o++) {
                vec4 w = parameter[base + (min(first_output + o, rows - 1u) * inputs + k) / 4u];
                sum[o] += w.x * a_0 + w.y * a_1 + w.z * a_2 + w.w * a_3;
            }
        }
    }
}

// Elements [first, end) of the encoding; the centre is that of Gaussian thread % 64.
void encode(uint first, uint end, uint thread, vec4 centre) {
    uint g = thread % GROUP_GAUSSIANS;
    for (uint at = first + thread / GROUP_GAUSSIANS; at < end; at += GROUP_THREADS / GROUP_GAUSSIANS) {
        EncodedElement e = encoded_element(at);
        activations[(at - first) * PARTS + g / 4u][g % 4u] = encoded_value(e, centre[e.axis]);
    }
}

void main() {
    uint stage = STAGE;
    uint thread = thread_index();
    uint part = thread % PARTS;
    uint per_thread = stage == 0u ? 16u : 8u;
    // With STAGE 0, for subgroups of at most PARTS lanes, the same for the whole subgroup: it decides who shuffles.
    uint size = SUBGROUP_SIZE;
    uint first_output = (stage == 0u ? gl_SubgroupID * size / PARTS : thread / PARTS) * per_thread;
    uint count = frame.gaussians;
    uint first_gaussian = workgroup_index() * GROUP_GAUSSIANS;

    // A thread encodes elements of one Gaussian, its own or the one that 64 threads before it has moved.
    if (thread < GROUP_GAUSSIANS) {
        uint g = min(first_gaussian + thread, max(count, 1u) - 1u);
        activations[thread] = vec4(moved_centre(g) + vec3(push.origin_x, push.origin_y, push.origin_z), frame.time);
    }
    barrier();
    vec4 centre = activations[thread % GROUP_GAUSSIANS];
    barrier();
    encode(0u, HIDDEN, thread, centre);
    barrier();

    uint base = 0u; // vec4
    vec4 sum[16];
    for (uint o = 0u; o < 16u; o++) {
        sum[o] = vec4(0.0);
    }
    // Layer 0 takes two passes, the others one.
    for (uint pass = 0u; pass < 5u; pass++) {
        uint layer = max(pass, 1u) - 1u;
        uint inputs = layer == 0u ? ENCODED : HIDDEN;
        uint outputs = layer == 3u ? HEAD_ROWS : HIDDEN;
        uint first = pass == 1u ? HIDDEN : 0u;
        uint end = first_output < outputs ? min(inputs, first + HIDDEN) : first;
        accumulate_outputs(base, inputs, first, end, outputs, first_output, part, sum);
        barrier();
        if (pass == 0u) {
            encode(HIDDEN, ENCODED, thread, centre);
        } else {
            uint bias_at = base + outputs * inputs / 4u;
            base = (base + outputs * (inputs + 1u) / 4u + 15u) / 16u * 16u;
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
                sum[o] = vec4(0.0);
            }
        }
        barrier();
    }
}
