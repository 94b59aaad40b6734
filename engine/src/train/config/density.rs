//! Configuration of density control.

use serde::{Deserialize, Serialize};

/// Adaptive density control.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DensityConfig {
    /// Off: the Gaussians stay as they are in number.
    pub enabled: bool,
    /// First iteration at which it may run (3DGS: after 500).
    pub from: u64,
    /// Last iteration (paper: 15 k; the code's HyperNeRF script: 10 k).
    pub until: u64,
    /// Every so many iterations. D-NeRF: 100; HyperNeRF: 1000 (paper and script). Not scaled with the run's length.
    pub interval: u64,
    /// Opacities are reset every so many iterations, until `until`. D-NeRF: 3000; HyperNeRF: paper 6000, script 3000 (it never
    /// sets it); 0: never.
    pub opacity_reset_interval: u64,
    /// Prune only every so many iterations; 0: whenever Gaussians grow. NVIDIA: paper 8000; the code has no such interval.
    pub prune_interval: u64,
    /// Mean screen-space gradient above which a Gaussian grows, NDC units (2e-4).
    pub gradient_threshold: f32,
    /// Whether that gradient is the sum of what each pixel wants, without its sign (Ye et al. 2024, AbsGS): pixels that pull
    /// a large Gaussian to opposite sides do not cancel. Paper and code: no.
    pub absolute_gradient: bool,
    /// Gaussians of at most this share of the scene's extent are cloned, larger ones split (0.01).
    pub clone_extent: f32,
    /// Opacity below which a Gaussian goes (0.005).
    pub min_opacity: f32,
    /// Radius on screen above which a Gaussian goes, pixels, once opacities were reset for the first time; 0: no limit (20).
    pub max_radius_px: f32,
    /// World size above which it goes then too, as a share of the scene's extent (0.1); 0: no limit.
    pub max_extent: f32,
    /// From `until` on, every so many iterations, those go that the photos show least; 0: never.
    pub unseen_interval: u64,
    /// They may be up to this share of what the photos show: of Σ αT over pixels, photos and Gaussians.
    pub unseen_share: f64,
}
