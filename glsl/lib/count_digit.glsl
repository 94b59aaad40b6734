// Counting the digits of keys while they are written, for the next pass of the sort. Include after the declaration of
// the buffer `next_histogram`, one row of SORT_DIGITS counts for each partition of keys. The includer enables
// GL_KHR_shader_subgroup_{basic,vote,ballot,shuffle}.
#ifndef SPGS_COUNT_DIGIT
#define SPGS_COUNT_DIGIT

#include "limits.glsl"
#include "subgroup.glsl"

// Counts digit `digit` of the key written at position `at`, for lanes with `valid`; a partition has 2^partition_shift keys. Every lane of the subgroup must call
// it, in uniform flow. Where the lanes agree, as in a run of equal keys, one lane adds for all, so that they do not queue at one address;
// small subgroups would gain less than the agreement costs.
void count_digit(uint at, uint digit, bool valid, uint partition_shift) {
    uint slot = (at >> partition_shift) * SORT_DIGITS + digit;
    uint size = SUBGROUP_SIZE;
    if (size < 16u) {
        if (valid) {
            atomicAdd(next_histogram[slot], 1u);
        }
    } else {
        uvec4 lanes = subgroupBallot(valid);
        uint lowest = lowest_lane(lanes);
        uint of_lowest = subgroupShuffle(slot, lowest); // not in the line below, where || would make a branch around it
        bool agree = subgroupAll(!valid || slot == of_lowest);
        bool adds = valid && (!agree || gl_SubgroupInvocationID == lowest);
        if (adds) {
            atomicAdd(next_histogram[slot], agree ? count_lanes(lanes) : 1u);
        }
    }
}

#endif
