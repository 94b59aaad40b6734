// The set of pixels that a splat reaches: u^2 + v^2 <= log2_opacity + log2(1/cut), i.e. alpha >= cut (1/255), with
// u = l11 dx + l12 dy, v = l22 dy. `deform_project` counts tiles, `emit_tiles` enumerates them and their quadrants with these
// same functions; the Rust twin is engine/src/render/ellipse.rs, line by line.
//
// Everything is slightly conservative (the threshold grows by 1e-4 relative + 1e-4 absolute, intervals by 1e-3 px + a
// few ulps), so that rounding never loses a pixel whose alpha reaches the cut. Tests are phrased so that NaN gives "empty".
//
// Declare before including: ALPHA_CUT (bits of log2(1/cut); 0: 1/255) and TILE_CULL (0: the tiles that the ellipse touches;
// 1: those that its bounding box touches).
#ifndef SPGS_ELLIPSE
#define SPGS_ELLIPSE

#include "limits.glsl"

const float LOG2_255 = 7.99435343685886;    // log2(255)
const float ELLIPSE_SLACK = 1e-4;           // enlarges the threshold
const float INTERVAL_SLACK_PX = 1e-3;       // enlarges an interval
const float INTERVAL_SLACK = 1e-6;          // the same, relative to the lengths that enter it
const float ELLIPSE_FAR_PX = 1e30;          // coefficients and centres past this are refused: products could overflow

// An instance in a tile list: the Gaussian, and above it the quadrants of the tile that it reaches.
const uint INSTANCE_QUADRANT_SHIFT = 28u;
const uint INSTANCE_GAUSSIAN = 268435455u; // 2^28 - 1

// log2(1/cut).
float log2_cut() {
    uint bits = ALPHA_CUT;
    return bits == 0u ? LOG2_255 : uintBitsToFloat(bits);
}

struct Ellipse {
    vec2 mean;           // px
    float l11, l12, l22; // Cholesky factor of the conic times sqrt(log2(e) / 2), 1/px
    float log2_opacity;
};

// From the first two vec4 of a splat.
Ellipse ellipse_of_splat(vec4 first, vec4 second) {
    return Ellipse(first.xy, first.z, first.w, second.x, second.y);
}

// Enlarged threshold of u^2 + v^2; not positive when the splat is too faint to reach the cut anywhere.
float ellipse_threshold(Ellipse e) {
    precise float t = e.log2_opacity + log2_cut();
    precise float enlarged = t + ELLIPSE_SLACK * (abs(t) + 1.0);
    return enlarged;
}

// Vectors, here and below, because a chain of && is a chain of branches, which some compilers keep.
bool ellipse_is_valid(Ellipse e, float threshold) {
    vec3 positive = vec3(e.l11, e.l22, threshold);
    bool above = all(greaterThan(positive, vec3(0.0)));
    bool below = all(lessThan(positive, vec3(ELLIPSE_FAR_PX)));
    bool near = all(lessThan(abs(vec3(e.l12, e.mean)), vec3(ELLIPSE_FAR_PX)));
    return above && below && near;
}

// What the rows of an ellipse have in common.
struct Extent {
    float t;      // threshold of u^2 + v^2
    bool valid;
    float radius; // sqrt(t)
    float k;      // l12 / l22
    float v_peak; // where the right end of a row is rightmost
};

Extent extent_of(Ellipse e) {
    float t = ellipse_threshold(e);
    precise float radius = sqrt(max(t, 0.0));
    precise float k = e.l12 / e.l22;
    precise float v_peak = -k * radius / sqrt(1.0 + k * k);
    return Extent(t, ellipse_is_valid(e, t), radius, k, v_peak);
}

// Range of x (px) of the ellipse over y in [y_low, y_high] (px, both included); low > high when it is empty.
// For fixed v the ends are (-(l12/l22) v -+ sqrt(t - v^2)) / l11; the right one is concave in v with its maximum at
// v = -k r / sqrt(1 + k^2), the left one convex with its minimum at the opposite point (k = l12/l22, r = sqrt(t)).
vec2 extent_row_interval(Ellipse e, Extent extent, float y_low, float y_high) {
    float t = extent.t;
    float radius = extent.radius;
    float k = extent.k;
    float v_peak = extent.v_peak;
    precise float v_low = max(e.l22 * (y_low - e.mean.y), -radius);
    precise float v_high = min(e.l22 * (y_high - e.mean.y), radius);
    precise float v_right = min(max(v_peak, v_low), v_high);
    precise float v_left = min(max(-v_peak, v_low), v_high);
    precise float reach_right = sqrt(max(t - v_right * v_right, 0.0));
    precise float reach_left = sqrt(max(t - v_left * v_left, 0.0));
    precise float right = (reach_right - k * v_right) / e.l11;
    precise float left = (-reach_left - k * v_left) / e.l11;
    precise float largest = (radius + abs(k) * max(abs(v_right), abs(v_left))) / e.l11;
    precise float slack = INTERVAL_SLACK_PX + INTERVAL_SLACK * (largest + abs(e.mean.x));
    precise float low = e.mean.x + left - slack;
    precise float high = e.mean.x + right + slack;
    // v_low <= v_high fails when the band misses the ellipse; low <= high fails when anything above was NaN.
    bool meets = v_low <= v_high;
    bool ordered = low <= high;
    return extent.valid && meets && ordered ? vec2(low, high) : vec2(1.0, 0.0);
}

vec2 ellipse_row_interval(Ellipse e, float y_low, float y_high) {
    return extent_row_interval(e, extent_of(e), y_low, y_high);
}

// First and last + 1 pixel whose centre (i + 0.5) lies in [low, high], within 0..count; (0, 0) when there is none.
uvec2 pixels_of_interval(float low, float high, uint count) {
    precise float first = max(ceil(low - 0.5), 0.0);
    precise float end = min(floor(high - 0.5) + 1.0, float(count));
    return first < end ? uvec2(uint(first), uint(end)) : uvec2(0u);
}

// First and last + 1 tile row that the ellipse may reach; (0, 0) when there is none. size = (width, height, ..) in pixels.
uvec2 tile_row_range(Ellipse e, uvec2 size) {
    float t = ellipse_threshold(e);
    bool valid = ellipse_is_valid(e, t);
    precise float reach = sqrt(max(t, 0.0)) / e.l22;
    precise float slack = INTERVAL_SLACK_PX + INTERVAL_SLACK * (reach + abs(e.mean.y));
    precise float low = e.mean.y - reach - slack;
    precise float high = e.mean.y + reach + slack;
    uvec2 rows = valid && low <= high ? pixels_of_interval(low, high, size.y) : uvec2(0u);
    return rows.x < rows.y ? uvec2(rows.x / TILE_SIZE, (rows.y - 1u) / TILE_SIZE + 1u) : uvec2(0u);
}

// First and last + 1 tile column that the ellipse reaches in one tile row (a row of the image); (0, 0) when there is none.
uvec2 tile_columns_of_row(Ellipse e, Extent extent, uint tile_row, uvec2 size) {
    float y_low = float(tile_row * TILE_SIZE) + 0.5;
    float y_high = float(min(tile_row * TILE_SIZE + TILE_SIZE, size.y)) - 0.5;
    uint cull = TILE_CULL;
    if (cull == 1u) {
        y_low = -ELLIPSE_FAR_PX;
        y_high = ELLIPSE_FAR_PX;
    }
    vec2 x = extent_row_interval(e, extent, y_low, y_high);
    uvec2 columns = x.x <= x.y ? pixels_of_interval(x.x, x.y, size.x) : uvec2(0u);
    return columns.x < columns.y ? uvec2(columns.x / TILE_SIZE, (columns.y - 1u) / TILE_SIZE + 1u) : uvec2(0u);
}

// The ellipse in the upper and the lower eight rows of a tile row: the range of x of each, (1, 0) when it is empty.
vec4 half_rows_of_tile_row(Ellipse e, Extent extent, uint tile_row) {
    float y = float(tile_row * TILE_SIZE) + 0.5;
    return vec4(extent_row_interval(e, extent, y, y + 7.0), extent_row_interval(e, extent, y + 8.0, y + 15.0));
}

// The quadrants of 8x8 pixels of a tile that the ellipse reaches: bits 0 upper left, 1 upper right, 2 lower left, 3 lower
// right. half_rows: of the tile's row. An empty range ends at 0, before the first pixel's centre.
uint quadrants_of_tile(vec4 half_rows, uint tile_column) {
    float x = float(tile_column * TILE_SIZE) + 0.5;
    uvec4 begun = uvec4(lessThanEqual(half_rows.xxzz, x + vec4(7.0, 15.0, 7.0, 15.0)));
    uvec4 not_over = uvec4(greaterThanEqual(half_rows.yyww, x + vec4(0.0, 8.0, 0.0, 8.0)));
    uvec4 reached = (begun & not_over) << uvec4(0u, 1u, 2u, 3u);
    return reached.x | reached.y | reached.z | reached.w;
}

#endif
