//! From gradients of each Gaussian to those of superpoints and of the camera, in f64.
//!
//! The device turns a superpoint with its translation τ held, which is about τ; ω_0 = ω_τ + τ × g is the gradient by a turn about the
//! world's origin. With g_i the gradient of centre i and ω_i that by such a turn (torque of the shape + μ_i × g_i), a rigid change of
//! the whole scene has Σ g_i and Σ ω_i. A camera that goes by δ sees the scene go by −δ, so ∂L/∂c = −Σ g_i. One
//! that turns about its centre c sees the scene turned back, but looks at every Gaussian from the same side as before: the
//! part of g_i that comes by the direction v_i of the SH colours is left out,
//! ∂L/∂θ = −Σ (ω_i − c × g_i − v_i × ∂L/∂v_i).

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::PhotoLoss;
use crate::reference::gradient::sh::color_gradient;
use crate::reference::{Pose, color_of, exp};
use crate::scene::{Camera, Gaussians, SuperpointDeformation};
use crate::train::blend_backward::ROW_WORDS;
use crate::train::deform_project_backward::SLOT_PLANES;

/// Gaussians whose terms are summed one after another, so that the order of sums never depends on threads.
const CHUNK: usize = 4096;

/// Gradient by a rigid change x ↦ Exp(θ)x + δ about the world's origin, at 0.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Twist {
    /// By θ, per radian.
    pub rotation: DVec3,
    /// By δ, per world unit.
    pub translation: DVec3,
}

impl Twist {
    /// The same for a turn about `center`: x ↦ center + Exp(θ)(x − center) + δ.
    #[must_use]
    pub fn about(self, center: DVec3) -> Self {
        Self { rotation: self.rotation - center.cross(self.translation), ..self }
    }
}

impl std::ops::Add for Twist {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { rotation: self.rotation + other.rotation, translation: self.translation + other.translation }
    }
}

/// Gradient by the camera's pose.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct CameraGradient {
    /// By a left tangent θ of its turn in the world, about its centre: axes a ↦ Exp(θ)a, per radian.
    pub rotation: DVec3,
    /// By its centre, per world unit.
    pub position: DVec3,
}

/// `[M]` gradients by the poses, with τ held as a superpoint turns, from `float[6][N]`, or `float[K][7][N]` with soft
/// superpoints; of `n` Gaussians, in their order.
fn superpoint_sums(planes: &[f32], n: usize, motion: &SuperpointDeformation) -> Vec<Twist> {
    let mut sums = vec![Twist::default(); motion.superpoints.position.len()];
    let vector = |plane: usize, i: usize| DVec3::from_array([0, 1, 2].map(|c| f64::from(planes[(plane + c) * n + i])));
    let mut add = |j: u32, first: usize, i: usize| {
        if let Some(sum) = sums.get_mut(j as usize) {
            *sum = *sum + Twist { rotation: vector(first, i), translation: vector(first + 3, i) };
        }
    };
    match &motion.blend {
        None => motion.superpoints.of_gaussian.iter().take(n).enumerate().for_each(|(i, &j)| add(j, 0, i)),
        Some(blend) => (0..n.min(blend.len())).for_each(|i| {
            let row = blend.row(i).0.iter().enumerate();
            row.for_each(|(slot, &j)| add(j, slot * SLOT_PLANES as usize, i));
        }),
    }
    sums
}

impl PhotoLoss<'_> {
    /// `[M]` gradients by the poses about the world's origin, from what [`superpoint_sums`] takes.
    pub(super) fn pose_sums(&self, planes: &[f32], poses: &[Pose]) -> Vec<Twist> {
        let Some(motion) = self.scene.deformation.superpoint_deformation() else { return Vec::new() };
        let sums = superpoint_sums(planes, self.buffers.gaussians as usize, motion);
        // On the device a superpoint turns with its translation held: about where its pose takes the device's origin.
        let origin = self.buffers.origin;
        let center = |pose: &Pose| exp(pose.rotation) * origin + pose.translation;
        sums.into_iter().zip(poses).map(|(sum, pose)| sum.about(-center(pose))).collect()
    }

    /// Gradient by the camera, from those of the poses about the world's origin and the rows of the splats.
    pub(super) fn camera_gradient(
        &self,
        sums: &[Twist],
        rows: &[f32],
        camera: &Camera,
        poses: &[Pose],
    ) -> CameraGradient {
        let all = sums.iter().fold(Twist::default(), |sum, twist| sum + *twist).about(camera.position);
        let turned = self.view_torque(rows, camera, poses);
        CameraGradient { rotation: turned - all.rotation, position: -all.translation }
    }

    /// Σ v × ∂L/∂v over the directions in which colours are seen.
    fn view_torque(&self, rows: &[f32], camera: &Camera, poses: &[Pose]) -> DVec3 {
        let g = &self.scene.gaussians;
        if self.buffers.sh_degree == 0 {
            return DVec3::ZERO;
        }
        let placed: Vec<(DMat3, DVec3)> = poses.iter().map(|p| (exp(p.rotation), p.translation)).collect();
        let width = ROW_WORDS as usize;
        let chunk = |first: usize| {
            let range = first..(first + CHUNK).min(g.len());
            range.fold(DVec3::ZERO, |sum, i| {
                let by_color = [6, 7, 8].map(|word| f64::from(rows[width * i + word]));
                if by_color == [0.0; 3] { sum } else { sum + self.torque(i, by_color, camera, &placed) }
            })
        };
        let starts: Vec<usize> = (0..g.len()).step_by(CHUNK).collect();
        let sums: Vec<DVec3> = starts.into_par_iter().map(chunk).collect();
        sums.into_iter().sum()
    }

    fn torque(&self, i: usize, by_color: [f64; 3], camera: &Camera, placed: &[(DMat3, DVec3)]) -> DVec3 {
        let Gaussians { mean, sh, sh_degree, .. } = &self.scene.gaussians;
        let Some(motion) = self.scene.deformation.superpoint_deformation() else { return DVec3::ZERO };
        let canonical = DVec3::from_array(mean[i].map(f64::from));
        let moved = motion.slots(i).filter_map(|(j, weight)| Some((placed.get(j)?, weight)));
        let center: DVec3 = moved.map(|((turn, shift), weight)| (*turn * canonical + *shift) * weight).sum();
        let offset = center - camera.position;
        let coefficients = self.scene.gaussians.sh_coefficients() * 3;
        let sh: Vec<f64> = sh[i * coefficients..(i + 1) * coefficients].iter().map(|&v| f64::from(v)).collect();
        // Channels that were clamped at 0 pass nothing on.
        let drawn = color_of(&sh, *sh_degree, offset);
        let passed = std::array::from_fn(|c| if drawn[c] > 0.0 { by_color[c] } else { 0.0 });
        offset.cross(color_gradient(&sh, *sh_degree, offset, passed).1)
    }
}
