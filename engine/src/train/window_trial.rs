//! Whether a run does better when it begins with photos of one moment: two beginnings of one run are compared.
//!
//! Where large things move far, all photos at once build up what stands still alone, and network F has nothing of the rest to move.
//! From one moment on (`schedule.time_window`) they are followed; but where parts move little, that moment's few photos
//! are a worse start. What network F has made of the run so far tells: where most superpoints move it is left alone, where
//! they rest the other beginning is tried.

use super::schedule::Stage;
use super::trainer::{Trainer, TrainingData};
use crate::error::{Error, Result};
use crate::reference::{exp, table_poses};
use crate::render::{RenderOptions, Renderer};
use crate::scene::{Gaussians, Motion, SuperpointDeformation};
use glam::{DVec3, Vec3};

/// The window is open after so many parts of a trial.
const OPENS: [u64; 2] = [2, 3];
/// Nothing is tried where more than this share of the superpoints move.
const MOST_MOVING: f64 = 0.5;
/// A superpoint rests if it stays within this share of the cameras' radius.
const RESTS: f64 = 1e-3;
/// The window is taken if photos are off by less than this many times what they are off without it: it pays later on.
const NOT_WORSE: f64 = 1.05;
/// Photos that are compared; of more, so many at equal distances.
const MOST_PHOTOS: usize = 100;
/// The same of times.
const MOST_TIMES: usize = 33;

/// What a trial found.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct WindowTrial {
    /// Iterations that both beginnings had.
    pub iterations: u64,
    /// Root mean square error of a photo's pixels, mean over photos: as the run is, and with the window.
    pub error: [f64; 2],
    /// Share of the run's superpoints that move.
    pub moving: f64,
    /// Whether the run goes on from the beginning with the window.
    pub taken: bool,
}

impl std::fmt::Display for WindowTrial {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [without, with] = self.error;
        let moving = 100.0 * self.moving;
        let verdict = if self.taken { "taken" } else { "not taken" };
        write!(
            f,
            "time window: {verdict}; {moving:.0} % of the superpoints move after {} iterations; photos are off by {with:.4} with it, \
             {without:.4} without",
            self.iterations
        )
    }
}

impl Trainer {
    /// Whether [`try_window`] is due before the next step: after `schedule.window_trial` iterations of a run without a window.
    pub fn tries_window(&self) -> bool {
        let s = &self.schedule.config().schedule;
        let opens = s.window_trial * OPENS[0] / OPENS[1];
        self.schedule.stage() == Stage::Rigid
            && s.time_window == 0
            && self.iteration() == s.window_trial
            && opens > s.warm_up
    }

    /// Share of the superpoints that move between the times of the photos.
    fn moving(&self) -> Result<f64> {
        let mut times: Vec<f32> = self.pyramid.full().iter().map(|v| v.time as f32).collect();
        times.sort_by(f32::total_cmp);
        times.dedup();
        let step = times.len().div_ceil(MOST_TIMES).max(1);
        let times: Vec<f32> = times.into_iter().step_by(step).collect();
        let scene = self.scene_of_photos(times.iter().map(|t| f64::from(*t)))?;
        let Some(moved) = scene.deformation.superpoint_deformation() else { return Ok(0.0) };
        let Some(table) = &moved.table else { return Ok(0.0) };
        let paths: Vec<Vec<DVec3>> = times.iter().map(|t| places(table, f64::from(*t), moved)).collect();
        let bound = RESTS * self.schedule.extent();
        let count = moved.superpoints.position.len();
        let moves = |j: &usize| paths.iter().any(|at| at[*j].distance(paths[0][*j]) > bound);
        Ok((0..count).filter(moves).count() as f64 / count.max(1) as f64)
    }

    /// By how much the photos at their present size are off; see [`WindowTrial::error`].
    fn photo_error(&self) -> Result<f64> {
        let places = self.pyramid.places(self.iteration());
        let step = places.len().div_ceil(MOST_PHOTOS).max(1);
        let scene = self.scene_of_photos(places.clone().step_by(step).map(|place| self.pyramid.views[place].time))?;
        let (background, near) = (self.config().background, self.config().near);
        let options = RenderOptions { background, near, ..RenderOptions::default() };
        let exposures = self.exposures()?;
        let mut renderer = Renderer::new(&self.gpu, &scene, &options)?;
        let mut sum = 0.0;
        for place in places.clone().step_by(step) {
            let (_, errors) = self.errors_of(&mut renderer, place, exposures.as_deref())?;
            sum += errors.iter().map(|e| f64::from(*e)).sum::<f64>() / errors.len().max(1) as f64;
        }
        Ok(sum / places.step_by(step).len().max(1) as f64)
    }
}

/// Where superpoints are at a time, world space.
fn places(table: &Motion, time: f64, moved: &SuperpointDeformation) -> Vec<DVec3> {
    let centres = moved.superpoints.position.iter().map(|p| Vec3::from_array(*p).as_dvec3());
    table_poses(table, time)
        .iter()
        .zip(centres)
        .map(|(pose, centre)| exp(pose.rotation) * centre + pose.translation)
        .collect()
}

/// Where at most half of the superpoints move, trains another beginning of the run, with a window of times, for as many iterations from
/// the same `first` Gaussians, and puts it in the run's place unless its photos are off by much more. The run is then the one that
/// `schedule.time_window` gives. `goes_on` is asked before each of its iterations. `None` where more superpoints move, where
/// `goes_on` stops it, or where there is no room for a second beginning; the run is as it was.
///
/// # Errors
/// As [`Trainer::new`] and [`Trainer::step`]; `Usage` while steps are in flight.
pub fn try_window(
    run: &mut Trainer,
    data: &TrainingData,
    first: &Gaussians,
    goes_on: &mut dyn FnMut(u64) -> bool,
) -> Result<Option<WindowTrial>> {
    match other_beginning(run, data, first, goes_on) {
        Ok(Some((trial, other))) => {
            if trial.taken {
                *run = other;
            }
            Ok(Some(trial))
        }
        Ok(None) | Err(Error::OutOfMemory { .. } | Error::Limit { .. }) => Ok(None),
        Err(other) => Err(other),
    }
}

fn other_beginning(
    run: &Trainer,
    data: &TrainingData,
    first: &Gaussians,
    goes_on: &mut dyn FnMut(u64) -> bool,
) -> Result<Option<(WindowTrial, Trainer)>> {
    run.settled()?;
    let moving = run.moving()?;
    if moving > MOST_MOVING {
        return Ok(None);
    }
    let mut config = run.config().clone();
    config.schedule.time_window = config.schedule.window_trial * OPENS[0] / OPENS[1];
    let mut other = Trainer::new(&run.gpu, &config, data, first)?.with_profile(run.profile);
    while other.iteration() < run.iteration() {
        if !goes_on(other.iteration()) {
            return Ok(None);
        }
        other.advance()?;
        while other.take_finished().is_some() {}
    }
    other.drain()?;
    while other.take_finished().is_some() {}
    let error = [run.photo_error()?, other.photo_error()?];
    let taken = error[1] < NOT_WORSE * error[0];
    Ok(Some((WindowTrial { iterations: run.iteration(), error, moving, taken }, other)))
}
