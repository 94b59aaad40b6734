// Offsets of Gaussians that follow control nodes (SC-GS): sums over a Gaussian's nodes of weight times what the field says of
// the node. The head's outputs are dx, dq, ds, and, with TURN, a quaternion (plus 1) that turns what is around the node. dq
// is added to the quaternion as stored; deform_project adds it to the unit one.
#version 460
#extension GL_GOOGLE_include_directive : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint TURN = 0;

#include "lib/frame.glsl"
#include "lib/dispatch.glsl"
#include "lib/quaternion.glsl"

layout(std430, set = 0, binding = 1) readonly buffer HeadOutputBlock { float head_output[]; }; // [nodes, outputs]
layout(std430, set = 0, binding = 2) readonly buffer MeanBlock { float mean[]; };
layout(std430, set = 0, binding = 3) readonly buffer RotationBlock { vec4 rotation[]; };
layout(std430, set = 0, binding = 4) readonly buffer NodePositionBlock { float node_position[]; }; // [3][nodes]
layout(std430, set = 0, binding = 5) readonly buffer NodeNeighborBlock { uint node_neighbor[]; };  // [N, neighbors]
layout(std430, set = 0, binding = 6) readonly buffer NodeWeightBlock { float node_weight[]; };     // [N, neighbors]
layout(std430, set = 0, binding = 7) readonly buffer NodeShareBlock { float node_share[]; };       // [N]
layout(std430, set = 0, binding = 8) writeonly buffer NonrigidOffsetBlock { float nonrigid_offset[]; }; // [10][N]

layout(push_constant) uniform Push { uint nodes; uint neighbors; uint outputs; } push;

vec3 output_vector(uint at) {
    return vec3(head_output[at], head_output[at + 1u], head_output[at + 2u]);
}

void main() {
    uint turn = TURN;
    uint n = frame.gaussians;
    uint g = workgroup_index() * 256u + gl_LocalInvocationIndex;
    if (g >= n) {
        return;
    }
    vec3 x = vec3(mean[g], mean[n + g], mean[2u * n + g]);
    vec3 dx = vec3(0.0);
    vec4 dq = vec4(0.0);
    vec3 ds = vec3(0.0);
    for (uint k = 0u; k < push.neighbors; k++) {
        uint node = min(node_neighbor[g * push.neighbors + k], push.nodes - 1u);
        float weight = node_weight[g * push.neighbors + k];
        uint at = node * push.outputs;
        vec3 moved = output_vector(at);
        if (turn == 1u) {
            vec4 e = vec4(output_vector(at + 10u), head_output[at + 13u]) + vec4(1.0, 0.0, 0.0, 0.0);
            vec3 place = vec3(node_position[node], node_position[push.nodes + node], node_position[2u * push.nodes + node]);
            moved += quaternion_displacement(e / length(e), x - place);
        }
        dx += weight * moved;
        dq += weight * vec4(output_vector(at + 3u), head_output[at + 6u]);
        ds += weight * output_vector(at + 7u);
    }
    float share = node_share[g];
    dx *= share;
    dq *= share / length(rotation[g]);
    ds *= share;
    for (uint i = 0u; i < 3u; i++) {
        nonrigid_offset[i * n + g] = dx[i];
        nonrigid_offset[(7u + i) * n + g] = ds[i];
    }
    for (uint i = 0u; i < 4u; i++) {
        nonrigid_offset[(3u + i) * n + g] = dq[i];
    }
}
