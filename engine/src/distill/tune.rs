//! Fine-tuning: a student's Gaussians and key poses trained on photos, on images of the teacher, or on both in turn.
//!
//! Key poses are trained themselves ([`KeyOptions`]): no network stands behind them. Terms that hold them to the fit, and keys that
//! follow each other to the same change, fade to nothing. Superpoints that rest stay at rest. Rates begin where a run of training
//! ends, and go by pixels.

use glam::{DQuat, DVec3};

use crate::data::dataset::View;
use crate::data::pixels::{ImageSource, Pixels};
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::reference::{exp, table_poses};
use crate::scene::{Camera, Scene, SuperpointDeformation};
use crate::train::KeyOptions;
use crate::train::bake::Views;
use crate::train::config::Config;
use crate::train::exposure::{EXPOSURE_WORDS, identities};
use crate::train::rng;
use crate::train::sampler::ViewSampler;
use crate::train::trainer::{StepReport, Trainer, TrainingData};
use crate::train::transients::Transients;

/// Most images of the teacher that are trained on.
const TEACHER_VIEWS: u64 = 256;
/// Cameras next to one, that random ones lie on the way to.
const NEAREST: usize = 3;
/// Stream of random cameras and times.
const STREAM: u32 = 0x7455_6E65;
/// Pixels of a step, of key poses and of centres: at the start, and at the end.
const RATE_PX: [f64; 2] = [0.05, 0.002];
/// The same where images of the teacher take part, as a share: the fit is near it already.
const TEACHER_SHARE: f64 = 0.1;
/// What is left of the other rates at the end: nothing that they do is smoothed out later.
const FINAL_SHARE: f64 = 0.03;
/// λ of the terms that fade.
const HOLD: f64 = 0.05;
/// Learning rate of exposures, as at the end of training.
const EXPOSURE_RATE: f64 = 1e-3;
const SMOOTH: f64 = 0.05;

/// Draws the teacher, at the camera's time.
pub type Draw<'a> = dyn FnMut(&Camera) -> Result<Pixels> + 'a;

/// What a student learns from; with photos and cameras it is both in turn.
pub struct Lessons<'a> {
    /// Photos; none: images of the teacher alone.
    pub photos: Vec<View>,
    /// Cameras, of which random ones are made for images of the teacher; none: photos alone.
    pub cameras: Vec<Camera>,
    /// First and last time of those images.
    pub times: [f64; 2],
    /// Draws them.
    pub draw: &'a mut Draw<'a>,
    /// `[photos][40]` exposures that training found ([`exposure`](crate::train::exposure)); `None`: photos are taken as they are.
    pub exposures: Option<Vec<f32>>,
    /// What training left out of the photos ([`transients`](crate::train::transients)); `None`: photos are believed.
    pub transients: Option<Vec<u32>>,
}

/// How it learns.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TuneOptions {
    /// Steps of one image each.
    pub iterations: u64,
    /// Of the order of photos, and of random cameras and times.
    pub seed: u64,
    /// Colour behind everything.
    pub background: [f32; 3],
    /// Near plane, world units.
    pub near: f32,
    /// Pixels of a step of key poses and centres, first and last; `None`: what suits the images.
    pub rate_px: Option<[f64; 2]>,
    /// Whether the same bits come out on every run, also where the device adds faster without.
    pub deterministic: bool,
}

/// A student that has learnt.
#[derive(Debug, Clone)]
pub struct Tuned {
    /// The student.
    pub scene: Scene,
    /// Photos, and images of the teacher, that were trained on.
    pub images: [usize; 2],
    /// Mean loss of the first and of the last tenth of the steps.
    pub loss: [f64; 2],
    /// `[photos][40]`, where there were some.
    pub exposures: Option<Vec<f32>>,
}

/// Trains a student; `watch` hears of every step. The same bits come out on every run where `deterministic` asks for them.
///
/// # Errors
/// `Usage` for no steps or nothing to learn from; those of the device, of photos, of `draw`; `NonFinite`.
pub fn tune(
    gpu: &Gpu,
    student: &Scene,
    views: &Views<Camera>,
    lessons: Lessons<'_>,
    options: &TuneOptions,
    watch: &mut dyn FnMut(&StepReport),
) -> Result<Tuned> {
    let Lessons { photos, cameras, times, draw, exposures, transients } = lessons;
    if options.iterations == 0 || (photos.is_empty() && cameras.is_empty()) {
        let found = format!("{} steps, {} photos, {} cameras", options.iterations, photos.len(), cameras.len());
        return Err(Error::usage("fine-tuning", found, "steps, and photos or cameras"));
    }
    let photo_count = photos.len();
    let drawn = if cameras.is_empty() { 0 } else { TEACHER_VIEWS.min(options.iterations) };
    let mut all = photos;
    all.extend((0..drawn).map(|k| random_view(&cameras, times, options.seed, k)));
    let extent = spread(all.iter().map(|v| v.camera.position));
    let data = TrainingData { views: all.into(), extent, is_static: false };
    let share = if drawn > 0 { TEACHER_SHARE } else { 1.0 };
    let rate_px = options.rate_px.unwrap_or(RATE_PX.map(|px| share * px));
    let mut config = config(student, options, rate_px.map(|px| px * unit(student, views)));
    if exposures.is_some() {
        (config.learning_rate.exposure, config.learning_rate.exposure_final) = (EXPOSURE_RATE, EXPOSURE_RATE);
    }
    let mut trainer = trainer(gpu, student, views, &data, &config, rate_px)?;
    if let Some(mut rows) = exposures {
        rows.extend(identities(drawn as usize));
        trainer.set_exposures(&rows)?;
    }
    if let Some(mut words) = transients {
        words.extend(Transients::none(drawn as usize).words());
        trainer.set_transients(&words)?;
    }
    let mut order = Order::new(options.seed, photo_count, drawn as usize);
    let mut losses = Vec::with_capacity(options.iterations as usize);
    for i in 1..=options.iterations {
        let view = order.at(i);
        let is_new = view >= photo_count && !trainer.has_photo(view);
        let image = is_new.then(|| draw(&data.views[view].camera)).transpose()?;
        trainer.advance_on(view, image.as_ref())?;
        if i == options.iterations {
            trainer.drain()?;
        }
        while let Some(done) = trainer.take_finished() {
            losses.push(done.report.loss);
            watch(&done.report);
        }
    }
    let found = trainer.scene()?;
    let scene = Scene { gaussians: found.gaussians, deformation: found.deformation, ..student.clone() };
    let exposures = trainer.exposures()?.map(|mut rows| {
        rows.truncate(photo_count * EXPOSURE_WORDS);
        rows
    });
    Ok(Tuned { scene, images: [photo_count, drawn as usize], loss: ends(&losses), exposures })
}

/// Which image a step looks at: photos and images of the teacher in turn, each epoch of either in another order.
struct Order {
    photos: ViewSampler,
    drawn: ViewSampler,
    counts: [usize; 2],
}

impl Order {
    fn new(seed: u64, photos: usize, drawn: usize) -> Self {
        let sampler = |count| ViewSampler::new(seed, count);
        Self { photos: sampler(photos), drawn: sampler(drawn), counts: [photos, drawn] }
    }

    fn at(&mut self, iteration: u64) -> usize {
        match self.counts {
            [_, 0] => self.photos.view(iteration),
            [0, _] => self.drawn.view(iteration),
            [photos, _] if iteration.is_multiple_of(2) => photos + self.drawn.view(iteration / 2),
            _ => self.photos.view(iteration.div_ceil(2)),
        }
    }
}

fn trainer(
    gpu: &Gpu,
    student: &Scene,
    views: &Views<Camera>,
    data: &TrainingData,
    config: &Config,
    rate_px: [f64; 2],
) -> Result<Trainer> {
    match student.deformation.superpoint_deformation().filter(|s| s.table.is_some()) {
        Some(moved) => {
            let keys = keys(student, moved, views, config.iterations);
            Trainer::table(gpu, config, data, student, KeyOptions { rate_px, ..keys })
        }
        None => Trainer::new(gpu, config, data, &student.gaussians),
    }
}

/// `rate`: of centres, first and last, world units.
fn config(student: &Scene, options: &TuneOptions, rate: [f64; 2]) -> Config {
    let mut c = Config {
        iterations: options.iterations,
        seed: options.seed,
        deterministic: options.deterministic,
        background: options.background,
        near: options.near,
        ..Config::default()
    };
    (c.schedule.scale, c.schedule.sh_degree_interval, c.schedule.coarse_to_fine) = (false, 0, 0);
    c.density.enabled = false;
    // What does not move is trained without motion.
    c.motion.enabled = false;
    c.gaussians.sh_degree = student.gaussians.sh_degree;
    c.budget.max_gaussians = student.gaussians.len().max(1) as u32;
    let r = &mut c.learning_rate;
    [r.mean, r.mean_final] = rate.map(|r| r.clamp(1e-12, 1.0));
    (r.spatial_scale, r.mean_iterations) = (1.0, options.iterations);
    (r.log_scale, r.rotation, r.opacity_logit) = (1e-3, 5e-4, 0.01);
    (r.sh_0, r.sh_rest, r.final_share) = (1e-3, 1e-3 / 20.0, FINAL_SHARE);
    c
}

/// World units of a pixel where the middle one of the Gaussians is.
fn unit(student: &Scene, views: &Views<Camera>) -> f64 {
    let reach = student.gaussians.mean.iter().map(|m| views.reach(DVec3::from_array(m.map(f64::from))));
    let mut reach: Vec<f64> = reach.filter(|r| *r > 0.0 && r.is_finite()).collect();
    reach.sort_by(f64::total_cmp);
    reach.get(reach.len() / 2).map_or(1e-3, |r| 1.0 / r)
}

fn keys(student: &Scene, moved: &SuperpointDeformation, views: &Views<Camera>, iterations: u64) -> KeyOptions {
    let center: Vec<DVec3> = moved.superpoints.position.iter().map(|p| DVec3::from_array(p.map(f64::from))).collect();
    let g = &student.gaussians;
    let mut sums = vec![(1e-12, 0.0); center.len()];
    for i in 0..g.len() {
        let size: f64 = g.log_scale[i].iter().map(|&v| (2.0 * f64::from(v)).exp()).sum();
        for (j, weight) in moved.slots(i) {
            let square = DVec3::from_array(g.mean[i].map(f64::from)).distance_squared(center[j]) + size;
            sums[j] = (sums[j].0 + weight, sums[j].1 + weight * square);
        }
    }
    let [start, end] = student.time_range();
    let table = moved.table.as_ref();
    let poses = table.map_or_else(Vec::new, |table| table_poses(table, 0.5 * (start + end)));
    let rests = |j: usize| {
        let of = |rows: &[[f32; 3]]| rows.iter().skip(j).step_by(center.len()).all(|v| *v == [0.0; 3]);
        table.is_none_or(|t| of(&t.rotation) && of(&t.translation))
    };
    let unit = |(j, pose): (usize, &crate::reference::Pose)| {
        let reach = views.reach(exp(pose.rotation) * center[j] + pose.translation);
        if rests(j) || reach <= 0.0 { 0.0 } else { 1.0 / reach }
    };
    KeyOptions {
        reach: sums.iter().map(|(weight, square)| (square / weight).sqrt().max(1e-9)).collect(),
        unit: poses.iter().enumerate().map(unit).collect(),
        rate_px: RATE_PX,
        hold: HOLD,
        smooth: SMOOTH,
        iterations,
        center,
    }
}

/// A camera on the way from one of these to one next to it, at most half of it, at any time.
fn random_view(cameras: &[Camera], [start, end]: [f64; 2], seed: u64, k: u64) -> View {
    let draw = |what: u64| rng::uniform(seed, STREAM, 4 * k + what);
    let pick = |count: usize, what: u64| ((draw(what) * count as f64) as usize).min(count.saturating_sub(1));
    let one = &cameras[pick(cameras.len(), 0)];
    let mut others: Vec<&Camera> = cameras.iter().filter(|c| c.position != one.position).collect();
    others.sort_by(|a, b| {
        a.position.distance_squared(one.position).total_cmp(&b.position.distance_squared(one.position))
    });
    others.truncate(NEAREST);
    let two = others.get(pick(others.len(), 1)).copied().unwrap_or(one);
    let way = 0.5 * draw(2);
    let turn = |c: &Camera| DQuat::from_mat3(&c.rotation).normalize();
    let time = f64::from((start + (end - start) * draw(3)) as f32);
    let camera = Camera {
        name: format!("teacher {k}"),
        rotation: glam::DMat3::from_quat(turn(one).slerp(turn(two), way).normalize()),
        position: one.position.lerp(two.position, way),
        time,
        ..one.clone()
    };
    let size = [camera.width, camera.height];
    let image = ImageSource { path: "teacher".into(), stored: size, size, lens: None, mask: None, used: None };
    View { name: camera.name.clone(), time, camera, image }
}

/// Largest distance from the mean.
fn spread(places: impl Iterator<Item = DVec3> + Clone) -> f64 {
    let (count, sum) = places.clone().fold((0.0, DVec3::ZERO), |(n, sum), x| (n + 1.0, sum + x));
    let middle = sum / f64::max(count, 1.0);
    places.map(|x| x.distance(middle)).fold(0.0, f64::max)
}

/// Means of the first and of the last tenth.
fn ends(losses: &[f64]) -> [f64; 2] {
    let count = losses.len().div_ceil(10);
    let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len().max(1) as f64;
    [mean(&losses[..count]), mean(&losses[losses.len() - count..])]
}
