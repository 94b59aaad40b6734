//! The f64 image that is the truth: every fast path is measured against it.
//!
//! Semantics, all in f64:
//!
//! - mean(t) = Exp(r)·mean + τ, R(t) = Exp(r)·R(q/|q|), with r and τ interpolated linearly between key times and held
//!   outside (or from network F); a static scene does not move. With soft superpoints, mean(t) is the weighted mean over a
//!   Gaussian's superpoints and R(t) that of their unit quaternions, on the side of the heaviest one's, normalised.
//! - with non-rigid offsets (network G, deformation fields): mean(t) + dx, the rotation of norm(Exp(r)∘q/|q| + dq), exp(log_scale) + ds (at least 1e-13).
//! - camera space p = W·(mean(t) − position); kept iff p.z > near.
//! - Σ₂ = J W Σ Wᵀ Jᵀ + 0.3·I (px²), J taken at x/z and y/z clamped 0.3·tan(half field of view) outside the image.
//! - colour = max(0, 0.5 + Σ SH(direction from the camera to mean(t))); SH are not rotated.
//! - o = sigmoid(logit), times the share of a lifespan at this time where the Gaussians have one.
//! - α = min(0.99, o·exp(−½dᵀΣ₂⁻¹d)) at pixel centres (i + 0.5, j + 0.5); a Gaussian contributes wherever α ≥ 1/255.
//! - front to back by camera-space z, ties by index; blending stops before the Gaussian that would take T below 1e-4.
//! - image = Σ c·α·T + T·background; A = 1 − T; Z = Σ z·α·T.

mod blend;
mod deformation;
mod field;
mod freeze;
pub mod gradient;
mod motion;
mod network;
mod project;
mod sh;
mod soft;
pub mod tabulate;
#[cfg(test)]
mod tests;

use rayon::prelude::*;

pub use deformation::{place_scene, poses};
pub use field::field_offsets;
pub use freeze::{freeze, freeze_with};
pub use motion::{
    DeformationAt, Offset, Placed, Pose, SCALE_MIN, exp, exp_quaternion, place, place_deformed, rotation_of_quaternion,
    table_poses,
};
pub use network::{network_poses, nonrigid_offsets};
pub use project::{Parameters, Splat, project};
pub(crate) use sh::basis as sh_basis;
pub use sh::color_of;
pub(crate) use soft::EQUAL_WEIGHTS;
pub(crate) use soft::aligned_sum;
pub use soft::{Blend64, WeightedPose};

use crate::error::{Error, Result};
use crate::image::Image;
use crate::scene::parameter::Optional;
use crate::scene::synthetic::HardCase;
use crate::scene::{Camera, Gaussians, MotionSource, Rejected, Scene};

/// Smallest α that contributes.
pub const ALPHA_MIN: f64 = 1.0 / 255.0;
/// α is clamped to this.
pub const ALPHA_MAX: f64 = 0.99;
/// A Gaussian that would take the transmittance below this ends the pixel and is not blended.
pub const TRANSMITTANCE_MIN: f64 = 1.0e-4;
/// Added to the diagonal of the 2-D covariance, px².
pub const DILATION: f64 = 0.3;

/// What the reference image depends on besides scene, camera and time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReferenceOptions {
    /// Gaussians whose centre has camera-space z ≤ `near` are dropped, world units.
    pub near: f64,
    /// Colour behind everything.
    pub background: [f64; 3],
    /// Where the poses of the superpoints come from.
    pub motion: MotionSource,
}

impl Default for ReferenceOptions {
    fn default() -> Self {
        Self { near: 0.2, background: [0.0; 3], motion: MotionSource::Auto }
    }
}

impl From<&HardCase> for ReferenceOptions {
    fn from(case: &HardCase) -> Self {
        let background = case.background.map(f64::from);
        Self { near: f64::from(case.near), background, motion: MotionSource::Auto }
    }
}

/// An f64 image, row-major, top row first.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ReferenceImage {
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// `[height, width, 3]` Σ c·α·T + T·background.
    pub rgb: Vec<f64>,
    /// `[height, width]` 1 − T.
    pub alpha: Vec<f64>,
    /// `[height, width]` Σ z·α·T, world units.
    pub depth: Vec<f64>,
    /// Gaussians in front of the near plane whose α reaches 1/255 somewhere in the plane (not necessarily in the image).
    pub visible: usize,
    /// Gaussians left out because their parameters are unusable.
    pub rejected: Rejected,
}

impl ReferenceImage {
    /// The image in the renderer's precision, with depth.
    pub fn to_image(&self) -> Image {
        let rgba = self.rgb.chunks_exact(3).zip(&self.alpha);
        Image {
            width: self.width,
            height: self.height,
            rgba: rgba.flat_map(|(c, &a)| [c[0] as f32, c[1] as f32, c[2] as f32, a as f32]).collect(),
            depth: self.depth.iter().map(|&z| z as f32).collect(),
        }
    }
}

/// Gaussians in f64, for truth that is given in f64. Same arrays as [`Gaussians`].
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Gaussians64 {
    /// `[N,3]` centre, world units.
    pub mean: Vec<[f64; 3]>,
    /// `[N,3]` log of the standard deviations, world units.
    pub log_scale: Vec<[f64; 3]>,
    /// `[N,4]` quaternion w,x,y,z of any length > 0.
    pub rotation: Vec<[f64; 4]>,
    /// `[N]` opacity before the sigmoid.
    pub opacity_logit: Vec<f64>,
    /// SH degree 0–3.
    pub sh_degree: u32,
    /// `[N,K,3]` SH coefficients, K = (degree + 1)².
    pub sh: Vec<f64>,
    /// What only some scenes have.
    pub optional: Optional<f64>,
    /// [`Gaussians::antialiased`].
    pub antialiased: bool,
}

impl From<&Gaussians> for Gaussians64 {
    /// Every parameter as it is stored.
    fn from(g: &Gaussians) -> Self {
        Self {
            mean: g.mean.iter().map(|v| v.map(f64::from)).collect(),
            log_scale: g.log_scale.iter().map(|v| v.map(f64::from)).collect(),
            rotation: g.rotation.iter().map(|v| v.map(f64::from)).collect(),
            opacity_logit: g.opacity_logit.iter().map(|&x| x.into()).collect(),
            sh_degree: g.sh_degree,
            sh: g.sh.iter().map(|&x| x.into()).collect(),
            optional: g.optional.map(f64::from),
            antialiased: g.antialiased,
        }
    }
}

impl Gaussians64 {
    /// Rounds every parameter to f32.
    pub fn to_f32(&self) -> Gaussians {
        Gaussians {
            mean: self.mean.iter().map(|v| v.map(|x| x as f32)).collect(),
            log_scale: self.log_scale.iter().map(|v| v.map(|x| x as f32)).collect(),
            rotation: self.rotation.iter().map(|v| v.map(|x| x as f32)).collect(),
            opacity_logit: self.opacity_logit.iter().map(|&x| x as f32).collect(),
            sh_degree: self.sh_degree,
            sh: self.sh.iter().map(|&x| x as f32).collect(),
            optional: self.optional.map(|x| x as f32),
            antialiased: self.antialiased,
        }
    }
}

/// The image of `scene` at `time`, with its f32 parameters taken as exact numbers.
///
/// Fails when the image is empty, arrays have inconsistent lengths, a superpoint index is out of range, or the asked-for
/// motion source is absent.
pub fn render(scene: &Scene, camera: &Camera, time: f64, options: &ReferenceOptions) -> Result<ReferenceImage> {
    let gaussians = &scene.gaussians;
    let parameters = Parameters::from(gaussians);
    parameters.check()?;
    let mut rejected = Rejected::default();
    let valid: Vec<bool> = (0..gaussians.len()).map(|i| gaussians.is_valid(i, &mut rejected)).collect();
    let placed = place_scene(scene, time, options.motion)?;
    let mut image = render_placed(&parameters, &placed, &valid, camera, options)?;
    image.rejected = rejected;
    Ok(image)
}

/// The image of f64 Gaussians that do not move. No validity limits apply; a Gaussian that projects to something not
/// finite is dropped.
pub fn render_gaussians(
    gaussians: &Gaussians64,
    camera: &Camera,
    options: &ReferenceOptions,
) -> Result<ReferenceImage> {
    render_deformed(gaussians, &DeformationAt::default(), camera, options)
}

/// [`render_gaussians`] of Gaussians that `deformation` moves.
pub fn render_deformed(
    gaussians: &Gaussians64,
    deformation: &DeformationAt<'_>,
    camera: &Camera,
    options: &ReferenceOptions,
) -> Result<ReferenceImage> {
    let parameters = Parameters::from(gaussians);
    parameters.check()?;
    let placed = place_deformed(&parameters, deformation)?;
    let valid = vec![true; placed.mean.len()];
    render_placed(&parameters, &placed, &valid, camera, options)
}

/// Projects, sorts and blends Gaussians that have been moved to their place.
fn render_placed<T: Copy + Into<f64> + Sync>(
    parameters: &Parameters<'_, T>,
    placed: &Placed,
    valid: &[bool],
    camera: &Camera,
    options: &ReferenceOptions,
) -> Result<ReferenceImage> {
    if camera.width == 0 || camera.height == 0 {
        let size = format!("{} x {}", camera.width, camera.height);
        return Err(Error::usage("image size", size, "at least 1 x 1"));
    }
    let splats = sorted_splats(parameters, placed, valid, camera, options);
    Ok(blend::blend(&splats, camera, options.background))
}

/// The visible splats, front to back by z, ties by index.
fn sorted_splats<T: Copy + Into<f64> + Sync>(
    parameters: &Parameters<'_, T>,
    placed: &Placed,
    valid: &[bool],
    camera: &Camera,
    options: &ReferenceOptions,
) -> Vec<Splat> {
    let Placed { mean, rotation, scale, opacity } = placed;
    let mut splats: Vec<Splat> = (0..mean.len())
        .into_par_iter()
        .filter(|&i| valid[i])
        .filter_map(|i| project(parameters, i, (mean[i], rotation[i], scale[i]), opacity[i], camera, options.near))
        .collect();
    splats.par_sort_by(|a, b| a.depth.total_cmp(&b.depth).then(a.index.cmp(&b.index)));
    splats
}
