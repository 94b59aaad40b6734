// Subgroup and workgroup helpers that hold for every subgroup size from 4 to 128. Workgroups have SCAN_THREADS threads in x, at
// most 256 (which they have unless the includer defines it), and full subgroups. The includer enables GL_KHR_shader_subgroup_{basic,ballot,arithmetic,vote}.
// SUBGROUP_SIZE is copied into a variable before it is used in an expression: naga has no OpSpecConstantOp.
#ifndef SPGS_SUBGROUP
#define SPGS_SUBGROUP

layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

#include "thread.glsl"

#ifndef SCAN_THREADS
#define SCAN_THREADS 256u
#endif
shared uint scan_totals[64]; // one per subgroup: 256 / 4

// Bits set in a ballot.
uint count_lanes(uvec4 ballot) {
    uint size = SUBGROUP_SIZE;
    uint n = uint(bitCount(ballot.x));
    if (size > 32u) {
        n += uint(bitCount(ballot.y));
    }
    if (size > 64u) {
        n += uint(bitCount(ballot.z) + bitCount(ballot.w));
    }
    return n;
}

// Mask of the bits of ballot word `word` whose lanes are below `lane`.
uint lanes_below_mask(uint word, uint lane) {
    uint first = word * 32u;
    return lane >= first + 32u ? 0xffffffffu : lane <= first ? 0u : (1u << (lane - first)) - 1u;
}

// Bits set in a ballot for lanes below `lane`.
uint count_lanes_below(uvec4 ballot, uint lane) {
    uint size = SUBGROUP_SIZE;
    uint n = uint(bitCount(ballot.x & lanes_below_mask(0u, lane)));
    if (size > 32u) {
        n += uint(bitCount(ballot.y & lanes_below_mask(1u, lane)));
    }
    if (size > 64u) {
        n += uint(bitCount(ballot.z & lanes_below_mask(2u, lane)) + bitCount(ballot.w & lanes_below_mask(3u, lane)));
    }
    return n;
}

// The lowest lane of a ballot; some lane when it is empty.
uint lowest_lane(uvec4 ballot) {
    uint size = SUBGROUP_SIZE;
    uint lane = uint(findLSB(ballot.x));
    if (size > 32u) {
        lane = ballot.x != 0u ? lane : 32u + uint(findLSB(ballot.y));
    }
    if (size > 64u) {
        uint high = ballot.z != 0u ? 64u + uint(findLSB(ballot.z)) : 96u + uint(findLSB(ballot.w));
        lane = (ballot.x | ballot.y) != 0u ? lane : high;
    }
    return lane & (size - 1u);
}

// Exclusive prefix sum over the threads and its total. Every thread must call it; contains barriers.
uint workgroup_exclusive_add(uint value, out uint total) {
    uint size = SUBGROUP_SIZE;
    uint threads = SCAN_THREADS;
    uint subgroups = threads / size;
    uint inclusive = subgroupInclusiveAdd(value);
    barrier(); // an earlier call may still be reading scan_totals
    if (gl_SubgroupInvocationID == size - 1u) {
        scan_totals[gl_SubgroupID] = inclusive;
    }
    barrier();
    if (gl_SubgroupID == 0u) {
        uint carry = 0u;
        for (uint first = 0u; first < subgroups; first += size) {
            uint i = first + gl_SubgroupInvocationID;
            uint count = i < subgroups ? scan_totals[i] : 0u;
            uint scanned = carry + subgroupInclusiveAdd(count);
            carry += subgroupAdd(count);
            if (i < subgroups) {
                scan_totals[i] = scanned;
            }
        }
    }
    barrier();
    total = scan_totals[subgroups - 1u];
    uint before = gl_SubgroupID == 0u ? 0u : scan_totals[gl_SubgroupID - 1u];
    return before + inclusive - value;
}

#endif
