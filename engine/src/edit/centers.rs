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
    centers_of(scene, 0..scene.gaussians.len(), time)
}

/// The centres of the Gaussians `of`.
///
/// # Errors
/// Those of [`place_scene`].
pub fn centers_of(scene: &Scene, of: impl IntoParallelIterator<Item = usize>, time: f64) -> Result<Vec<DVec3>> {
    Ok(of.into_par_iter().map(center_at(scene, time)?).collect())
}

/// What tells the centre of a Gaussian at `time`: for those who look at each once, and keep none.
///
/// # Errors
/// Those of [`place_scene`].
pub(super) fn center_at(scene: &Scene, time: f64) -> Result<Box<dyn Fn(usize) -> DVec3 + Sync + Send + '_>> {
    if scene.deformation.changes_scales() {
        let placed = place_scene(scene, time, MotionSource::Auto)?.mean;
        return Ok(Box::new(move |i| placed[i]));
    }
    let mean = &scene.gaussians.mean;
    let at = |i: usize| DVec3::from_array(mean[i].map(f64::from));
    let (Some(poses), Some(s)) = (poses(scene, time, MotionSource::Auto)?, scene.deformation.superpoint_deformation())
    else {
        return Ok(Box::new(at));
    };
    let placed: Vec<(DMat3, DVec3)> = poses.iter().map(|p| (exp(p.rotation), p.translation)).collect();
    Ok(match &s.blend {
        None => Box::new(move |i| {
            let (turn, shift) = placed[s.superpoints.of_gaussian[i] as usize];
            turn * at(i) + shift
        }),
        Some(blend) => Box::new(move |i| blend.slots(i).map(|(j, w)| w * (placed[j].0 * at(i) + placed[j].1)).sum()),
    })
}
