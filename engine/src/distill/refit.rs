//! The end of a training run: its motion made of few rigid parts, and these trained on the photos in place of network F.
//!
//! Parts follow network F within a bound ([`distill`](super::distill)); neighbours that move alike become one. Then key poses and Gaussians
//! are trained ([`tune`]): a step does not run the network, and a part's pose is learnt from all that shows it.

use super::tune::{Lessons, TuneOptions, tune};
use super::{Options, Tick, distill};
use crate::data::dataset::View;
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::reference::freeze;
use crate::scene::{Camera, MotionSource, Scene};
use crate::train::bake::Views;
use crate::train::config::Config;
use crate::train::trainer::StepReport;

/// Cameras in which the bound is measured, at most.
const CAMERAS: usize = 12;

/// What became of a run's motion.
#[derive(Debug, Clone)]
pub struct Refitted {
    /// The model.
    pub scene: Scene,
    /// Superpoints before and after.
    pub superpoints: [usize; 2],
    /// How far the parts were allowed to be off, pixels, and were off before they were trained.
    pub error_px: [f64; 2],
    /// Mean loss of the first and of the last tenth of the steps.
    pub loss: [f64; 2],
}

/// The bound in pixels of these photos: `refit.error` of their shorter side.
fn bound_px(photos: &[View], config: &Config) -> f64 {
    let side = photos.iter().map(|v| v.camera.width.min(v.camera.height)).max().unwrap_or(1);
    config.refit.error * f64::from(side)
}

fn views(photos: &[View], config: &Config) -> Views<Camera> {
    let count = CAMERAS.min(photos.len());
    let camera = |v: &View| Camera { time: v.time, ..v.camera.clone() };
    let cameras = (0..count).map(|k| camera(&photos[k * photos.len() / count])).collect();
    Views { cameras, near: f64::from(config.near), everywhere: true }
}

/// Fits and trains a run's exported model for the steps that `config`, scaled, leaves to this; `None` where nothing moves by
/// superpoints alone. `tick` hears of the fit, `watch` of every step.
///
/// # Errors
/// Those of [`distill`](super::distill) and [`tune`].
pub fn refit(
    gpu: &Gpu,
    scene: &Scene,
    photos: &[View],
    config: &Config,
    tick: &mut Tick<'_>,
    watch: &mut dyn FnMut(&StepReport),
) -> Result<Option<Refitted>> {
    let iterations = config.refit_iterations();
    let alone = scene.deformation.nonrigid().is_none() && scene.deformation.field().is_none();
    if iterations == 0 || !alone || scene.deformation.table().is_none() || !scene.deformation.moves() {
        return Ok(None);
    }
    let views = views(photos, config);
    let options = Options { error_px: bound_px(photos, config), ..Options::default() };
    let mut place = |time: f64| freeze(scene, time, MotionSource::Table);
    let fitted = distill(scene, &mut place, &views, &options, tick)?;
    let mut none = |_: &Camera| Err(Error::usage("refit", "an image of the teacher", "photos alone"));
    let lessons = Lessons { photos: photos.to_vec(), cameras: Vec::new(), times: scene.time_range(), draw: &mut none };
    let (seed, background, near) = (config.seed, config.background, config.near);
    let how = TuneOptions { iterations, seed, background, near, rate_px: None };
    let tuned = tune(gpu, &fitted.scene, &views, lessons, &how, watch)?;
    let superpoints = [scene, &tuned.scene].map(|s| s.deformation.superpoint_count());
    let largest = fitted.yardstick.measure(&fitted.scene, &views)?.error_px.largest;
    Ok(Some(Refitted { scene: tuned.scene, superpoints, error_px: [options.error_px, largest], loss: tuned.loss }))
}
