#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_EXT_control_flow_attributes : require

// Sums over the Gaussians of each superpoint, by one workgroup or, where few pairs are expected, one subgroup, in a fixed order: weighted by the association
// over all Gaussians that have it as a neighbour, unweighted over those that move with it or, with soft superpoints, over all
// that it moves in part (SLOT_PLANES). Pairs come sorted by superpoint,
// then slot, then Gaussian.

layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;
layout(constant_id = 1) const uint MOMENTS = 1u;     // sum a and a * mean
layout(constant_id = 2) const uint PAIR_VALUES = 0u; // values of a row of pair_data to sum with weight a: 9 or none
layout(constant_id = 3) const uint OWN_FIRST = 0u;   // values OWN_FIRST .. OWN_FIRST + OWN_VALUES of own_data to sum
layout(constant_id = 4) const uint OWN_VALUES = 0u;  // at most 9
layout(constant_id = 5) const uint BY_SUBGROUP = 0u; // 1: a superpoint per subgroup
layout(constant_id = 6) const uint SLOT_PLANES = 0u; // planes of own_data of each slot: every pair has its own; 0: none has
layout(constant_id = 7) const uint OWN_ROW = 0u;     // values of a row of own_data; 0: it is planes
layout(constant_id = 8) const uint RANGES = 0u;      // where pairs start: 0 looked for, 1 looked for and stored, 2 stored before

#define STEP_BINDING 0
#include "lib/step.glsl"
#define STATUS_BINDING 8
#include "lib/status.glsl"
#include "lib/dispatch.glsl"
#include "lib/thread.glsl"
#define SUM_VALUES 22
#include "lib/workgroup_sum.glsl"

layout(local_size_x = 256) in;

layout(std430, set = 0, binding = 1) readonly buffer PairKeyBlock { uint pair_key[]; };
layout(std430, set = 0, binding = 2) readonly buffer PairValueBlock { uint pair_value[]; };
layout(std430, set = 0, binding = 3) readonly buffer WeightBlock { float weight[]; };
layout(std430, set = 0, binding = 4) readonly buffer MeanBlock { float mean[]; };
layout(std430, set = 0, binding = 5) readonly buffer PairDataBlock { float pair_data[]; };
layout(std430, set = 0, binding = 6) readonly buffer OwnDataBlock { float own_data[]; };
layout(std430, set = 0, binding = 7) writeonly buffer SuperpointSumBlock { float superpoint_sum[]; };
layout(std430, set = 0, binding = 9) buffer SuperpointRangeBlock { uint superpoint_range[]; };

layout(push_constant) uniform PushBlock {
    uint neighbors;    // K: the slot of pairs with the Gaussian's own superpoint
    uint pairs;
    uint status_group; // for contributions that are not finite; they are left out
} push;

const uint PAIR_SHIFT = 28u;
const uint PAIR_MASK = 0x0fffffffu;
const uint FIRST_PAIR_VALUE = 4u;  // planes of superpoint_sum: sum a, sum a * mean, then pair_data
const uint FIRST_OWN_VALUE = 13u;  // then own_data

shared uint bounds[3];

// Number of pairs before (superpoint, slot).
uint lower_bound(uint superpoint, uint slot) {
    uint low = 0u;
    uint high = push.pairs;
    for (uint step_count = 0u; step_count < 32u && low < high; step_count++) {
        uint middle = low + (high - low) / 2u;
        uint key = pair_key[middle];
        bool before = key < superpoint || (key == superpoint && (pair_value[middle] >> PAIR_SHIFT) < slot);
        low = before ? middle + 1u : low;
        high = before ? high : middle;
    }
    return low;
}

bool add_if_finite(inout float sums[SUM_VALUES], float addend[SUM_VALUES], uint first, uint count) {
    bool finite = true;
    [[unroll]] for (uint v = 0u; v < 13u; v++) {
        finite = finite && (v >= count || number_is_finite(addend[v]));
    }
    [[unroll]] for (uint v = 0u; v < 13u; v++) {
        if (v < count && finite) {
            sums[first + v] += addend[v];
        }
    }
    return finite;
}

void add_pair(inout float sums[SUM_VALUES], uint pair) {
    uint moments = MOMENTS;
    uint values = PAIR_VALUES;
    uint n = step_data.gaussians;
    uint value = pair_value[pair];
    uint i = value & PAIR_MASK;
    float a = weight[(value >> PAIR_SHIFT) * n + i];
    float addend[SUM_VALUES];
    [[unroll]] for (uint v = 0u; v < 13u; v++) {
        addend[v] = 0.0;
    }
    if (moments != 0u) {
        addend[0] = a;
        [[unroll]] for (uint c = 0u; c < 3u; c++) {
            addend[1u + c] = a * mean[c * n + i];
        }
    }
    [[unroll]] for (uint c = 0u; c < 9u; c++) {
        if (c < values) {
            addend[FIRST_PAIR_VALUE + c] = a * pair_data[values * i + c];
        }
    }
    if (!add_if_finite(sums, addend, 0u, 13u)) {
        report_not_finite(push.status_group, i);
    }
}

void add_own(inout float sums[SUM_VALUES], uint pair) {
    uint values = OWN_VALUES;
    uint slot_planes = SLOT_PLANES;
    uint row = OWN_ROW;
    uint n = step_data.gaussians;
    uint value = pair_value[pair];
    uint i = value & PAIR_MASK;
    uint first = OWN_FIRST + (value >> PAIR_SHIFT) * slot_planes;
    float addend[SUM_VALUES];
    [[unroll]] for (uint c = 0u; c < 9u; c++) {
        addend[c] = c < values ? own_data[row != 0u ? row * i + first + c : (first + c) * n + i] : 0.0;
    }
    if (!add_if_finite(sums, addend, FIRST_OWN_VALUE, 9u)) {
        report_not_finite(push.status_group, i);
    }
}

// Where the pairs of a superpoint start, where its own Gaussians start, and where both end. A surplus workgroup or subgroup
// finds an empty segment.
uvec3 find_segment(uint superpoint, uint member) {
    uint by_subgroup = BY_SUBGROUP;
    uint ranges = RANGES;
    uint bound = 0u;
    if (member < 3u) {
        uint at = member * step_data.superpoints + superpoint;
        bool stored = superpoint < step_data.superpoints;
        if (ranges == 2u) {
            bound = stored ? superpoint_range[at] : 0u;
        } else {
            bound = lower_bound(superpoint + (member == 2u ? 1u : 0u), member == 1u ? push.neighbors : 0u);
        }
        if (ranges == 1u && stored) {
            superpoint_range[at] = bound;
        }
    }
    uvec3 segment;
    if (by_subgroup == 1u) {
        segment = uvec3(subgroupShuffle(bound, 0u), subgroupShuffle(bound, 1u), subgroupShuffle(bound, 2u));
    } else {
        if (member < 3u) {
            bounds[member] = bound;
        }
        barrier();
        segment = uvec3(bounds[0], bounds[1], bounds[2]);
    }
    return segment;
}

void store_sum(uint superpoint, uint v, float value) {
    if (superpoint < step_data.superpoints && v < SUM_VALUES) {
        superpoint_sum[v * step_data.superpoints + superpoint] = value;
    }
}

// Sums over a subgroup: lane l stores values l, l + size…
void store_sums_of_subgroup(uint superpoint, float sums[SUM_VALUES]) {
    uint size = SUBGROUP_SIZE;
    uint lane = gl_SubgroupInvocationID;
    for (uint first = 0u; first < SUM_VALUES; first += size) {
        float own = 0.0;
        [[unroll]] for (uint v = 0u; v < SUM_VALUES; v++) {
            if (v >= first && v < first + size) {
                float sum = subgroupAdd(sums[v]);
                own = lane == v - first ? sum : own;
            }
        }
        store_sum(superpoint, first + lane, own);
    }
}

void main() {
    uint size = SUBGROUP_SIZE;
    uint moments = MOMENTS;
    uint pair_values = PAIR_VALUES;
    uint own_values = OWN_VALUES;
    uint slot_planes = SLOT_PLANES;
    uint by_subgroup = BY_SUBGROUP;
    uint superpoint = by_subgroup == 1u ? workgroup_index() * gl_NumSubgroups + gl_SubgroupID : workgroup_index();
    uint member = by_subgroup == 1u ? gl_SubgroupInvocationID : thread_index();
    uint members = by_subgroup == 1u ? size : 256u;
    uvec3 segment = find_segment(superpoint, member);
    float sums[SUM_VALUES];
    [[unroll]] for (uint v = 0u; v < SUM_VALUES; v++) {
        sums[v] = 0.0;
    }
    if (moments != 0u || pair_values != 0u) {
        for (uint pair = segment.x + member; pair < segment.y; pair += members) {
            add_pair(sums, pair);
        }
    }
    if (own_values != 0u) {
        uvec2 own = slot_planes != 0u ? segment.xy : segment.yz;
        for (uint pair = own.x + member; pair < own.y; pair += members) {
            add_own(sums, pair);
        }
    }
    if (by_subgroup == 1u) {
        store_sums_of_subgroup(superpoint, sums);
    } else {
        store_sum(superpoint, member, workgroup_sums(sums));
    }
}
