//! [`Trainer`]: state and the one step that reads like the paper's algorithm.

mod cost;
pub mod flight;
mod record;
mod restore;

use super::association::AssociationOptions;
use super::blend_backward::{Accumulation, ROW_WORDS};
use super::config::Config;
use super::deform_project_backward::SLOT_PLANES;
use super::deformation::{self, Trained};
use super::density::DensityChange;
use super::exposure::{ExposureState, identities};
use super::kept_aside::KeptAside;
use super::lost::LostObject;
use super::parameters::{ParameterState, Parameters};
use super::photos::Photos;
use super::pyramid::{Pyramid, opaque_area};
use super::rng;
use super::sampler::ViewSampler;
use super::schedule::{Counts, Schedule, Stage};
use super::status;
use super::step::Step;
use super::target::{Target, TargetSize};
use super::time_window::TimeWindow;
use super::transients::{Transients, TransientsFound};
use crate::data::dataset::View;
use crate::data::loader::ImageLoader;
use crate::data::pixels::Pixels;
use crate::error::{Error, Result};
use crate::gpu::capability::TRAINING_STORAGE_BUFFERS;
use crate::gpu::{Buffer, Gpu, Memory, Suite, Timing};
use crate::render::frame::FrameOptions;
use crate::render::work_buffers::COUNTER_WORDS;
use crate::scene::Gaussians;
use crate::scene::parameter::{Present, SMOOTHING};
use std::collections::VecDeque;
use std::sync::Arc;

use flight::Job;
pub use flight::{FLIGHT, Finished};

/// Random stream of the noise on time.
const TIME_STREAM: u32 = 0x5449_4d45;
/// Tile instances that the first step has room for, per Gaussian.
const FIRST_INSTANCES_PER_GAUSSIAN: u64 = 4;
/// Room beyond what a step needed when the buffers grow.
const GROWTH_PERCENT: u64 = 130;
/// Where the parts of the readback begin, bytes.
const READBACK: [u64; 5] = [0, 256, 512, 768, 1024];
const READBACK_BYTES: u64 = 1280;

/// What is trained on.
#[derive(Debug, Clone)]
pub struct TrainingData {
    /// Posed photos.
    pub views: Arc<[View]>,
    /// Radius of the cameras, world units.
    pub extent: f64,
    /// Whether all photos have one time.
    pub is_static: bool,
}

/// What a step found.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize)]
pub struct StepReport {
    /// From 1.
    pub iteration: u64,
    /// Index of the photo.
    pub view: usize,
    /// Image loss + weighted property losses.
    pub loss: f64,
    /// Mean absolute error.
    pub l1: f64,
    /// Structural similarity.
    pub ssim: f64,
    /// PSNR of this view, dB; of the pixels that its mask does not leave out.
    pub psnr: f64,
    /// Property losses (unweighted): position, rotation, translation.
    pub property: [f64; 3],
    /// N.
    pub gaussians: u32,
    /// M; 0 before motion begins.
    pub superpoints: u32,
    /// Gaussians on screen.
    pub visible: u32,
    /// Tile instances.
    pub instances: u64,
    /// Gaussians refused by the forward pass.
    pub rejected: u32,
}

/// Of which steps the device's times are taken, operation by operation.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Profile {
    /// Of none.
    #[default]
    Off,
    /// Of those that are logged ([`LogConfig::logs`](super::config::LogConfig::logs)).
    Logged,
    /// Of all.
    All,
}

/// Buffers of a step in flight.
#[derive(Debug)]
pub(super) struct Slot {
    pub(super) step: Buffer,
    pub(super) readback: Buffer,
}

impl Slot {
    fn new(gpu: &Gpu) -> Result<Self> {
        let step = gpu.buffer("step", size_of::<Step>() as u64, Memory::Constants)?;
        Ok(Self { step, readback: gpu.buffer("step readback", READBACK_BYTES, Memory::Readback)? })
    }
}

/// Trains one scene.
#[derive(Debug)]
pub struct Trainer {
    pub(super) gpu: Gpu,
    pub(super) config: Config,
    pub(super) schedule: Schedule,
    /// Photos at all sizes.
    pub(super) pyramid: Pyramid,
    pub(super) loader: ImageLoader,
    pub(super) sampler: ViewSampler,
    /// Photos that beginnings are compared by.
    pub(super) aside: KeptAside,
    /// Photos that take part until it is open; `None` where all do from the start.
    pub(super) window: Option<TimeWindow>,
    pub(super) iteration: u64,
    pub(super) parameters: Parameters,
    /// What moves the Gaussians; `None` before motion begins, and where nothing moves.
    pub(super) deformation: Option<Trained>,
    pub(super) density_change: Option<DensityChange>,
    pub(super) targets: Vec<Target>,
    pub(super) capacity: u64,
    pub(super) photos: Photos,
    /// `None`: photos are taken as they are.
    pub(super) exposure: Option<ExposureState>,
    /// What is left out of photos; `None`: photos are believed.
    pub(super) transients: Option<Transients>,
    /// One per step that may be in flight.
    pub(super) slots: Vec<Slot>,
    /// Steps in flight, oldest first.
    pub(super) flying: VecDeque<Job>,
    pub(super) finished: VecDeque<Finished>,
    pub(super) status: Buffer,
    /// Reports of what runs beside the frame and its loss.
    pub(super) status_beside: Buffer,
    /// What the counters of a step begin with: zeros, and whether the step before it failed.
    pub(super) failed: Buffer,
    pub(super) splat_gradient: Buffer,
    pub(super) pose_gradient: Buffer,
    pub(super) profile: Profile,
    /// Of the last step that [`Trainer::step`] ran.
    timings: Vec<Timing>,
    repeated: u64,
    lost_object: Option<LostObject>,
    pub(super) transients_found: Option<TransientsFound>,
}

impl Trainer {
    /// Starts a run from first Gaussians.
    ///
    /// # Errors
    /// `Usage` for a bad configuration or no photos; `OutOfMemory`, `Limit`.
    pub fn new(gpu: &Gpu, config: &Config, data: &TrainingData, first: &Gaussians) -> Result<Self> {
        let stage = if data.is_static || !config.motion.enabled { Stage::Static } else { Stage::Rigid };
        let most = config.budget.max_gaussians as usize;
        let mut first = if first.len() > most { thinned(first, most) } else { first.clone() };
        let mut present = Present::of_names(&config.gaussians.optional)?;
        if config.gaussians.antialiased {
            present = present.with(SMOOTHING);
        }
        first.optional.add(present, first.mean.len());
        // Gaussians that were trained so already stay so, without another smoothing.
        first.antialiased |= config.gaussians.antialiased;
        let mut config = config.clone();
        config.gaussians.antialiased = first.antialiased;
        let state = ParameterState::new(&first, config.gaussians.sh_degree);
        Self::assemble(gpu, &config, data, stage, 0, &state)
    }

    fn assemble(
        gpu: &Gpu,
        config: &Config,
        data: &TrainingData,
        stage: Stage,
        iteration: u64,
        state: &ParameterState,
    ) -> Result<Self> {
        config.check()?;
        if data.views.is_empty() {
            return Err(Error::usage("training data", "no photos", "at least one"));
        }
        let have = gpu.info().capabilities.max_storage_buffers;
        if have < TRAINING_STORAGE_BUFFERS {
            let what = "storage buffers per shader stage, for training".to_owned();
            return Err(Error::Limit { what, need: TRAINING_STORAGE_BUFFERS.into(), have: have.into() });
        }
        if stage == Stage::Nonrigid {
            gpu.ready_for(Suite::Nonrigid)?;
        }
        if stage != Stage::Static && config.motion.is_soft() {
            gpu.ready_for(Suite::SoftTraining)?;
        }
        if config.budget.max_bytes > 0 {
            gpu.set_byte_budget(config.budget.max_bytes);
        }
        let workers = std::thread::available_parallelism().map_or(1, |n| n.get().min(8));
        let [status, status_beside] =
            ["status", "status_beside"].map(|name| gpu.buffer_with(name, bytemuck::cast_slice(&status::clear())));
        let failed = gpu.buffer_with("failed", bytemuck::cast_slice(&[0_u32; COUNTER_WORDS as usize]))?;
        let parameters = Parameters::upload(gpu, state)?;
        let n = u64::from(parameters.count().max(1));
        let times: Vec<f64> = data.views.iter().map(|v| v.time).collect();
        let schedule = Schedule::new(&config.scaled(), stage, data.extent);
        let aside = KeptAside::of(config, stage, times.len());
        let window = TimeWindow::new(&times, aside, config.schedule.time_window_centre, schedule.window());
        let pyramid = Pyramid::new(&data.views, schedule.coarse_to_fine(), |views| opaque_area(views, workers));
        let views = &pyramid.views;
        let with_exposure = config.learning_rate.exposure > 0.0;
        let exposure = || ExposureState::new(gpu, times.len(), &identities(times.len()), config.loss.lambda_exposure);
        Ok(Self {
            gpu: gpu.clone(),
            config: config.clone(),
            schedule,
            loader: ImageLoader::for_training(views.clone(), config.budget.image_bytes, workers)?,
            sampler: ViewSampler::new(config.seed, times.len()),
            aside,
            window,
            iteration,
            deformation: None,
            density_change: None,
            targets: Vec::new(),
            capacity: (n * FIRST_INSTANCES_PER_GAUSSIAN).max(4096),
            photos: Photos::new(gpu, views, config.budget.photo_bytes, FLIGHT)?,
            exposure: with_exposure.then(exposure).transpose()?,
            transients: (config.loss.transients > 0.0).then(|| Transients::none(times.len())),
            slots: (0..FLIGHT).map(|_| Slot::new(gpu)).collect::<Result<_>>()?,
            flying: VecDeque::new(),
            finished: VecDeque::new(),
            status: status?,
            status_beside: status_beside?,
            failed,
            splat_gradient: gpu.buffer("splat_gradient", n * u64::from(ROW_WORDS) * 4, Memory::Device)?,
            pose_gradient: gpu.buffer("pose_gradient", n * pose_gradient_bytes(config), Memory::Device)?,
            parameters,
            pyramid,
            profile: Profile::Off,
            timings: Vec::new(),
            repeated: 0,
            lost_object: None,
            transients_found: None,
        })
    }

    /// Of which steps device times are taken; set before the first step.
    #[must_use]
    pub fn with_profile(mut self, profile: Profile) -> Self {
        self.profile = profile;
        self
    }

    /// How many steps may be in flight, 1 to 8 ([`FLIGHT`] otherwise). What is trained does not depend on it ([`flight`]).
    ///
    /// # Errors
    /// `Usage` while steps are in flight; `OutOfMemory`.
    pub fn with_flight(mut self, steps: usize) -> Result<Self> {
        self.settled()?;
        let steps = steps.clamp(1, 8);
        self.photos = Photos::new(&self.gpu, &self.pyramid.views, self.config.budget.photo_bytes, steps)?;
        self.slots = (0..steps).map(|_| Slot::new(&self.gpu)).collect::<Result<_>>()?;
        self.targets.clear();
        Ok(self)
    }

    /// Whether device times are taken of the operations of this step.
    fn is_timed(&self, iteration: u64) -> bool {
        match self.profile {
            Profile::Off => false,
            Profile::Logged => self.config.log.logs(iteration),
            Profile::All => true,
        }
    }

    /// The configuration, as given.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The schedule.
    pub fn schedule(&self) -> &Schedule {
        &self.schedule
    }

    /// Iterations done, or submitted while steps are in flight.
    pub fn iteration(&self) -> u64 {
        self.iteration
    }

    /// Whether all iterations are done, or submitted while steps are in flight.
    pub fn is_done(&self) -> bool {
        self.iteration >= self.schedule.iterations()
    }

    /// N.
    pub fn gaussians(&self) -> u32 {
        self.parameters.count()
    }

    /// M; 0 before motion begins.
    fn superpoints(&self) -> u32 {
        self.parameters.scene.deformation.superpoints
    }

    /// Shape of the association, once motion has begun.
    pub(super) fn association(&self) -> Option<&AssociationOptions> {
        self.deformation.as_ref()?.association()
    }

    /// One iteration, waited for: [`Trainer::advance`] and [`Trainer::drain`].
    ///
    /// # Errors
    /// `NonFinite` naming group, index and iteration when a number went bad (nothing bad was applied); errors of the
    /// photo; `Limit` or `OutOfMemory` when the view does not fit; `DeviceLost`.
    pub fn step(&mut self) -> Result<StepReport> {
        self.advance()?;
        self.last_report()
    }

    /// [`Trainer::step`] on this view and photo.
    pub(crate) fn step_on(&mut self, view: usize, photo: &Pixels) -> Result<StepReport> {
        self.advance_on(view, Some(photo))?;
        self.last_report()
    }

    /// The report of the last submitted step.
    fn last_report(&mut self) -> Result<StepReport> {
        self.drain()?;
        let last = self.finished.drain(..).next_back();
        let Finished { report, timings, density } = last.ok_or_else(|| Error::usage("a step", "no report", "one"))?;
        self.timings = timings;
        self.density_change = density.or(self.density_change.take());
        Ok(report)
    }

    /// Starts the model of motion from the Gaussians as they are.
    fn begin_motion(&mut self) -> Result<()> {
        if self.parameters.count() == 0 {
            return Ok(());
        }
        let lost = if self.config.motion.lost_objects { self.find_lost_object()? } else { None };
        let (found, path) = lost.unzip();
        let model = deformation::begin(&self.gpu, &self.config, &self.parameters.scene, path)?;
        self.lost_object = found;
        self.set_deformation(model);
        Ok(())
    }

    fn set_deformation(&mut self, model: Trained) {
        model.attach(&mut self.parameters.scene.deformation);
        self.deformation = Some(model);
        self.targets.iter_mut().for_each(|t| t.forget_commands());
    }

    fn frame_options(&self, view: usize, at: usize) -> FrameOptions {
        FrameOptions {
            background: self.config.background,
            near: self.config.near,
            time: self.pyramid.views[view].time,
            gaussians: self.parameters.count(),
            superpoints: self.superpoints(),
            sh_degree: self.parameters.scene.sh_degree,
            instance_capacity: self.targets[at].capacity,
            ..FrameOptions::default()
        }
    }

    /// What the step is, as the kernels see it; `photo`: the first word of its photo.
    fn step_of(&self, iteration: u64, view: usize, photo: u32) -> Step {
        let slots = self.association().map_or(0, |a| a.slots);
        let (gaussians, superpoints) = (self.parameters.count(), self.superpoints());
        let time = self.pyramid.views[view].time;
        // Annealed smooth training of Deformable 3D Gaussians, as the released code has it: relative to the photos left.
        let spacing = 1.0 / self.sampler.remaining(iteration) as f64;
        let noise =
            self.schedule.time_noise(iteration, spacing) * rng::normal(self.config.seed, TIME_STREAM, iteration);
        let counts = Counts { gaussians, superpoints, slots };
        let exposure = self.pyramid.photo(view) as u32;
        let mut step = Step { photo, exposure, ..self.schedule.step(iteration, counts, [time + noise, time]) };
        // Measured over an epoch: every photo, at its time.
        step.rate[SMOOTHING] = f32::from(u8::from(self.sampler.remaining(iteration) == 1));
        step
    }

    /// The index of the target for an image size, made if need be.
    fn target(&mut self, image: [u32; 2]) -> Result<usize> {
        let capacity = self.capacity.min(u64::from(u32::MAX)) as u32;
        if let Some(at) = self.targets.iter().position(|t| t.size == image && t.capacity >= capacity) {
            return Ok(at);
        }
        self.targets.retain(|t| t.size != image);
        let size = TargetSize {
            image,
            gaussians: self.parameters.count(),
            capacity,
            with_slots: self.with_slots(),
            with_ssim: self.config.loss.lambda_dssim > 0.0,
            with_exposure: self.exposure.is_some(),
            steps: self.flight(),
        };
        self.targets.push(Target::new(&self.gpu, size, &self.failed)?);
        Ok(self.targets.len() - 1)
    }

    /// Whether gradients are added without atomics: where bits must repeat, and where that is fastest anyway.
    fn with_slots(&self) -> bool {
        Accumulation::of_device(&self.gpu, self.config.deterministic) == Accumulation::Instances
    }

    /// The next step begins as if none had failed before it.
    fn clear_failure(&self) -> Result<()> {
        self.gpu.upload(&self.failed, bytemuck::cast_slice(&[0_u32; COUNTER_WORDS as usize]))
    }

    /// Makes room for a step that failed, which with those behind it has finished.
    fn grow(&mut self, instances: u64) -> Result<()> {
        // The steps in flight have finished: what they left of the failure goes, and what their sums over gradients that
        // were never written may have reported; nothing of them was applied.
        self.clear_failure()?;
        for status in [&self.status, &self.status_beside] {
            self.gpu.upload(status, bytemuck::cast_slice(&status::clear()))?;
        }
        let wanted = instances.saturating_mul(GROWTH_PERCENT) / 100;
        let limit = u64::from(u32::MAX) / u64::from(ROW_WORDS) / 4;
        if instances > limit {
            let what = format!("tile instances of one view with {} Gaussians", self.parameters.count());
            return Err(Error::Limit { what, need: instances.into(), have: limit.into() });
        }
        self.capacity = wanted.clamp(self.capacity + 1, limit);
        Ok(())
    }

    /// Device time of each operation of the last [`Trainer::step`], in order; empty where none were taken.
    pub fn timings(&self) -> &[Timing] {
        &self.timings
    }

    /// The object that was found lost when motion began, unless it was taken already.
    pub fn take_lost_object(&mut self) -> Option<LostObject> {
        self.lost_object.take()
    }

    /// What was found when photos were last looked at for transients, unless it was taken already.
    pub fn take_transients_found(&mut self) -> Option<TransientsFound> {
        self.transients_found.take()
    }

    /// What density control did after the last [`Trainer::step`], unless it was taken already.
    pub fn take_density_change(&mut self) -> Option<DensityChange> {
        self.density_change.take()
    }
}

/// Bytes of `pose_gradient` per Gaussian.
pub(super) fn pose_gradient_bytes(config: &Config) -> u64 {
    let slots = if config.motion.is_soft() { u64::from(config.motion.blend) } else { 0 };
    (slots * u64::from(SLOT_PLANES) * 4).max(24)
}

/// `most` Gaussians, evenly spread over the list.
fn thinned(g: &Gaussians, most: usize) -> Gaussians {
    g.selected(&(0..most).map(|i| i * g.len() / most).collect::<Vec<_>>())
}
