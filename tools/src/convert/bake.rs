//! `--bake`: any motion to the fewest key times within an error in pixels.

use engine::error::{Error, Result};
use engine::reference::poses;
use engine::scene::{Motion, MotionSource, Scene};
use engine::train::bake;
use serde::Serialize;

use super::cameras;
use crate::view;

/// Cameras on which the error is measured, and their size, pixels.
const VIEWS: usize = 12;
const SIZE: [u32; 2] = [800, 800];
/// Times at which network F is evaluated; the error of the table is measured at them.
const NETWORK_TIMES: usize = 129;

/// A table that was made.
#[derive(Debug, Serialize)]
pub struct Baked {
    /// T.
    pub key_times: usize,
    /// Times that were looked at.
    pub candidates: usize,
    /// M before and after: superpoints that never move share one.
    pub superpoints: [usize; 2],
    /// Largest displacement in the image, pixels of 800x800.
    pub error_px: f64,
    /// The bound.
    pub bound_px: f64,
}

impl Baked {
    /// For people.
    pub fn line(&self) -> String {
        let [before, after] = self.superpoints;
        format!(
            "motion: {} key times of {} candidates, {after} of {before} superpoints; largest error {:.4} px of {} (bound {})",
            self.key_times, self.candidates, self.error_px, SIZE[0], self.bound_px
        )
    }
}

/// Replaces the motion of `scene` by a table; network F and the association, which play-back does not need, go.
pub(super) fn bake(scene: &mut Scene, source: MotionSource, bound_px: f64) -> Result<Baked> {
    let Some(superpoints) = scene.superpoints.clone() else {
        return Err(Error::usage("--bake", "a model that does not move", "one with superpoints"));
    };
    let Some(source) = scene.motion_source(source)? else {
        return Err(Error::usage("--bake", "superpoints without motion", "a key-time table or network F"));
    };
    let times = candidates(scene, source);
    let mut table = Motion { times: times.iter().map(|&t| t as f32).collect(), ..Motion::default() };
    for &time in &times {
        for pose in poses(scene, time, source)?.unwrap_or_default() {
            table.rotation.push(pose.rotation.as_vec3().to_array());
            table.translation.push(pose.translation.as_vec3().to_array());
        }
    }
    let cameras = cameras(scene, SIZE, VIEWS, None);
    let before = superpoints.position.len();
    let baked = bake::bake(&mut scene.gaussians, &superpoints, &table, &cameras, 0.2, bound_px, true)?;
    scene.superpoints = baked.superpoints;
    scene.motion = baked.motion;
    scene.deform = None;
    scene.association = None;
    Ok(Baked {
        key_times: scene.motion.as_ref().map_or(0, |m| m.times.len()),
        candidates: times.len(),
        superpoints: [before, scene.superpoints.as_ref().map_or(0, |s| s.position.len())],
        error_px: baked.error_px,
        bound_px,
    })
}

/// The key times of a table and the middles between them; evenly spread times for network F.
fn candidates(scene: &Scene, source: MotionSource) -> Vec<f64> {
    if let (MotionSource::Table, Some(motion)) = (source, &scene.motion) {
        let keys: Vec<f64> = motion.times.iter().map(|&t| f64::from(t)).collect();
        let middles = keys.windows(2).map(|w| 0.5 * (w[0] + w[1]));
        let mut all: Vec<f64> = keys.iter().copied().chain(middles).map(|t| f64::from(t as f32)).collect();
        all.sort_by(f64::total_cmp);
        all.dedup();
        return all;
    }
    let [start, end] = view::time_range(scene);
    let step = (end - start) / (NETWORK_TIMES - 1) as f64;
    (0..NETWORK_TIMES).map(|i| f64::from((start + step * i as f64) as f32)).collect()
}
