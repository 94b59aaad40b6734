#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

// One round of farthest-point sampling over 1,024 points per workgroup: every workgroup finds the point farthest from
// those chosen so far among the candidates of the round before, takes the distance of its points to it, and leaves its
// own candidate for the next round.

layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

#include "lib/dispatch.glsl"
#include "lib/thread.glsl"

layout(local_size_x = 256) in;

layout(std430, set = 0, binding = 0) readonly buffer MeanBlock { float mean[]; };
layout(std430, set = 0, binding = 1) readonly buffer CandidatesInBlock { uint candidates_in[]; };
layout(std430, set = 0, binding = 2) buffer DistanceToBlock { float distance_to[]; };
layout(std430, set = 0, binding = 3) writeonly buffer CandidatesOutBlock { uint candidates_out[]; };
layout(std430, set = 0, binding = 4) writeonly buffer ChosenBlock { uint chosen[]; };
layout(std430, set = 0, binding = 5) writeonly buffer SuperpointPositionBlock { float superpoint_position[]; };

layout(push_constant) uniform PushBlock {
    uint points;
    uint round;      // which point is chosen now
    uint candidates; // in candidates_in: distance, index
} push;

const uint POINTS_PER_THREAD = 4u;
const uint NO_POINT = 0xffffffffu;

shared float best_distance[64]; // one per subgroup: 256 / 4
shared uint best_index[64];

bool number_is_finite(float x) {
    return (floatBitsToUint(x) & 0x7f800000u) != 0x7f800000u;
}

// The largest distance of the workgroup and the lowest index that has it. Every thread calls it; contains barriers.
void farthest(inout float d, inout uint index) {
    float top = subgroupMax(d);
    uint lowest = subgroupMin(d == top ? index : NO_POINT);
    if (gl_SubgroupInvocationID == 0u) {
        best_distance[gl_SubgroupID] = top;
        best_index[gl_SubgroupID] = lowest;
    }
    barrier();
    d = best_distance[0];
    index = best_index[0];
    for (uint s = 1u; s < gl_NumSubgroups; s++) {
        bool better = best_distance[s] > d || (best_distance[s] == d && best_index[s] < index);
        d = better ? best_distance[s] : d;
        index = better ? best_index[s] : index;
    }
    barrier();
}

void main() {
    uint group = workgroup_index();
    uint thread = thread_index();
    uint n = push.points;
    float d = -2.0;
    uint index = NO_POINT;
    for (uint c = thread; c < push.candidates; c += 256u) {
        float other = uintBitsToFloat(candidates_in[2u * c]);
        uint other_index = candidates_in[2u * c + 1u];
        bool better = other > d || (other == d && other_index < index);
        d = better ? other : d;
        index = better ? other_index : index;
    }
    farthest(d, index);
    uint center = min(index, n - 1u);
    vec3 p = vec3(mean[center], mean[n + center], mean[2u * n + center]);

    float far = -2.0;
    uint far_index = NO_POINT;
    for (uint r = 0u; r < POINTS_PER_THREAD; r++) {
        uint i = group * (256u * POINTS_PER_THREAD) + r * 256u + thread;
        if (i < n) {
            vec3 q = vec3(mean[i], mean[n + i], mean[2u * n + i]);
            precise float x = q.x - p.x;
            precise float y = q.y - p.y;
            precise float z = q.z - p.z;
            precise float step_to = x * x + y * y + z * z;
            float old = distance_to[i];
            float now = number_is_finite(step_to) ? min(old, step_to) : old;
            bool usable = number_is_finite(q.x) && number_is_finite(q.y) && number_is_finite(q.z);
            now = i == center || !usable ? -1.0 : now;
            distance_to[i] = now;
            far_index = now > far ? i : far_index;
            far = max(now, far);
        }
    }
    farthest(far, far_index);
    if (thread == 0u && group * (256u * POINTS_PER_THREAD) < n) {
        candidates_out[2u * group] = floatBitsToUint(far);
        candidates_out[2u * group + 1u] = far_index;
    }
    if (group == 0u && thread < 3u) {
        float value = p[thread];
        superpoint_position[3u * push.round + thread] = number_is_finite(value) ? value : 0.0;
        if (thread == 0u) {
            chosen[push.round] = center;
        }
    }
}
