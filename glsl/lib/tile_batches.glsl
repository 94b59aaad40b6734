// How many batches of splats a subgroup goes through. Include after the declaration of the buffer `ranges` and the constant
// SUBGROUP_SIZE; with SEGMENTED defined, what is called a tile here is a segment of a tile's list (lib/segments.glsl), and
// `range_of_segment` must be declared.
#ifndef SPGS_TILE_BATCHES
#define SPGS_TILE_BATCHES

uint batches_of_tile(uint tile) {
    uint size = SUBGROUP_SIZE;
#ifdef SEGMENTED
    uvec2 range = range_of_segment(tile);
    uint first = range.x;
    uint end = range.y;
#else
    uint first = ranges[2u * tile];
    uint end = max(ranges[2u * tile + 1u], first);
#endif
    return (end - first + size - 1u) / size;
}

// Batches of the subgroup's own tile or, where subgroups hand data over in shared memory (`together`, a constant), of the
// longest tile of the workgroup: their barriers then sit in flow that is uniform for the workgroup, because some drivers make a
// barrier of the whole workgroup of a subgroup's. per_tile: subgroups of a tile.
uint batches_to_walk(uint tile, uint per_tile, uint tiles, bool together) {
    uint size = SUBGROUP_SIZE;
    if (!together) {
        return tile < tiles ? batches_of_tile(tile) : 0u;
    }
    uint subgroups = 128u / size;
    uint first = workgroup_index() * subgroups / per_tile;
    uint end = min((workgroup_index() * subgroups + subgroups - 1u) / per_tile + 1u, tiles);
    uint most = 0u;
    for (uint t = first; t < end; t++) {
        most = max(most, batches_of_tile(t));
    }
    return most;
}

#endif
