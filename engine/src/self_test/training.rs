//! Training steps as they are taken: every kernel against its twin, and a loss that falls.

use std::sync::Arc;

use glam::DVec3;

use super::outcome;
use crate::data::dataset::View;
use crate::data::pixels::{ImageSource, Pixels};
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::reference::{self, ReferenceOptions};
use crate::scene::synthetic::random_gaussians;
use crate::scene::{Camera, Gaussians, Scene};
use crate::train::blend_backward::Accumulation;
use crate::train::config::{Config, Form};
use crate::train::trainer::{Trainer, TrainingData};

/// Gaussians of the photo, and those that training starts from.
const GAUSSIANS: usize = 160;
const SEED: u64 = 23;
/// Pixels: partial tiles on both sides.
const SIZE: [u32; 2] = [37, 27];
const TIME: f64 = 0.4;
/// Steps whose loss must fall, and to what share of the first one.
const STEPS: usize = 6;
const FALLS_TO: f64 = 0.97;

/// Tests the kernels of a step and of density control, then steps without anybody watching.
pub(super) fn test(gpu: &Gpu) -> Result<()> {
    let photo = photo()?;
    let first = first();
    watched_step(gpu, &config(true), &photo, &first)?;
    // A device with float atomics adds gradients in another way unless bits must repeat.
    if Accumulation::of_device(gpu, false) != Accumulation::of_device(gpu, true) {
        let config = Config { deterministic: true, ..config(false) };
        watched_step(gpu, &config, &photo, &first)?;
    }
    let mut paper = config(false);
    paper.loss.prop_loss = Form::Paper;
    watched_step(gpu, &paper, &photo, &first)?;
    loss_falls(gpu, &photo, &first)
}

/// Tests the kernels of a step with soft superpoints.
pub(super) fn test_soft(gpu: &Gpu) -> Result<()> {
    let mut config = config(true);
    config.motion.blend = 3;
    watched_step(gpu, &config, &photo()?, &first())
}

/// Tests the kernels of a step of the non-rigid stage.
pub(super) fn test_nonrigid(gpu: &Gpu) -> Result<()> {
    let (photo, config) = (photo()?, config(true));
    let mut trainer = Trainer::new(gpu, &config, &data(), &first())?;
    trainer.step_on(0, &photo)?;
    let trained = trainer.checkpoint()?;
    drop(trainer);
    let (watched, watch) = gpu.watched();
    let stepped = Trainer::nonrigid(&watched, &config, &data(), &trained)?.step_on(0, &photo);
    outcome(&watch, stepped).map(|_| ())
}

fn camera() -> Camera {
    Camera::look_at(DVec3::new(1.5, 0.9, 2.8), DVec3::ZERO, DVec3::Y, 0.8, SIZE)
}

/// The Gaussians of the photo, larger ones than a trained model has, so that each is seen.
fn truth() -> Gaussians {
    random_gaussians(GAUSSIANS, SEED, 1)
}

/// Where training starts: the same places, without colour and nearly clear.
fn first() -> Gaussians {
    let mut g = truth();
    g.sh.fill(0.2);
    g.opacity_logit.fill(-0.5);
    g
}

/// What the f64 reference sees.
fn photo() -> Result<Pixels> {
    let scene = Scene { gaussians: truth(), ..Scene::default() };
    let image = reference::render(&scene, &camera(), TIME, &ReferenceOptions::default())?;
    let byte = |v: f64| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
    let pixel = |i: usize| {
        let [r, g, b] = [0, 1, 2].map(|c| byte(image.rgb[3 * i + c]));
        u32::from_le_bytes([r, g, b, u8::MAX])
    };
    Ok(Pixels { width: image.width, height: image.height, rgba: (0..image.alpha.len()).map(pixel).collect() })
}

/// Superpoints, network F, density control and its checks from the first step on. `adapts`: with density control.
fn config(adapts: bool) -> Config {
    let mut c = Config { iterations: 1000, ..Config::default() };
    c.schedule.scale = false;
    c.schedule.warm_up = 1;
    c.schedule.sh_degree_interval = 0;
    c.gaussians.sh_degree = 1;
    c.motion.superpoints = 6;
    c.motion.network_layers = 2;
    c.motion.network_width = 32;
    c.motion.zero_heads = false;
    c.density.enabled = adapts;
    c.density.from = 0;
    c.density.interval = 1;
    c.density.opacity_reset_interval = 1;
    c.density.gradient_threshold = 1e-6;
    // Fewer than want to grow, so that density control has to choose.
    c.budget.max_gaussians = GAUSSIANS as u32 + 40;
    c.log.finite_interval = 1;
    c
}

fn data() -> TrainingData {
    let image = ImageSource { path: "self-test".into(), stored: SIZE, size: SIZE, lens: None, mask: None, used: None };
    let view = |time| View { name: "self-test".into(), camera: camera(), time, image: image.clone() };
    TrainingData { views: Arc::new([view(TIME), view(1.0 - TIME)]), extent: 2.0, is_static: false }
}

/// A step of the rigid stage, each dispatch against its twin.
fn watched_step(gpu: &Gpu, config: &Config, photo: &Pixels, first: &Gaussians) -> Result<()> {
    let (watched, watch) = gpu.watched();
    let mut trainer = Trainer::new(&watched, config, &data(), first)?;
    let stepped = trainer.step_on(0, photo);
    outcome(&watch, stepped).map(|_| ())
}

/// Steps as users take them.
fn loss_falls(gpu: &Gpu, photo: &Pixels, first: &Gaussians) -> Result<()> {
    let mut trainer = Trainer::new(gpu, &config(false), &data(), first)?;
    let losses = (0..STEPS).map(|_| Ok(trainer.step_on(0, photo)?.loss)).collect::<Result<Vec<f64>>>()?;
    let (start, end) = (losses[0], losses[STEPS - 1]);
    if end <= FALLS_TO * start {
        return Ok(());
    }
    let why = format!("after {STEPS} steps the loss is {end:.5}, expected at most {FALLS_TO} of the first, {start:.5}");
    Err(Error::Kernel { kernel: "a training step".into(), why })
}
