// The SSIM window and the tiles of the kernels that convolve with it. Rust: engine/src/train/image_loss/pixels.rs.
//
// A workgroup owns one channel of a tile of 32 x 48 pixels. Its first pass convolves along rows, from global memory into
// shared memory, for the rows of the tile and 5 more on each side; its second pass convolves along columns. A thread
// computes a run of 16 outputs from 26 inputs along a row, then of 12 outputs from 22 inputs along a column, so that a value
// is loaded fewer than two times instead of 11. Both passes occupy (nearly) all threads once, without a loop over tasks.
#ifndef SPGS_SSIM
#define SPGS_SSIM

const uint LOSS_TILE_WIDTH = 32u;
const uint LOSS_TILE_HEIGHT = 48u;
const uint LOSS_THREADS = 128u;
const uint WINDOW_RADIUS = 5u;
const uint WINDOW_SIZE = 11u;
const uint ROW_RUN = 16u;
const uint ROW_INPUTS = 26u;    // ROW_RUN + 2 WINDOW_RADIUS
const uint COLUMN_RUN = 12u;
const uint COLUMN_INPUTS = 22u; // COLUMN_RUN + 2 WINDOW_RADIUS
const uint TILE_ROWS = 58u;     // LOSS_TILE_HEIGHT + 2 WINDOW_RADIUS
const uint ROW_TASKS = 116u;    // TILE_ROWS * (LOSS_TILE_WIDTH / ROW_RUN); column tasks: LOSS_THREADS
const uint ROW_STRIDE = 33u;    // odd: threads of neighbouring rows use different banks

// Tiles in x and y.
uvec2 loss_tiles(uvec2 size) {
    return uvec2((size.x + LOSS_TILE_WIDTH - 1u) / LOSS_TILE_WIDTH, (size.y + LOSS_TILE_HEIGHT - 1u) / LOSS_TILE_HEIGHT);
}

// Where the run of a thread's row task begins in shared memory.
uint row_of(uint task) {
    return task % TILE_ROWS * ROW_STRIDE + ROW_RUN * (task / TILE_ROWS);
}

// Gaussian of standard deviation 1.5 px, normalised to sum 1.
const float WINDOW[11] = float[11](
    0.0010283801, 0.007598758, 0.036000773, 0.10936069, 0.21300554, 0.26601172,
    0.21300554, 0.10936069, 0.036000773, 0.007598758, 0.0010283801);

const float SSIM_C1 = 1.0e-4; // 0.01^2
const float SSIM_C2 = 9.0e-4; // 0.03^2

#endif
