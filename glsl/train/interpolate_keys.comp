// Poses at a step's time, from the key poses on both sides of it: rotation vector and translation are linear in between, as
// where they are played. One superpoint per thread.
#version 460
#extension GL_GOOGLE_include_directive : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

#define STEP_BINDING 0
#include "lib/step.glsl"
#include "lib/dispatch.glsl"
#include "lib/key_pose.glsl"

layout(std430, set = 0, binding = 1) readonly buffer KeyBlock { float key[]; };
layout(std430, set = 0, binding = 2) readonly buffer KeySuperpointBlock { float key_superpoint[]; };
layout(std430, set = 0, binding = 3) writeonly buffer PoseBlock { vec4 pose[]; }; // [M][2]: (r, 0), (tau, 0)

vec3 key_words(uint at, uint word, uint j) {
    uint m = step_data.superpoints;
    uint i = (at * KEY_WORDS + word) * m + j;
    return vec3(key[i], key[i + m], key[i + 2u * m]);
}

vec3 translation(uint at, vec3 center, uint j) {
    vec3 r = key_words(at, KEY_ROTATION, j);
    return key_words(at, KEY_PLACE, j) - (center + quaternion_displacement(quaternion_exp(r), center));
}

void main() {
    uint j = workgroup_index() * 256u + gl_LocalInvocationIndex;
    uint m = step_data.superpoints;
    if (j < m) {
        uint first = step_data.key_first;
        uint second = step_data.key_second;
        float weight = step_data.key_weight;
        vec3 center = vec3(key_superpoint[j], key_superpoint[m + j], key_superpoint[2u * m + j]);
        vec3 r = (1.0 - weight) * key_words(first, KEY_ROTATION, j) + weight * key_words(second, KEY_ROTATION, j);
        vec3 tau = (1.0 - weight) * translation(first, center, j) + weight * translation(second, center, j);
        pose[2u * j] = vec4(r, 0.0);
        pose[2u * j + 1u] = vec4(tau, 0.0);
    }
}
