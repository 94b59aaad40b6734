#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_EXT_control_flow_attributes : require

// The K nearest superpoints of each Gaussian in canonical space, exact, nearest first, ties by lowest index; the row of
// remembered superpoints is brought up to date (in use first, then those that left, latest first); softmax of the logits;
// pairs (superpoint, slot and Gaussian) for the sort. Twin: engine/src/train/association/nearest.rs.

layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

#define STEP_BINDING 0
#include "lib/step.glsl"
#define STATUS_BINDING 13
#include "lib/status.glsl"
#include "lib/limits.glsl"
#include "lib/dispatch.glsl"
#include "lib/association.glsl"

layout(local_size_x = 256) in;

layout(std430, set = 0, binding = 1) readonly buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 2) readonly buffer MeanBlock { float mean[]; };
layout(std430, set = 0, binding = 3) readonly buffer SuperpointPositionBlock { float superpoint_position[]; };
layout(std430, set = 0, binding = 4) readonly buffer SuperpointOfGaussianBlock { uint superpoint_of_gaussian[]; };
layout(std430, set = 0, binding = 5) buffer NeighborBlock { uint neighbor[]; };
layout(std430, set = 0, binding = 6) buffer LogitBlock { float logit[]; };
layout(std430, set = 0, binding = 7) buffer LogitMoment1Block { float logit_moment_1[]; };
layout(std430, set = 0, binding = 8) buffer LogitMoment2Block { float logit_moment_2[]; };
layout(std430, set = 0, binding = 9) writeonly buffer WeightBlock { float weight[]; };
layout(std430, set = 0, binding = 10) writeonly buffer NextSuperpointBlock { uint next_superpoint[]; };
layout(std430, set = 0, binding = 11) writeonly buffer PairKeyBlock { uint pair_key[]; };
layout(std430, set = 0, binding = 12) writeonly buffer PairValueBlock { uint pair_value[]; };

const uint INFINITE = 0x7f800000u;
const uint LARGEST = 0x7f7fffffu;
const uint BATCH = 8u;

// Squared distance, never NaN: what overflows counts as the largest number. Without contraction, so that ties are ties
// on every device.
float squared_distance(vec3 a, vec3 b) {
    precise float x = a.x - b.x;
    precise float y = a.y - b.y;
    precise float z = a.z - b.z;
    precise float d = x * x + y * y + z * z;
    return number_is_finite(d) ? d : uintBitsToFloat(LARGEST);
}

// Inserts a candidate with an index above all earlier ones into the list sorted by distance.
void insert(float d, uint index, inout float distance_to[MAX_NEIGHBORS], inout uint nearest[MAX_NEIGHBORS]) {
    uint neighbors = NEIGHBORS;
    [[unroll]] for (uint k = MAX_NEIGHBORS - 1u; k > 0u; k--) {
        if (k < neighbors) {
            bool before = d < distance_to[k - 1u];
            bool here = d < distance_to[k];
            distance_to[k] = before ? distance_to[k - 1u] : here ? d : distance_to[k];
            nearest[k] = before ? nearest[k - 1u] : here ? index : nearest[k];
        }
    }
    bool first = d < distance_to[0];
    distance_to[0] = first ? d : distance_to[0];
    nearest[0] = first ? index : nearest[0];
}

vec3 position_of(uint superpoint) {
    uint at = 3u * superpoint;
    return vec3(superpoint_position[at], superpoint_position[at + 1u], superpoint_position[at + 2u]);
}

// No nearest superpoint is farther than this: the farthest of those in use so far, if they are as many different ones.
float farthest_in_use(vec3 x, uint old[MAX_SLOTS]) {
    uint neighbors = NEIGHBORS;
    uint superpoints = step_data.counts.y;
    float bound = 0.0;
    bool known = true;
    [[unroll]] for (uint k = 0u; k < MAX_NEIGHBORS; k++) {
        if (k < neighbors) {
            known = known && old[k] < superpoints;
            [[unroll]] for (uint l = 0u; l < k; l++) {
                known = known && old[k] != old[l];
            }
            bound = max(bound, squared_distance(x, position_of(min(old[k], superpoints - 1u))));
        }
    }
    return known ? bound : uintBitsToFloat(INFINITE);
}

// Each lane loads one superpoint and the subgroup takes turns to broadcast it: no shared memory, no barrier. Of eight
// candidates at a time only those are inserted that some lane is near enough to, which are few once the superpoints in use
// bound the distance.
void find_nearest(vec3 x, float bound, inout uint nearest[MAX_NEIGHBORS]) {
    uint size = SUBGROUP_SIZE;
    uint batch = min(size, BATCH);
    uint neighbors = NEIGHBORS;
    uint superpoints = step_data.counts.y;
    float distance_to[MAX_NEIGHBORS];
    [[unroll]] for (uint k = 0u; k < MAX_NEIGHBORS; k++) {
        distance_to[k] = uintBitsToFloat(INFINITE);
    }
    for (uint base = 0u; base < superpoints; base += size) {
        vec3 p = position_of(min(base + gl_SubgroupInvocationID, superpoints - 1u));
        for (uint first = 0u; first < size; first += batch) {
            float d[BATCH];
            float largest = min(bound, distance_to[neighbors - 1u]);
            uint near = 0u;
            [[unroll]] for (uint j = 0u; j < BATCH; j++) {
                uint lane = min(first + j, size - 1u);
                vec3 q = vec3(subgroupShuffle(p.x, lane), subgroupShuffle(p.y, lane), subgroupShuffle(p.z, lane));
                d[j] = squared_distance(x, q);
                bool candidate = j < batch && base + first + j < superpoints && d[j] <= largest;
                near |= candidate ? 1u << j : 0u;
            }
            uint left = subgroupOr(near);
            for (uint r = 0u; r < BATCH && left != 0u; r++) {
                uint j = uint(findLSB(left));
                left &= left - 1u;
                float chosen = d[0];
                [[unroll]] for (uint i = 1u; i < BATCH; i++) {
                    chosen = i == j ? d[i] : chosen;
                }
                insert((near & 1u << j) != 0u ? chosen : uintBitsToFloat(INFINITE), base + first + j, distance_to, nearest);
            }
        }
    }
}

void write_slot(uint at, uint superpoint, vec3 value) {
    neighbor[at] = superpoint;
    logit[at] = value.x;
    logit_moment_1[at] = value.y;
    logit_moment_2[at] = value.z;
}

// Rewrites a row whose superpoints in use have changed. Those that left keep logit and moments while slots last; the ones
// that left longest ago are forgotten first.
void rearrange(uint row, uint old[MAX_SLOTS], uint nearest[MAX_NEIGHBORS]) {
    uint neighbors = NEIGHBORS;
    uint slots = SLOTS;
    vec3 value[MAX_SLOTS];
    [[unroll]] for (uint s = 0u; s < MAX_SLOTS; s++) {
        if (s < slots) {
            value[s] = vec3(logit[row + s], logit_moment_1[row + s], logit_moment_2[row + s]);
        }
    }
    [[unroll]] for (uint k = 0u; k < MAX_NEIGHBORS; k++) {
        if (k < neighbors) {
            vec3 kept = vec3(NEW_LOGIT, 0.0, 0.0);
            [[unroll]] for (uint s = 0u; s < MAX_SLOTS; s++) {
                if (s < slots && old[s] == nearest[k]) {
                    kept = value[s];
                }
            }
            write_slot(row + k, nearest[k], kept);
        }
    }
    uint to = neighbors;
    [[unroll]] for (uint s = 0u; s < MAX_SLOTS; s++) {
        if (s < slots) {
            bool left = old[s] != NO_SUPERPOINT;
            [[unroll]] for (uint k = 0u; k < MAX_NEIGHBORS; k++) {
                left = left && (k >= neighbors || old[s] != nearest[k]);
            }
            if (left && to < slots) {
                write_slot(row + to, old[s], value[s]);
                to++;
            }
        }
    }
}

void update_row(uint row, uint old[MAX_SLOTS], uint nearest[MAX_NEIGHBORS]) {
    uint neighbors = NEIGHBORS;
    bool changed = false;
    [[unroll]] for (uint k = 0u; k < MAX_NEIGHBORS; k++) {
        changed = changed || (k < neighbors && old[k] != nearest[k]);
    }
    if (changed && counters[COUNT_FAILED] == 0u) {
        rearrange(row, old, nearest);
    }
}

// Softmax over the superpoints in use. All weights are 0 when a logit is not finite.
void write_weights(uint i, uint row, uint nearest[MAX_NEIGHBORS]) {
    uint neighbors = NEIGHBORS;
    uint n = step_data.counts.x;
    float value[MAX_NEIGHBORS];
    bool finite = true;
    float top = 0.0;
    uint best = 0u;
    [[unroll]] for (uint k = 0u; k < MAX_NEIGHBORS; k++) {
        if (k < neighbors) {
            value[k] = logit[row + k];
            finite = finite && number_is_finite(value[k]);
            bool larger = k == 0u || value[k] > top;
            top = larger ? value[k] : top;
            best = larger ? nearest[k] : best;
        }
    }
    float sum = 0.0;
    [[unroll]] for (uint k = 0u; k < MAX_NEIGHBORS; k++) {
        if (k < neighbors) {
            value[k] = exp(value[k] - top);
            sum += value[k];
        }
    }
    [[unroll]] for (uint k = 0u; k < MAX_NEIGHBORS; k++) {
        if (k < neighbors) {
            weight[k * n + i] = finite ? value[k] / sum : 0.0;
        }
    }
    next_superpoint[i] = finite ? best : nearest[0];
    if (!finite) {
        report_not_finite(STATUS_ASSOCIATION, i);
    }
}

void write_pairs(uint i, uint nearest[MAX_NEIGHBORS]) {
    uint neighbors = NEIGHBORS;
    uint n = step_data.counts.x;
    [[unroll]] for (uint k = 0u; k < MAX_NEIGHBORS; k++) {
        if (k < neighbors) {
            pair_key[k * n + i] = nearest[k];
            pair_value[k * n + i] = (k << PAIR_SHIFT) | i;
        }
    }
    pair_key[neighbors * n + i] = min(superpoint_of_gaussian[i], step_data.counts.y - 1u);
    pair_value[neighbors * n + i] = (neighbors << PAIR_SHIFT) | i;
}

void main() {
    uint i = workgroup_index() * 256u + gl_LocalInvocationID.x;
    uint slots = SLOTS;
    uint n = step_data.counts.x;
    // A thread without a Gaussian keeps its subgroup company, which shuffles need.
    uint at = min(i, n - 1u);
    vec3 x = vec3(mean[at], mean[n + at], mean[2u * n + at]);
    uint nearest[MAX_NEIGHBORS];
    [[unroll]] for (uint k = 0u; k < MAX_NEIGHBORS; k++) {
        nearest[k] = 0u;
    }
    uint old[MAX_SLOTS];
    [[unroll]] for (uint s = 0u; s < MAX_SLOTS; s++) {
        old[s] = s < slots ? neighbor[at * slots + s] : NO_SUPERPOINT;
    }
    find_nearest(x, farthest_in_use(x, old), nearest);
    if (i < n) {
        update_row(i * slots, old, nearest);
        write_weights(i, i * slots, nearest);
        write_pairs(i, nearest);
    }
}
