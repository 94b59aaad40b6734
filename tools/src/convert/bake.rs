//! `--bake`: any motion to the fewest key times within an error in pixels.

mod between;

use engine::error::{Error, Result};
use engine::reference::poses;
use engine::reference::tabulate::{PlacedGaussian, TableTimes, Tabulated, tabulate};
use engine::scene::{Gaussians, Motion, MotionSource, Scene, Superpoints};
use engine::train::bake;
use indicatif::ProgressBar;
use serde::Serialize;

use super::{Moments, cameras};
use crate::args::Global;
use crate::{progress, view};
use between::Between;

/// Cameras on which the error is measured, and their size, pixels.
const VIEWS: usize = 12;
const SIZE: [u32; 2] = [800, 800];
/// Nearest depth that is drawn, world units.
const NEAR: f64 = 0.2;
/// How often a table is made closer to a field's candidates, because it is off too far between them.
const MOST_ATTEMPTS: u32 = 4;
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
    /// Of a deformation field: how far the sizes of 95 % of the Gaussians are at most from the mean that each now has, as a
    /// share of it.
    pub size_change: Option<f64>,
    /// Of a deformation field: largest displacement at times between the candidates, pixels of 800x800. Above the bound where
    /// the motion is too quick for as many times as a table may have.
    pub between_px: Option<f64>,
}

impl Baked {
    /// For people.
    pub fn line(&self) -> String {
        let [before, after] = self.superpoints;
        let mut line = format!(
            "motion: {} key times of {} candidates, {after} of {before} superpoints; largest error {:.4} px of {} (bound {})",
            self.key_times, self.candidates, self.error_px, SIZE[0], self.bound_px
        );
        if let (Some(size), Some(between)) = (self.size_change, self.between_px) {
            let kept =
                if between <= self.bound_px { "within the bound" } else { "above the bound: the motion is too quick" };
            line += &format!(
                "; between the candidates {between:.4} px ({kept}); sizes, which change by up to {:.1} % for 95 % of the Gaussians, are their mean",
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
    /// Of a deformation field: [`Tabulated::size_change`].
    size_change: Option<f64>,
}

/// Replaces the motion of `scene` by a table; networks, fields and the association, which play-back does not need, go.
pub(super) fn bake(
    scene: &mut Scene,
    source: MotionSource,
    bound_px: f64,
    global: &Global,
    quiet: bool,
) -> Result<Baked> {
    // The field with its sizes, for what is measured afterwards.
    let before_all = scene.field.is_some().then(|| scene.clone());
    let moments = before_all.as_ref().map(|s| Moments::new(s, MotionSource::Auto, global)).transpose()?;
    let bar = progress::counter("times of the deformation field", global.quiet || quiet || moments.is_none());
    let Candidates { superpoints, motion: table, size_change } = match &moments {
        Some(moments) => of_field(scene, moments, bound_px, &bar)?,
        None => of_superpoints(scene, source)?,
    };
    let cameras = cameras(scene, SIZE, VIEWS, None);
    let between = moments.map(|m| Between::of(&m, &table.times, &bar)).transpose()?;
    bar.finish_and_clear();
    let gaussians = scene.gaussians.clone();
    (scene.deform, scene.association, scene.field) = (None, None, None);
    let (mut tolerance, mut attempts) = (bound_px, 0);
    let (error_px, between_px) = loop {
        scene.gaussians.clone_from(&gaussians);
        let baked = bake::bake(&mut scene.gaussians, &superpoints, &table, &cameras, NEAR, tolerance, true)?;
        (scene.superpoints, scene.motion) = (baked.superpoints, baked.motion);
        let between_px = between.as_ref().map(|b| b.error_px(scene, &cameras)).transpose()?;
        attempts += 1;
        // Between its candidates a table is off by a little more than at them: then it has to be closer to those.
        let is_above = between_px.is_some_and(|px| px > bound_px);
        let all_are_kept = scene.motion.as_ref().is_some_and(|m| m.times.len() == table.times.len());
        if !is_above || all_are_kept || attempts == MOST_ATTEMPTS {
            break (baked.error_px, between_px);
        }
        tolerance = (tolerance - 1.2 * (between_px.unwrap_or(0.0) - bound_px)).max(0.3 * tolerance);
    };
    Ok(Baked {
        key_times: scene.motion.as_ref().map_or(0, |m| m.times.len()),
        candidates: table.times.len(),
        superpoints: [superpoints.position.len(), scene.superpoints.as_ref().map_or(0, |s| s.position.len())],
        error_px,
        bound_px,
        size_change,
        between_px,
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
    Ok(Candidates { superpoints, motion, size_change: None })
}

/// A deformation field at as many times as it takes: one superpoint for each Gaussian that moves.
fn of_field(scene: &mut Scene, moments: &Moments<'_>, bound_px: f64, bar: &ProgressBar) -> Result<Candidates> {
    let mut place = |g: &Gaussians, time: f64| {
        bar.inc(1);
        let offsets = moments.offsets(time)?;
        Ok(offsets.iter().enumerate().map(|(i, offset)| PlacedGaussian::shifted(g, i, offset)).collect())
    };
    // A scene's extent is about half of the view's width or less: what is off by less than the bound's share of the width in
    // units of the extent is off by less than the bound in the view.
    let within = TableTimes::Within(bound_px / f64::from(SIZE[0]));
    let Tabulated { motion, superpoints, size_change, .. } =
        tabulate(&mut scene.gaussians, &mut place, within, "the deformation field")?;
    Ok(Candidates { superpoints, motion, size_change: Some(size_change) })
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
