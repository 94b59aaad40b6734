//! Superpoint poses at a time, and Gaussians moved by them.

use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;

use super::project::Parameters;
use super::soft::{self, Blend64, WeightedPose};
use crate::error::{Error, Result};
use crate::scene::{Motion, Superpoints};

/// Rigid motion of one superpoint about the world origin: x ↦ Exp(rotation)·x + translation.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Pose {
    /// so(3) vector, radians.
    pub rotation: DVec3,
    /// World units.
    pub translation: DVec3,
}

/// Smallest standard deviation that a non-rigid offset can leave, world units: exp(−30), the smallest that a parameter
/// can give. At it the gradient of the scale is 0.
pub const SCALE_MIN: f64 = 9.357_622_968_840_175e-14;

/// What network G adds to one rigidly moved Gaussian (SP-GS, section 3.5, as in the released code): μ + `mean`,
/// norm(q + `rotation`) of the unit quaternion q = Exp(r)∘norm(q₀), exp(log_scale) + `scale`.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Offset {
    /// World units.
    pub mean: [f64; 3],
    /// Quaternion w,x,y,z.
    pub rotation: [f64; 4],
    /// World units.
    pub scale: [f64; 3],
}

/// What moves Gaussians at one time; nothing of it is needed.
#[derive(Debug, Clone, Copy, Default)]
pub struct DeformationAt<'a> {
    /// `[N]` superpoint of each Gaussian.
    pub group: &'a [u32],
    /// Soft superpoints, in place of `group`.
    pub blend: Option<&'a Blend64>,
    /// `[M]` poses of the superpoints.
    pub poses: Option<&'a [Pose]>,
    /// `[N]` non-rigid offsets.
    pub offsets: Option<&'a [Offset]>,
    /// The time.
    pub time: f64,
}

impl DeformationAt<'_> {
    /// What moves Gaussian `i`, once checked: nothing, its superpoint's pose, or the poses of all slots of its blend.
    pub fn weighted_poses(&self, i: usize) -> Vec<WeightedPose> {
        match (self.poses, self.blend) {
            (None, _) => Vec::new(),
            (Some(poses), None) => vec![poses[self.group[i] as usize].into()],
            (Some(poses), Some(blend)) => {
                blend.row(i).map(|(m, weight)| WeightedPose { weight, pose: poses[m] }).collect()
            }
        }
    }

    /// Every Gaussian has a superpoint, and that superpoint has a pose.
    fn check(&self, gaussians: usize) -> Result<()> {
        match (self.poses, self.blend) {
            (None, _) => Ok(()),
            (Some(poses), None) => check_groups(self.group, gaussians, poses.len()),
            (Some(poses), Some(blend)) => blend.check(gaussians, poses.len()),
        }
    }
}

/// Where the Gaussians are at a time.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Placed {
    /// `[N]` centres, world space.
    pub mean: Vec<DVec3>,
    /// `[N]` rotations from the Gaussian's axes to world space.
    pub rotation: Vec<DMat3>,
    /// `[N]` standard deviations along the Gaussian's axes, world units.
    pub scale: Vec<[f64; 3]>,
    /// `[N]` opacities.
    pub opacity: Vec<f64>,
}

/// sin(x)/x, by its Taylor series near zero, where the quotient would lose digits or be 0/0.
fn sinc(x: f64) -> f64 {
    let x2 = x * x;
    // The first term left out is x⁸/362880 < 3e-22.
    if x2 < 1.0e-4 { 1.0 - x2 / 6.0 * (1.0 - x2 / 20.0 * (1.0 - x2 / 42.0)) } else { x.sin() / x }
}

/// Exponential map of so(3) (Rodrigues): I + sinθ/θ·K + (1 − cosθ)/θ²·K², θ = |r|, K·x = r × x.
///
/// (1 − cosθ)/θ² is taken as ½·sinc²(θ/2), which does not cancel for small θ.
pub fn exp(r: DVec3) -> DMat3 {
    let theta = r.length();
    let half = sinc(0.5 * theta);
    let k = DMat3::from_cols(DVec3::new(0.0, r.z, -r.y), DVec3::new(-r.z, 0.0, r.x), DVec3::new(r.y, -r.x, 0.0));
    DMat3::IDENTITY + k * sinc(theta) + k * k * (0.5 * half * half)
}

/// Rotation matrix of a quaternion w,x,y,z of any length > 0.
pub fn rotation_of_quaternion(q: [f64; 4]) -> DMat3 {
    DMat3::from_quat(DQuat::from_xyzw(q[1], q[2], q[3], q[0]).normalize())
}

/// Poses of all superpoints at `time` from the key-time table: r and τ interpolated linearly, held outside the table.
pub fn table_poses(motion: &Motion, time: f64) -> Vec<Pose> {
    let count = motion.superpoint_count();
    let interval = motion.interval(time);
    let (first, second) = (interval.first as usize, interval.second as usize);
    let weight = if first == second {
        0.0
    } else {
        let (t0, t1) = (f64::from(motion.times[first]), f64::from(motion.times[second]));
        (time - t0) / (t1 - t0)
    };
    let lerp = |table: &[[f32; 3]], m: usize| {
        let (a, b) = (promote(table[first * count + m]), promote(table[second * count + m]));
        a * (1.0 - weight) + b * weight
    };
    (0..count)
        .map(|m| Pose { rotation: lerp(&motion.rotation, m), translation: lerp(&motion.translation, m) })
        .collect()
}

/// Unit quaternion of Exp(r), with cos(|r|/2) as its scalar part.
pub fn exp_quaternion(r: DVec3) -> DQuat {
    let theta = r.length();
    let v = r * (0.5 * sinc(0.5 * theta));
    DQuat::from_xyzw(v.x, v.y, v.z, (0.5 * theta).cos())
}

/// Moves every Gaussian with its superpoint; without poses it stays where it is.
pub fn place<T: Copy + Into<f64> + Sync>(
    parameters: &Parameters<'_, T>,
    superpoints: Option<&Superpoints>,
    poses: Option<&[Pose]>,
) -> Result<Placed> {
    let group = superpoints.map_or(&[][..], |s| &s.of_gaussian);
    place_deformed(parameters, &DeformationAt { group, poses: superpoints.and(poses), ..DeformationAt::default() })
}

/// Moves every Gaussian with its superpoint, or its blend of them, and adds its non-rigid offset.
pub fn place_deformed<T: Copy + Into<f64> + Sync>(
    parameters: &Parameters<'_, T>,
    deformation: &DeformationAt<'_>,
) -> Result<Placed> {
    let count = parameters.count();
    let all = (0..count).into_par_iter();
    let (scale, opacity) = all.map(|i| (parameters.scale(i), parameters.opacity(i, deformation.time))).unzip();
    let mut placed = Placed { scale, opacity, ..Placed::default() };
    let still = |i: usize| (parameters.mean(i), rotation_of_quaternion(parameters.rotation(i)));
    deformation.check(count)?;
    (placed.mean, placed.rotation) = match deformation.poses {
        Some(_) if deformation.blend.is_some() => {
            let moved =
                |i: usize| soft_place(&deformation.weighted_poses(i), parameters.mean(i), parameters.rotation(i));
            (0..count).into_par_iter().map(moved).unzip()
        }
        Some(poses) => {
            let group = deformation.group;
            let turn: Vec<DMat3> = poses.iter().map(|p| exp(p.rotation)).collect();
            let moved = |i: usize| {
                let (mean, rotation) = still(i);
                let m = group[i] as usize;
                (turn[m] * mean + poses[m].translation, turn[m] * rotation)
            };
            (0..count).into_par_iter().map(moved).unzip()
        }
        None => (0..count).into_par_iter().map(still).unzip(),
    };
    if let Some(offsets) = deformation.offsets {
        if offsets.len() != count {
            let expected = format!("{count} elements");
            return Err(Error::usage("non-rigid offsets", offsets.len().to_string(), expected));
        }
        for (i, offset) in offsets.iter().enumerate() {
            let q = rigid_quaternion(parameters.rotation(i), soft::turn(&deformation.weighted_poses(i)));
            let [w, x, y, z] = offset.rotation;
            placed.mean[i] += DVec3::from_array(offset.mean);
            placed.rotation[i] = DMat3::from_quat((q + DQuat::from_xyzw(x, y, z, w)).normalize());
            placed.scale[i] = std::array::from_fn(|k| (placed.scale[i][k] + offset.scale[k]).max(SCALE_MIN));
        }
    }
    Ok(placed)
}

/// A Gaussian that `poses` move: its centre and its rotation.
fn soft_place(poses: &[WeightedPose], mean: DVec3, rotation: [f64; 4]) -> (DVec3, DMat3) {
    let moved = soft::turned(poses, mean) + soft::shift(poses);
    let turned = match soft::only(poses) {
        Some(pose) => exp(pose.rotation) * rotation_of_quaternion(rotation),
        None => DMat3::from_quat(rigid_quaternion(rotation, soft::turn(poses))),
    };
    (moved, turned)
}

/// The unit quaternion `turn`∘norm(q) of a Gaussian with raw quaternion `q` (w,x,y,z).
pub(super) fn rigid_quaternion(q: [f64; 4], turn: Option<DQuat>) -> DQuat {
    let unit = DQuat::from_xyzw(q[1], q[2], q[3], q[0]).normalize();
    turn.map_or(unit, |turn| turn * unit)
}

fn check_groups(group: &[u32], gaussians: usize, superpoints: usize) -> Result<()> {
    if group.len() != gaussians {
        return Err(Error::usage("superpoints.of_gaussian", group.len().to_string(), format!("{gaussians} elements")));
    }
    match group.iter().position(|&m| m as usize >= superpoints) {
        Some(i) => Err(Error::usage(
            format!("superpoints.of_gaussian [{i}]"),
            group[i].to_string(),
            format!("less than {superpoints}"),
        )),
        None => Ok(()),
    }
}

fn promote(v: [f32; 3]) -> DVec3 {
    DVec3::from_array(v.map(f64::from))
}
