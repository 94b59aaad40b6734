// The segments of a tile's list that the backward pass walks side by side (engine/src/render/segments.rs). Include after the
// declaration of the constants SEGMENTS, the most that a list has, and LEAST_SEGMENT, splats.
#ifndef SPGS_SEGMENTS
#define SPGS_SEGMENTS

const uint SEGMENT_STEP = 128u; // the longest batch: at every subgroup size a segment begins with a batch

// Splats of a segment; of the list's last one, at most.
uint segment_length(uint splats) {
    uint segments = SEGMENTS;
    uint least = LEAST_SEGMENT;
    uint even = (splats + segments - 1u) / segments;
    return (max(least, even) + SEGMENT_STEP - 1u) / SEGMENT_STEP * SEGMENT_STEP;
}

#endif
