//! Whether a run does better when it begins with photos of one moment: two beginnings of one run are compared.
//!
//! Where large things move far, all photos at once build up what stands still alone, and network F has nothing of the rest to move.
//! From one moment on (`schedule.time_window`) they are followed; but where parts move little, that moment's few photos
//! are a worse start. Photos that neither was trained on tell which is better.

use super::kept_aside::trial_window;
use super::trainer::{Trainer, TrainingData};
use crate::error::{Error, Result};
use crate::render::{RenderOptions, Renderer};
use crate::scene::Gaussians;

/// A smaller mean square error counts as this one.
const LEAST: f64 = 1e-12;

/// What a trial found.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct WindowTrial {
    /// Iterations that both beginnings had.
    pub iterations: u64,
    /// PSNR of the photos kept aside, mean over them, dB: as the run is, and with the window.
    pub psnr: [f64; 2],
    /// Whether the run goes on from the beginning with the window.
    pub taken: bool,
}

impl std::fmt::Display for WindowTrial {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [without, with] = self.psnr;
        let verdict = if self.taken { "taken" } else { "not taken" };
        write!(
            f,
            "time window: {verdict}; after {} iterations photos kept aside have {with:.2} dB with it, {without:.2} dB without",
            self.iterations
        )
    }
}

impl Trainer {
    /// Whether [`try_window`] is due before the next step: after `schedule.window_trial` iterations of a run without a window.
    pub fn tries_window(&self) -> bool {
        let s = &self.schedule.config().schedule;
        s.time_window == 0 && self.iteration() == s.window_trial && self.aside.photos().count() > 0
    }

    /// PSNR of the photos kept aside, at their present size; see [`WindowTrial::psnr`].
    fn psnr_of_kept_aside(&self) -> Result<f64> {
        let places: Vec<usize> = self.aside.photos().map(|photo| self.pyramid.at(photo, self.iteration())).collect();
        let scene = self.scene_of_photos(places.iter().map(|&place| self.pyramid.views[place].time))?;
        let (background, near) = (self.config().background, self.config().near);
        let options = RenderOptions { background, near, ..RenderOptions::default() };
        let exposures = self.exposures()?;
        let mut renderer = Renderer::new(&self.gpu, &scene, &options)?;
        let mut sum = 0.0;
        for &place in &places {
            let (_, errors) = self.errors_of(&mut renderer, place, exposures.as_deref())?;
            let squares = errors.iter().map(|e| f64::from(*e).powi(2)).sum::<f64>() / errors.len().max(1) as f64;
            sum += -10.0 * squares.max(LEAST).log10();
        }
        Ok(sum / places.len().max(1) as f64)
    }
}

/// Trains another beginning of the run, with a window of times, for as many iterations from the same `first` Gaussians, and puts it in
/// the run's place if photos kept aside have a higher PSNR with it. The run is then the one that `schedule.time_window` gives.
/// `goes_on` is asked before each of its iterations. `None` where it stops the trial, or where there is no room for a second
/// beginning; the run is as it was.
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
    let mut config = run.config().clone();
    config.schedule.time_window = trial_window(&config);
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
    let psnr = [run.psnr_of_kept_aside()?, other.psnr_of_kept_aside()?];
    Ok(Some((WindowTrial { iterations: run.iteration(), psnr, taken: psnr[1] > psnr[0] }, other)))
}
