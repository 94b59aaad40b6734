// The SSIM window and the tiles of the kernels that convolve with it. Rust: engine/src/train/image_loss/pixels.rs.
//
// A workgroup owns one channel of a tile of 32 x 32 pixels. Its first pass convolves along rows, from global memory into
// shared memory, for the rows of the tile and 5 more on each side; its second pass convolves along columns. A thread
// computes a run of 16 outputs from 26 inputs, so that an input is loaded 1.6 times instead of 11.
#ifndef SPGS_SSIM
#define SPGS_SSIM

const uint LOSS_TILE = 32u;
const uint LOSS_THREADS = 128u;
const uint WINDOW_RADIUS = 5u;
const uint WINDOW_SIZE = 11u;
const uint RUN = 16u;
const uint RUN_INPUTS = 26u;  // RUN + 2 WINDOW_RADIUS
const uint TILE_ROWS = 42u;   // LOSS_TILE + 2 WINDOW_RADIUS
const uint ROW_TASKS = 84u;   // TILE_ROWS * (LOSS_TILE / RUN)
const uint COLUMN_TASKS = 64u; // LOSS_TILE * (LOSS_TILE / RUN)
const uint ROW_STRIDE = 33u;  // odd: threads of neighbouring rows use different banks

// Gaussian of standard deviation 1.5 px, normalised to sum 1.
const float WINDOW[11] = float[11](
    0.0010283801, 0.007598758, 0.036000773, 0.10936069, 0.21300554, 0.26601172,
    0.21300554, 0.10936069, 0.036000773, 0.007598758, 0.0010283801);

const float SSIM_C1 = 1.0e-4; // 0.01^2
const float SSIM_C2 = 9.0e-4; // 0.03^2

#endif
