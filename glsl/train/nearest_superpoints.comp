#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_EXT_control_flow_attributes : require

// The K nearest superpoints of each Gaussian in canonical space, exact, nearest first, ties by lowest index; the row of
// remembered superpoints is brought up to date (in use first, then those that left, latest first); softmax of the logits;
// pairs (superpoint, slot and Gaussian) for the sort. With soft superpoints (BLEND, which is NEIGHBORS then) they also
// go to `blend_index`, as lib/superpoint_motion.glsl has it; this kernel then runs before the frame, and running it again
// changes nothing.

layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;
layout(constant_id = 3) const uint BLEND = 0u;
layout(constant_id = 4) const uint STAGE = 1u; // see find_nearest

#define STEP_BINDING 0
#include "lib/step.glsl"
#define STATUS_BINDING 13
#include "lib/status.glsl"
#include "lib/limits.glsl"
#include "lib/dispatch.glsl"
#include "lib/thread.glsl"
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
layout(std430, set = 0, binding = 14) writeonly buffer BlendIndexBlock { uint blend_index[]; };

const uint INFINITE = 0x7f800000u;
const uint LARGEST = 0x7f7fffffu;

// Without contraction, so that ties are ties on every device.
float squared_distance(vec3 a, vec3 b) {
    precise float x = a.x - b.x;
    precise float y = a.y - b.y;
    precise float z = a.z - b.z;
    precise float d = x * x + y * y + z * z;
    return d;
}

// Never NaN: what overflows counts as the largest number.
float finite_distance(vec3 a, vec3 b) {
    float d = squared_distance(a, b);
    return number_is_finite(d) ? d : uintBitsToFloat(LARGEST);
}

// Moves entry a of the sorted list on to b when candidate (d, index) comes before it, else puts the candidate there when it
// comes before b. Scalars rather than arrays: they stay in registers everywhere.
#define MOVE_ON(k, d_a, n_a, d_b, n_b)                \
    if (neighbors > k) {                              \
        bool before = d < d_a;                        \
        bool here = d < d_b;                          \
        n_b = before ? n_a : here ? index : n_b;      \
        d_b = before ? d_a : here ? d : d_b;          \
    }

// Above the K nearest: the farthest of last step's, where they are now, and a little more, so that one at that distance with a
// lower index is found. Infinite where the row has no K superpoints yet.
float upper_bound(vec3 x, uint row) {
    uint neighbors = NEIGHBORS;
    uint bound = 0u;
    [[unroll]] for (uint k = 0u; k < MAX_NEIGHBORS; k++) {
        if (k < neighbors) {
            uint j = neighbor[row + k];
            uint at = 3u * min(j, step_data.superpoints - 1u);
            vec3 q = vec3(superpoint_position[at], superpoint_position[at + 1u], superpoint_position[at + 2u]);
            // Positive floats are in the order of their bits.
            bound = max(bound, j < step_data.superpoints ? floatBitsToUint(finite_distance(x, q)) + 1u : INFINITE);
        }
    }
    return uintBitsToFloat(bound);
}

// Superpoints that are in shared memory at a time.
const uint STAGED = 256u;
// Those that are compared with the bound before the first of them is looked at: one comparison each is all that most need, and
// the lanes of a subgroup are close to different ones.
const uint CHUNK = 32u;

shared vec4 staged_position[STAGED];

// Which of the staged superpoints chunk .. chunk + 31 may be closer than `worst`, as bits.
uint close_ones(vec3 x, uint chunk, float worst) {
    // Then all are: what overflows is below infinity.
    bool unbounded = floatBitsToUint(worst) == INFINITE;
    uint close = 0u;
    for (uint part = 0u; part < CHUNK; part += 8u) {
        uint bits = 0u;
        [[unroll]] for (uint k = 0u; k < 8u; k++) {
            float d = squared_distance(x, staged_position[chunk + part + k].xyz);
            bits |= unbounded || !(d >= worst) ? 1u << k : 0u;
        }
        close |= bits << part;
    }
    return close;
}

// Puts a candidate at distance d into the sorted list, unless it is at `worst` or farther.
#define TAKE(d, candidate)                                                                                              \
    if (d < worst) {                                                                                                    \
        uint index = candidate;                                                                                         \
        MOVE_ON(6u, d_5, n_5, d_6, n_6)                                                                                 \
        MOVE_ON(5u, d_4, n_4, d_5, n_5)                                                                                 \
        MOVE_ON(4u, d_3, n_3, d_4, n_4)                                                                                 \
        MOVE_ON(3u, d_2, n_2, d_3, n_3)                                                                                 \
        MOVE_ON(2u, d_1, n_1, d_2, n_2)                                                                                 \
        MOVE_ON(1u, d_0, n_0, d_1, n_1)                                                                                 \
        n_0 = d < d_0 ? index : n_0;                                                                                    \
        d_0 = min(d, d_0);                                                                                              \
        float last = neighbors > 6u ? d_6 : neighbors > 5u ? d_5 : neighbors > 4u ? d_4 : neighbors > 3u ? d_3          \
            : neighbors > 2u ? d_2 : neighbors > 1u ? d_1 : d_0;                                                        \
        worst = min(worst, last);                                                                                       \
    }

// Candidates come in index order, so that of equal distances the lowest index stays first. Those from `worst` on are passed over.
// Every thread of the workgroup must call it. STAGE 0: each lane loads one superpoint and the subgroup takes turns to broadcast it,
// for devices where a load from shared memory costs as much for each lane; STAGE 1: superpoints in shared memory.
void find_nearest(vec3 x, float worst, out uint nearest[MAX_NEIGHBORS]) {
    uint size = SUBGROUP_SIZE;
    uint stage = STAGE;
    uint neighbors = NEIGHBORS;
    uint superpoints = step_data.superpoints;
    float d_0 = uintBitsToFloat(INFINITE);
    float d_1 = d_0, d_2 = d_0, d_3 = d_0, d_4 = d_0, d_5 = d_0, d_6 = d_0;
    uint n_0 = 0u, n_1 = 0u, n_2 = 0u, n_3 = 0u, n_4 = 0u, n_5 = 0u, n_6 = 0u;
    for (uint base = 0u; stage == 0u && base < superpoints; base += size) {
        uint mine = 3u * min(base + gl_SubgroupInvocationID, superpoints - 1u);
        vec3 p = vec3(superpoint_position[mine], superpoint_position[mine + 1u], superpoint_position[mine + 2u]);
        uint count = min(size, superpoints - base);
        for (uint j = 0u; j < count; j++) {
            vec3 q = vec3(subgroupShuffle(p.x, j), subgroupShuffle(p.y, j), subgroupShuffle(p.z, j));
            float d = finite_distance(x, q);
            TAKE(d, base + j)
        }
    }
    for (uint first = 0u; stage == 1u && first < superpoints; first += STAGED) {
        uint mine = 3u * min(first + thread_index(), superpoints - 1u);
        barrier();
        staged_position[thread_index()] =
            vec4(superpoint_position[mine], superpoint_position[mine + 1u], superpoint_position[mine + 2u], 0.0);
        barrier();
        uint count = min(STAGED, superpoints - first);
        for (uint chunk = 0u; chunk < count; chunk += CHUNK) {
            uint close = close_ones(x, chunk, worst);
            uint rest = count - chunk;
            close &= rest < CHUNK ? (1u << rest) - 1u : 0xffffffffu;
            while (close != 0u) {
                uint k = uint(findLSB(close));
                close &= close - 1u;
                float d = finite_distance(x, staged_position[chunk + k].xyz);
                TAKE(d, first + chunk + k)
            }
        }
    }
    nearest[0] = n_0;
    nearest[1] = n_1;
    nearest[2] = n_2;
    nearest[3] = n_3;
    nearest[4] = n_4;
    nearest[5] = n_5;
    nearest[6] = n_6;
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

void update_row(uint row, uint nearest[MAX_NEIGHBORS]) {
    uint neighbors = NEIGHBORS;
    uint slots = SLOTS;
    uint old[MAX_SLOTS];
    bool changed = false;
    [[unroll]] for (uint s = 0u; s < MAX_SLOTS; s++) {
        if (s < slots) {
            old[s] = neighbor[row + s];
        }
    }
    [[unroll]] for (uint k = 0u; k < MAX_NEIGHBORS; k++) {
        changed = changed || (k < neighbors && old[k] != nearest[k]);
    }
    uint blended = BLEND;
    if (changed && (blended != 0u || counters[COUNT_FAILED] == 0u)) {
        rearrange(row, old, nearest);
    }
}

// What lib/superpoint_motion.glsl reads of the superpoints; the weights are in `weight`, of which it leaves out the last plane.
void write_blend(uint i, uint nearest[MAX_NEIGHBORS]) {
    uint slots = BLEND;
    uint n = step_data.gaussians;
    [[unroll]] for (uint p = 0u; p < 2u; p++) {
        if (2u * p < slots) {
            uint second = 2u * p + 1u < slots ? nearest[2u * p + 1u] : 0u;
            blend_index[p * n + i] = nearest[2u * p] | (second << 16u);
        }
    }
}

// Softmax over the superpoints in use. All weights are 0 when a logit is not finite.
void write_weights(uint i, uint row, uint nearest[MAX_NEIGHBORS]) {
    uint neighbors = NEIGHBORS;
    uint n = step_data.gaussians;
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
    uint blended = BLEND;
    if (blended != 0u) {
        write_blend(i, nearest);
    }
    next_superpoint[i] = finite ? best : nearest[0];
    if (!finite) {
        report_not_finite(STATUS_ASSOCIATION, i);
    }
}

void write_pairs(uint i, uint nearest[MAX_NEIGHBORS]) {
    uint neighbors = NEIGHBORS;
    uint n = step_data.gaussians;
    [[unroll]] for (uint k = 0u; k < MAX_NEIGHBORS; k++) {
        if (k < neighbors) {
            pair_key[k * n + i] = nearest[k];
            pair_value[k * n + i] = (k << PAIR_SHIFT) | i;
        }
    }
    pair_key[neighbors * n + i] = min(superpoint_of_gaussian[i], step_data.superpoints - 1u);
    pair_value[neighbors * n + i] = (neighbors << PAIR_SHIFT) | i;
}

void main() {
    uint i = workgroup_index() * 256u + thread_index();
    uint slots = SLOTS;
    uint n = step_data.gaussians;
    // A thread without a Gaussian keeps the others company, which shuffles and barriers need.
    uint at = min(i, n - 1u);
    vec3 x = vec3(mean[at], mean[n + at], mean[2u * n + at]);
    uint nearest[MAX_NEIGHBORS];
    // Its row is another thread's, too: it looks for nothing.
    float bound = 0.0;
    if (i < n) {
        bound = upper_bound(x, i * slots);
    }
    find_nearest(x, bound, nearest);
    if (i < n) {
        update_row(i * slots, nearest);
        write_weights(i, i * slots, nearest);
        write_pairs(i, nearest);
    }
}
