// Adds to the poses of superpoints where the object that they are part of has gone by the step's time (exact, without noise),
// between two known places. One superpoint per thread.
#version 460
#extension GL_GOOGLE_include_directive : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;

#define STEP_BINDING 0
#include "lib/dispatch.glsl"
#include "lib/step.glsl"

layout(std430, set = 0, binding = 1) readonly buffer PathTimeBlock { float path_time[]; };     // [T], ascending
layout(std430, set = 0, binding = 2) readonly buffer PathOffsetBlock { float path_offset[]; }; // [T][3]
layout(std430, set = 0, binding = 3) readonly buffer FollowsBlock { uint follows[]; };         // [M], 0: no
layout(std430, set = 0, binding = 4) buffer PoseBlock { float pose[]; };                       // [M][8]: r, 0, tau, 0

layout(push_constant) uniform Push {
    uint superpoints;
    uint times; // at least 1
} push;

void main() {
    uint m = workgroup_index() * 256u + gl_LocalInvocationIndex;
    float t = step_data.exact_time;
    // The last key at or before t, the first one before all.
    uint key = 0u;
    for (uint next = 1u; next < push.times; next++) {
        key = path_time[next] <= t ? next : key;
    }
    uint other = min(key + 1u, push.times - 1u);
    float apart = path_time[other] - path_time[key];
    float share = apart > 0.0 ? clamp((t - path_time[key]) / apart, 0.0, 1.0) : 0.0;
    if (m < push.superpoints && follows[m] != 0u) {
        for (uint axis = 0u; axis < 3u; axis++) {
            float from = path_offset[3u * key + axis];
            float to = path_offset[3u * other + axis];
            pose[8u * m + 4u + axis] += from + share * (to - from);
        }
    }
}
