//! `--bake`: any motion to the fewest key times within an error in pixels.

use engine::error::{Error, Result};
use engine::reference::poses;
use engine::reference::tabulate::{PlacedGaussian, TableTimes, Tabulated, tabulate};
use engine::scene::{Gaussians, Motion, MotionSource, Scene, Superpoints};
use engine::train::bake;
use serde::Serialize;

use super::{Moments, cameras};
use crate::args::Global;
use crate::{progress, view};

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
    /// Of a deformation field: largest change of a size over time against the mean that each Gaussian now has, as a share.
    pub size_change: Option<f64>,
    /// Of a deformation field: by how much centres are off the line between the candidates next but one, relative to the
    /// scene's extent; between neighbouring candidates it is about a quarter of that.
    pub between: Option<f64>,
}

impl Baked {
    /// For people.
    pub fn line(&self) -> String {
        let [before, after] = self.superpoints;
        let mut line = format!(
            "motion: {} key times of {} candidates, {after} of {before} superpoints; largest error {:.4} px of {} (bound {})",
            self.key_times, self.candidates, self.error_px, SIZE[0], self.bound_px
        );
        if let (Some(size), Some(between)) = (self.size_change, self.between) {
            line += &format!(
                "; a table of every other candidate is off by {between:.1e} of the extent; sizes, which change by up to {:.1} %, are kept at their mean",
                100.0 * size
            );
        }
        line
    }
}

/// The motion of a scene at many times.
struct Candidates {
    superpoints: Superpoints,
    motion: Motion,
    /// Of a deformation field: [`Tabulated::size_change`] and [`Tabulated::error`].
    field: Option<[f64; 2]>,
}

/// Replaces the motion of `scene` by a table; networks, fields and the association, which play-back does not need, go.
pub(super) fn bake(
    scene: &mut Scene,
    source: MotionSource,
    bound_px: f64,
    global: &Global,
    quiet: bool,
) -> Result<Baked> {
    let Candidates { superpoints, motion: table, field } = match scene.field.is_some() {
        true => of_field(scene, bound_px, global, quiet)?,
        false => of_superpoints(scene, source)?,
    };
    let cameras = cameras(scene, SIZE, VIEWS, None);
    let before = superpoints.position.len();
    let candidates = table.times.len();
    let baked = bake::bake(&mut scene.gaussians, &superpoints, &table, &cameras, 0.2, bound_px, true)?;
    scene.superpoints = baked.superpoints;
    scene.motion = baked.motion;
    (scene.deform, scene.association, scene.field) = (None, None, None);
    Ok(Baked {
        key_times: scene.motion.as_ref().map_or(0, |m| m.times.len()),
        candidates,
        superpoints: [before, scene.superpoints.as_ref().map_or(0, |s| s.position.len())],
        error_px: baked.error_px,
        bound_px,
        size_change: field.map(|[size_change, _]| size_change),
        between: field.map(|[_, between]| between),
    })
}

/// A table or network F at many times.
fn of_superpoints(scene: &Scene, source: MotionSource) -> Result<Candidates> {
    let Some(superpoints) = scene.superpoints.clone() else {
        return Err(Error::usage(
            "--bake",
            "a model that does not move",
            "one with superpoints or a deformation field",
        ));
    };
    let Some(source) = scene.motion_source(source)? else {
        return Err(Error::usage("--bake", "superpoints without motion", "a key-time table or network F"));
    };
    let times = candidates(scene, source);
    let mut motion = Motion { times: times.iter().map(|&t| t as f32).collect(), ..Motion::default() };
    for &time in &times {
        for pose in poses(scene, time, source)?.unwrap_or_default() {
            motion.rotation.push(pose.rotation.as_vec3().to_array());
            motion.translation.push(pose.translation.as_vec3().to_array());
        }
    }
    Ok(Candidates { superpoints, motion, field: None })
}

/// A deformation field at as many times as it takes: one superpoint for each Gaussian that moves.
fn of_field(scene: &mut Scene, bound_px: f64, global: &Global, quiet: bool) -> Result<Candidates> {
    let whole = scene.clone();
    let moments = Moments::new(&whole, MotionSource::Auto, global)?;
    let bar = progress::counter("times of the deformation field", global.quiet || quiet);
    let mut place = |g: &Gaussians, time: f64| {
        bar.inc(1);
        let offsets = moments.offsets(time)?;
        Ok(offsets.iter().enumerate().map(|(i, offset)| PlacedGaussian::shifted(g, i, offset)).collect())
    };
    // A scene's extent is about half of the view's width or less: what is off by less than the bound's share of the width in
    // units of the extent is off by less than the bound in the view.
    let within = TableTimes::Within(bound_px / f64::from(SIZE[0]));
    let Tabulated { motion, superpoints, error, size_change } =
        tabulate(&mut scene.gaussians, &mut place, within, "the deformation field")?;
    bar.finish_and_clear();
    Ok(Candidates { superpoints, motion, field: Some([size_change, error]) })
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
