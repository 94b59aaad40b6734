#version 460
#extension GL_GOOGLE_include_directive : require

// The two children of a split Gaussian: centres drawn from the parent's normal distribution, scales divided by 1.6.

#include "lib/dispatch.glsl"
#include "lib/density.glsl"
#include "lib/random.glsl"

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

layout(std430, set = 0, binding = 0) readonly buffer SourceBlock { uint source[]; };
layout(std430, set = 0, binding = 1) readonly buffer RotationBlock { vec4 rotation[]; };
layout(std430, set = 0, binding = 2) buffer MeanBlock { float mean[]; };
layout(std430, set = 0, binding = 3) buffer LogScaleBlock { float log_scale[]; };

layout(push_constant) uniform PushBlock {
    uint rows;
    uint seed_low;
    uint seed_high;
    uint iteration;
} push;

// v rotated by the unit quaternion (w, u).
vec3 rotate(float w, vec3 u, vec3 v) {
    vec3 t = 2.0 * cross(u, v);
    return v + w * t + cross(u, t);
}

void main() {
    uint row = workgroup_index() * 256u + gl_LocalInvocationID.x;
    if (row >= push.rows) {
        return;
    }
    uint s = source[row];
    uint kind = s >> 30u;
    if (kind < KIND_CHILD_0) {
        return;
    }
    uint n = push.rows;
    vec3 parent = vec3(log_scale[row], log_scale[n + row], log_scale[2u * n + row]);
    uvec4 words = random_words(uvec2(push.seed_low, push.seed_high), push.iteration,
        uvec2(s & SOURCE_ROW, kind - KIND_CHILD_0), 0u);
    vec3 normal = vec3(random_normals(words.x, words.y), random_normals(words.z, words.w).x);
    vec4 q = rotation[row]; // w, x, y, z
    float inverse_length = inversesqrt(max(dot(q, q), 1.0e-24));
    q *= inverse_length;
    vec3 offset = rotate(q.x, q.yzw, exp(parent) * normal);
    for (uint axis = 0u; axis < 3u; axis++) {
        float moved = mean[axis * n + row] + offset[axis];
        // By bits: whatever overflows stays where the parent is.
        if ((floatBitsToUint(moved) & 0x7f800000u) != 0x7f800000u) {
            mean[axis * n + row] = moved;
        }
        log_scale[axis * n + row] = parent[axis] - SPLIT_LOG_SCALE;
    }
}
