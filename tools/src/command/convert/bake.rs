//! `--bake`: any motion to the fewest key times within an error in pixels.

mod between;

use engine::error::{Error, Result};
use engine::reference::poses;
use engine::reference::tabulate::{PlacedGaussian, TableTimes, Tabulated, tabulate};
use engine::scene::{Blend, Gaussians, Motion, MotionSource, Scene, Superpoints};
use engine::train::bake::{self, Views};
use indicatif::ProgressBar;
use serde::Serialize;

use super::moment::Moments;
use super::views;
use crate::cli::progress;
use between::Between;

/// Cameras on which the error is measured, and their size, pixels.
const VIEWS: usize = 12;
const SIZE: [u32; 2] = [800, 800];
/// How often a table is made closer to its candidates, because it is off too far between them.
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
    /// Of network F and of a deformation field: largest displacement at times between the candidates, pixels of 800x800. Above
    /// the bound where the motion is too quick for as many times as a table may have. A table is linear in between.
    pub between_px: Option<f64>,
    /// Of soft superpoints whose weights were rounded to bytes: what that alone moves at most, pixels; part of `error_px`.
    pub rounding_px: Option<f64>,
    /// Gaussians that fall in none of the views at the candidates: they count as cameras turned to them would see them.
    pub unseen: usize,
}

impl Baked {
    /// For people.
    pub fn line(&self) -> String {
        let [before, after] = self.superpoints;
        let mut line = format!(
            "motion: {} key times of {} candidates, {after} of {before} superpoints; largest error at the candidates {:.4} px of {} (bound {})",
            self.key_times, self.candidates, self.error_px, SIZE[0], self.bound_px
        );
        if let Some(between) = self.between_px {
            let kept =
                if between <= self.bound_px { "within the bound" } else { "above the bound: the motion is too quick" };
            line += &format!("; between them {between:.4} px ({kept})");
        }
        if let Some(size) = self.size_change {
            let percent = 100.0 * size;
            line += &format!("; sizes, which change by up to {percent:.1} % for 95 % of the Gaussians, are their mean");
        }
        if let Some(px) = self.rounding_px {
            line += &format!("; weights of superpoints as bytes, which takes {px:.4} px of it");
        }
        if self.unseen > 0 {
            line += &format!("; {} Gaussians fall in no view and count as if it were turned to them", self.unseen);
        }
        line
    }
}

/// The motion of a scene at many times.
struct Candidates {
    superpoints: Superpoints,
    /// Soft superpoints.
    blend: Option<Blend>,
    motion: Motion,
    /// Of a deformation field: [`Tabulated::size_change`].
    size_change: Option<f64>,
    /// Whether the motion may be anywhere between them.
    is_free_between: bool,
}

/// Replaces the motion of `scene`, which is still the one of `moments`, by a table; networks, fields and the association,
/// which play-back does not need, go.
pub(super) fn bake(scene: &mut Scene, moments: &Moments<'_>, bound_px: f64, quiet: bool) -> Result<Baked> {
    let bar = progress::counter("times of the deformation field", quiet || scene.deformation.field().is_none());
    // Network G stays as it is, and plays no part.
    let nonrigid = scene.deformation.take_nonrigid();
    let rigid = nonrigid.is_some().then(|| scene.clone());
    let rigid = rigid.as_ref().map(|s| Moments::new(s, moments.source(), None)).transpose()?;
    let moments = rigid.as_ref().unwrap_or(moments);
    let Candidates { superpoints, blend, motion: table, size_change, is_free_between } = match scene.deformation.field()
    {
        Some(_) => of_field(scene, moments, bound_px, &bar)?,
        None => of_superpoints(scene, moments.source())?,
    };
    let views::Around { cameras, near } = views::around(moments, SIZE, VIEWS, None)?;
    let views = Views { cameras, near: f64::from(near), everywhere: true };
    let between = is_free_between.then(|| Between::of(moments, &table.times, &bar)).transpose()?;
    bar.finish_and_clear();
    let gaussians = scene.gaussians.clone();
    let (mut tolerance, mut attempts) = (bound_px, 0);
    let (baked, between_px) = loop {
        scene.gaussians.clone_from(&gaussians);
        let baked = {
            let blend = blend.as_ref();
            bake::bake(&mut scene.gaussians, &superpoints, blend, &table, &views, tolerance, true)?
        };
        scene.deformation.clone_from(&baked.deformation);
        let between_px = between.as_ref().map(|b| b.error_px(scene, &views)).transpose()?;
        attempts += 1;
        // Between its candidates a table is off by a little more than at them: then it has to be closer to those.
        let is_above = between_px.is_some_and(|px| px > bound_px);
        let all_are_kept = scene.deformation.key_times().len() == table.times.len();
        if !is_above || all_are_kept || attempts == MOST_ATTEMPTS {
            break (baked, between_px);
        }
        tolerance = (tolerance - 1.2 * (between_px.unwrap_or(0.0) - bound_px)).max(0.3 * tolerance);
    };
    if let Some(network) = nonrigid {
        scene.deformation = std::mem::take(&mut scene.deformation).with_nonrigid(network)?;
    }
    Ok(Baked {
        key_times: scene.deformation.key_times().len(),
        candidates: table.times.len(),
        superpoints: [superpoints.position.len(), scene.deformation.superpoint_count()],
        error_px: baked.error_px,
        bound_px,
        size_change,
        between_px,
        rounding_px: baked.rounding_px,
        unseen: baked.unseen,
    })
}

/// A table or network F at many times.
fn of_superpoints(scene: &Scene, source: MotionSource) -> Result<Candidates> {
    let Some(moving) = scene.deformation.superpoint_deformation() else {
        return Err(Error::usage(
            "--bake",
            "a model that does not move",
            "one with superpoints or a deformation field",
        ));
    };
    let Some(source) = scene.deformation.motion_source(source)? else {
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
    let is_free_between = source == MotionSource::Network;
    let (superpoints, blend) = (moving.superpoints.clone(), moving.blend.clone());
    Ok(Candidates { superpoints, blend, motion, size_change: None, is_free_between })
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
    Ok(Candidates { superpoints, blend: None, motion, size_change: Some(size_change), is_free_between: true })
}

/// The key times of a table and the middles between them; evenly spread times for network F.
fn candidates(scene: &Scene, source: MotionSource) -> Vec<f64> {
    if let (MotionSource::Table, Some(motion)) = (source, scene.deformation.table()) {
        let keys: Vec<f64> = motion.times.iter().map(|&t| f64::from(t)).collect();
        let middles = keys.windows(2).map(|w| 0.5 * (w[0] + w[1]));
        let mut all: Vec<f64> = keys.iter().copied().chain(middles).map(|t| f64::from(t as f32)).collect();
        all.sort_by(f64::total_cmp);
        all.dedup();
        return all;
    }
    let [start, end] = scene.time_range();
    let step = (end - start) / (NETWORK_TIMES - 1) as f64;
    (0..NETWORK_TIMES).map(|i| f64::from((start + step * i as f64) as f32)).collect()
}
