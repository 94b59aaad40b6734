// The SSIM window and how the kernels of the loss convolve with it. Rust: engine/src/train/image_loss/pixels.rs.
//
// STAGE 0: a thread walks down a strip of 16 x 48 pixels, read straight from memory. It convolves each row along x and adds the
// result, times the window, to the sums of the eleven output rows that it belongs to; the topmost of them is then complete. No
// sum ever leaves its thread. For devices where shared memory costs as much as any other.
// STAGE 1: a workgroup owns one channel of a tile of 32 x 48 pixels. Its first pass convolves along rows, from global memory
// into shared memory, for the rows of the tile and 5 more on each side; its second pass convolves along columns. A thread
// computes a run of 16 outputs from 26 inputs along a row, then of 12 outputs from 22 inputs along a column, so that a value
// is loaded fewer than two times instead of 11. Both passes occupy (nearly) all threads once, without a loop over tasks.
// Define before including: STAGE, a constant.
#ifndef SPGS_SSIM
#define SPGS_SSIM

const uint LOSS_THREADS = 128u;
const uint WINDOW_RADIUS = 5u;
const uint WINDOW_SIZE = 11u;
const uint STRIP_COLUMNS = 16u;
const uint STRIP_ROWS = 48u;
const uint STRIP_INPUTS = 26u;  // STRIP_COLUMNS + 2 WINDOW_RADIUS
const uint LOSS_TILE_WIDTH = 32u;
const uint LOSS_TILE_HEIGHT = 48u;
const uint ROW_RUN = 16u;       // STRIP_COLUMNS
const uint COLUMN_RUN = 12u;
const uint COLUMN_INPUTS = 22u; // COLUMN_RUN + 2 WINDOW_RADIUS
const uint TILE_ROWS = 58u;     // LOSS_TILE_HEIGHT + 2 WINDOW_RADIUS
const uint ROW_TASKS = 116u;    // TILE_ROWS * (LOSS_TILE_WIDTH / ROW_RUN); column tasks: LOSS_THREADS
const uint ROW_STRIDE = 33u;    // odd: threads of neighbouring rows use different banks

// Gaussian of standard deviation 1.5 px, normalised to sum 1.
const float WINDOW[11] = float[11](
    0.0010283801, 0.007598758, 0.036000773, 0.10936069, 0.21300554, 0.26601172,
    0.21300554, 0.10936069, 0.036000773, 0.007598758, 0.0010283801);

const float SSIM_C1 = 1.0e-4; // 0.01^2
const float SSIM_C2 = 9.0e-4; // 0.03^2

// Workgroups of each channel.
uint loss_groups(uvec2 size) {
    uint stage = STAGE;
    uvec2 part = stage == 0u ? uvec2(STRIP_COLUMNS, STRIP_ROWS) : uvec2(LOSS_TILE_WIDTH, LOSS_TILE_HEIGHT);
    uvec2 parts = (size + part - 1u) / part;
    uint count = parts.x * parts.y;
    return stage == 0u ? (count + LOSS_THREADS - 1u) / LOSS_THREADS : count;
}

// The first pixel of a thread's strip (STAGE 0); below the image in surplus threads.
uvec2 strip_corner(uint group, uint thread, uvec2 size) {
    uint across = (size.x + STRIP_COLUMNS - 1u) / STRIP_COLUMNS;
    uint strip = group * LOSS_THREADS + thread;
    return uvec2(STRIP_COLUMNS, STRIP_ROWS) * uvec2(strip % across, strip / across);
}

// The first pixel of a workgroup's tile (STAGE 1).
uvec2 tile_corner(uint group, uvec2 size) {
    uint across = (size.x + LOSS_TILE_WIDTH - 1u) / LOSS_TILE_WIDTH;
    return uvec2(LOSS_TILE_WIDTH, LOSS_TILE_HEIGHT) * uvec2(group % across, group / across);
}

// Where the run of a thread's row task begins in shared memory.
uint row_of(uint task) {
    return task % TILE_ROWS * ROW_STRIDE + ROW_RUN * (task / TILE_ROWS);
}

// The row convolved along x; STAGE 0: the sums of the eleven output rows under way, topmost first. Where fewer than four moments
// are convolved the last components stay 0.
vec4 row_sum[16];
vec4 column_sum[11 * 16];

void clear_row_sums() {
    [[unroll]] for (uint j = 0u; j < STRIP_COLUMNS; j++) {
        row_sum[j] = vec4(0.0);
    }
}

void clear_column_sums() {
    [[unroll]] for (uint j = 0u; j < WINDOW_SIZE * STRIP_COLUMNS; j++) {
        column_sum[j] = vec4(0.0);
    }
}

// Takes up the input WINDOW_RADIUS - i columns left of the strip's first; i is a constant.
void add_input(uint i, vec4 moments) {
    [[unroll]] for (uint k = 0u; k < WINDOW_SIZE; k++) {
        if (i >= k && i - k < STRIP_COLUMNS) {
            row_sum[i - k] += WINDOW[k] * moments;
        }
    }
}

// The row joins the sums of column j; those of the topmost output row are complete then.
void add_row(uint j, vec4 row) {
    [[unroll]] for (uint k = 0u; k + 1u < WINDOW_SIZE; k++) {
        column_sum[k * STRIP_COLUMNS + j] = column_sum[(k + 1u) * STRIP_COLUMNS + j] + WINDOW[k] * row;
    }
    column_sum[(WINDOW_SIZE - 1u) * STRIP_COLUMNS + j] = WINDOW[WINDOW_SIZE - 1u] * row;
}

void add_row_sums() {
    [[unroll]] for (uint j = 0u; j < STRIP_COLUMNS; j++) {
        add_row(j, row_sum[j]);
    }
}

// `ssim_maps` is [3 channels][3 derivatives][height][width to a multiple of 4]: vec4 per row.
uint map_stride(uvec2 size) {
    return (size.x + 3u) / 4u;
}

// vec4 of one map.
uint map_size(uvec2 size) {
    return map_stride(size) * size.y;
}

#endif
