//! Where the centres of Gaussians are at a time.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use crate::error::Result;
use crate::reference::{exp, place_scene, poses};
use crate::scene::{MotionSource, Scene};

/// `[N]` centres at `time`, world units. Cheaper than [`place_scene`], which turns Gaussians too.
///
/// # Errors
/// Those of [`place_scene`].
pub fn centers(scene: &Scene, time: f64) -> Result<Vec<DVec3>> {
    if scene.deformation.changes_scales() {
        return Ok(place_scene(scene, time, MotionSource::Auto)?.mean);
    }
    let mean = &scene.gaussians.mean;
    let at = |i: usize| DVec3::from_array(mean[i].map(f64::from));
    let (Some(poses), Some(s)) = (poses(scene, time, MotionSource::Auto)?, scene.deformation.superpoint_deformation())
    else {
        return Ok((0..mean.len()).map(at).collect());
    };
    let placed: Vec<(DMat3, DVec3)> = poses.iter().map(|p| (exp(p.rotation), p.translation)).collect();
    let of = |i: usize| match &s.blend {
        None => {
            let (turn, shift) = placed[s.superpoints.of_gaussian[i] as usize];
            turn * at(i) + shift
        }
        Some(blend) => blend.slots(i).map(|(j, w)| w * (placed[j].0 * at(i) + placed[j].1)).sum(),
    };
    Ok((0..mean.len()).into_par_iter().map(of).collect())
}
