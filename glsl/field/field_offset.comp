// What a deformation field's head says of the Gaussians from push.first_row on, as offsets that deform_project adds:
// dx to the centre, dq to the unit quaternion, ds to the scale. RULE 0: the head's outputs are just that. 1: w, v, dq, ds,
// the centre moves by the screw exp(t (w, v) / t), t = |w|, with 1e-5 added to each component as in the released code of
// Deformable-3DGS. 2: dx, and dq and dl before activation: to the quaternion as stored and to the logarithm of the scale.
#version 460
#extension GL_GOOGLE_include_directive : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint RULE = 0;

#include "lib/frame.glsl"
#include "lib/dispatch.glsl"
#include "lib/angle.glsl"

layout(std430, set = 0, binding = 1) readonly buffer HeadOutputBlock { float head_output[]; }; // [rows, outputs]
layout(std430, set = 0, binding = 2) readonly buffer MeanBlock { float mean[]; };
layout(std430, set = 0, binding = 3) readonly buffer LogScaleBlock { float log_scale[]; };
layout(std430, set = 0, binding = 4) readonly buffer RotationBlock { vec4 rotation[]; };
layout(std430, set = 0, binding = 5) writeonly buffer NonrigidOffsetBlock { float nonrigid_offset[]; }; // [10][N]

layout(push_constant) uniform Push { uint first_row; uint rows; uint outputs; } push;

const float SCREW_EPSILON = 1e-5;

vec3 output_vector(uint at) {
    return vec3(head_output[at], head_output[at + 1u], head_output[at + 2u]);
}

vec3 screw(vec3 w, vec3 v, vec3 x) {
    float theta = length(w);
    if (!(theta > 1e-12)) {
        return v;
    }
    vec3 axis = w / theta + SCREW_EPSILON;
    vec3 moment = v / theta + SCREW_EPSILON;
    vec2 wave = sin_cos(theta);
    float half_sine = sin_cos(0.5 * theta).x;
    float versine = 2.0 * half_sine * half_sine;
    vec3 x_1 = cross(axis, x);
    vec3 m_1 = cross(axis, moment);
    return wave.x * x_1 + versine * cross(axis, x_1) + theta * moment + versine * m_1
         + (theta - wave.x) * cross(axis, m_1);
}

void main() {
    uint rule = RULE;
    uint row = workgroup_index() * 256u + gl_LocalInvocationIndex;
    if (row >= push.rows) {
        return;
    }
    uint n = frame.gaussians;
    uint g = push.first_row + row;
    uint at = row * push.outputs;
    uint after = at + (rule == 1u ? 6u : 3u);
    vec3 dx = output_vector(at);
    vec4 dq = vec4(output_vector(after), head_output[after + 3u]);
    vec3 ds = output_vector(after + 4u);
    if (rule == 1u) {
        dx = screw(dx, output_vector(at + 3u), vec3(mean[g], mean[n + g], mean[2u * n + g]));
    }
    if (rule == 2u) {
        dq /= length(rotation[g]);
        ds = exp(vec3(log_scale[g], log_scale[n + g], log_scale[2u * n + g])) * (exp(ds) - 1.0);
    }
    for (uint i = 0u; i < 3u; i++) {
        nonrigid_offset[i * n + g] = dx[i];
        nonrigid_offset[(7u + i) * n + g] = ds[i];
    }
    for (uint i = 0u; i < 4u; i++) {
        nonrigid_offset[(3u + i) * n + g] = dq[i];
    }
}
