// One-dimensional grids that may be longer than 65,535 workgroups: the host (or `scan_tiles`, for an indirect dispatch)
// folds n groups into x = min(n, 65535), y = ceil(n / x). The last row may run past n, so kernels check their bounds.
#ifndef SPGS_DISPATCH
#define SPGS_DISPATCH

const uint MAX_GROUPS_X = 65535u;

uint workgroup_index() {
    return gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x;
}

// Group counts (x, y, z) of a folded grid of n workgroups.
uvec3 folded_groups(uint n) {
    uint x = min(n, MAX_GROUPS_X);
    uint y = x == 0u ? 0u : (n + x - 1u) / x;
    return uvec3(x, y, 1u);
}

#endif
