//! Image metrics: how far a picture is from its ground truth, each by the definition of its source.
//!
//! | metric | definition | here |
//! |---|---|---|
//! | PSNR | −10 log₁₀ MSE over R, G, B with peak 1, on floats clamped to [0, 1] or on their 8-bit values | [`psnr()`], [`psnr_8bit()`] |
//! | SSIM | Wang et al. 2004, eq. 13, 11×11 Gaussian of σ 1.5: zeros outside the picture (3DGS and its family), or windows inside it only | [`ssim()`] |
//! | MS-SSIM | Wang et al. 2003, five scales, data range 1 | [`ms_ssim()`] |
//! | FLIP | LDR-FLIP, Andersson et al. 2020 | [`flip()`] |
//! | LPIPS | Zhang et al. 2018, AlexNet and VGG-16 with linear heads; the weights come from the user | [`mod@lpips`] |
//! | flicker | change between frames where the truth does not change | [`flicker`] |
//!
//! All work on display-referred values as stored (no gamma is applied or undone, but for FLIP, which reads them as sRGB).
//! Everything is f64 but FLIP's filters and the GPU's LPIPS. Sums are taken row by row in a fixed order: the same pictures
//! give the same bits on any number of threads.

mod filter;
pub mod flicker;
pub mod flip;
pub mod lpips;
mod planes;
pub mod psnr;
mod scores;
pub mod ssim;

pub use flip::{FlipMap, PIXELS_PER_DEGREE, flip};
pub use planes::{Planes, Weights};
pub use psnr::{psnr, psnr_8bit};
pub use scores::{Scores, mean_of, score};
pub use ssim::{SsimScores, ms_ssim, ssim, ssim_and_ms_ssim};
