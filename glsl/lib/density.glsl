// Constants of adaptive density control. Rust: engine/src/train/density.rs.
#ifndef SPGS_DENSITY
#define SPGS_DENSITY

// action[]: what becomes of a Gaussian
const uint ACTION_PRUNE = 0u;
const uint ACTION_KEEP = 1u;
const uint ACTION_CLONE = 2u;
const uint ACTION_SPLIT = 3u;

// Scales are divided by 1.6 in a split.
const float SPLIT_LOG_SCALE = 0.47000363;

// source[]: the old row in the low 30 bits, the kind of the new row above
const uint SOURCE_ROW = 0x3fffffffu;
const uint KIND_KEPT = 0u;
const uint KIND_CLONE = 1u;
const uint KIND_CHILD_0 = 2u;
const uint KIND_CHILD_1 = 3u;

// New rows of an action.
uint rows_of_action(uint action) {
    return min(action, 2u);
}

// Mean norm of the screen-space gradient over the views that saw the Gaussian, 0 when there is none. By bits: NaN fails.
float mean_gradient(float sum, float views) {
    float g = sum / views;
    bool finite = (floatBitsToUint(g) & 0x7f800000u) != 0x7f800000u;
    return views > 0.0 && finite && g > 0.0 ? g : 0.0;
}

#endif
