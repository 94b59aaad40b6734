//! [`Trainer`]: state and the one step that reads like the paper's algorithm.

mod record;
mod restore;

use super::association::AssociationOptions;
use super::blend_backward::{Accumulation, ROW_WORDS};
use super::config::Config;
use super::deform_project_backward::SLOT_PLANES;
use super::deformation::{self, Trained};
use super::density::DensityChange;
use super::parameters::{ParameterState, Parameters};
use super::rng;
use super::sampler::ViewSampler;
use super::schedule::{Counts, Schedule, Stage};
use super::status;
use super::step::Step;
use super::target::{RecordingKey, Target, TargetSize};
use crate::data::dataset::View;
use crate::data::loader::ImageLoader;
use crate::data::pixels::Pixels;
use crate::error::{Error, Result};
use crate::gpu::capability::TRAINING_STORAGE_BUFFERS;
use crate::gpu::{Buffer, Gpu, Memory, Suite, Timing};
use crate::render::frame::{Frame, FrameOptions};
use crate::render::limits::{COUNT_FAILED, COUNT_INSTANCES_HIGH, COUNT_INSTANCES_LOW, COUNT_REJECTED, COUNT_VISIBLE};
use crate::scene::Gaussians;
use crate::scene::parameter::Present;
use std::sync::Arc;

/// Random stream of the noise on time.
const TIME_STREAM: u32 = 0x5449_4d45;
/// Photos announced ahead of their use.
const PREFETCH: u64 = 8;
/// Tile instances that the first step has room for, per Gaussian.
const FIRST_INSTANCES_PER_GAUSSIAN: u64 = 4;
/// Room beyond what a step needed when the buffers grow.
const GROWTH_PERCENT: u64 = 130;
/// Where the parts of the readback begin, bytes.
const READBACK: [u64; 4] = [0, 256, 512, 768];
const READBACK_BYTES: u64 = 1024;

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
    /// PSNR of this view, dB.
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

/// Trains one scene.
#[derive(Debug)]
pub struct Trainer {
    pub(super) gpu: Gpu,
    pub(super) config: Config,
    pub(super) schedule: Schedule,
    pub(super) views: Arc<[View]>,
    pub(super) loader: ImageLoader,
    pub(super) sampler: ViewSampler,
    pub(super) iteration: u64,
    pub(super) parameters: Parameters,
    /// What moves the Gaussians; `None` before motion begins, and where nothing moves.
    pub(super) deformation: Option<Trained>,
    pub(super) density_change: Option<DensityChange>,
    pub(super) targets: Vec<Target>,
    pub(super) capacity: u64,
    pub(super) step: Buffer,
    pub(super) status: Buffer,
    pub(super) readback: Buffer,
    pub(super) splat_gradient: Buffer,
    pub(super) pose_gradient: Buffer,
    /// Whether device times are taken of every operation.
    pub(super) profile: bool,
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
        first.optional.add(Present::of_names(&config.gaussians.optional)?, first.mean.len());
        let state = ParameterState::new(&first, config.gaussians.sh_degree);
        Self::assemble(gpu, config, data, stage, 0, &state)
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
        if config.budget.max_bytes > 0 {
            gpu.set_byte_budget(config.budget.max_bytes);
        }
        let workers = std::thread::available_parallelism().map_or(1, |n| n.get().min(8));
        let status = gpu.buffer("status", status::STATUS_WORDS as u64 * 4, Memory::Device)?;
        gpu.upload(&status, bytemuck::cast_slice(&status::clear()))?;
        let parameters = Parameters::upload(gpu, state)?;
        let n = u64::from(parameters.count().max(1));
        let times: Vec<f64> = data.views.iter().map(|v| v.time).collect();
        let at = &config.scaled().schedule;
        let window = if stage == Stage::Rigid { at.time_window } else { 0 };
        let sampler = ViewSampler::new(config.seed, times.len()).with_window(&times, at.time_window_centre, window);
        Ok(Self {
            gpu: gpu.clone(),
            config: config.clone(),
            schedule: Schedule::new(&config.scaled(), stage, data.extent),
            views: data.views.clone(),
            loader: ImageLoader::new(data.views.clone(), config.budget.image_bytes, workers)?,
            sampler,
            iteration,
            deformation: None,
            density_change: None,
            targets: Vec::new(),
            capacity: (n * FIRST_INSTANCES_PER_GAUSSIAN).max(4096),
            step: gpu.buffer("step", size_of::<Step>() as u64, Memory::Constants)?,
            status,
            readback: gpu.buffer("step readback", READBACK_BYTES, Memory::Readback)?,
            splat_gradient: gpu.buffer("splat_gradient", n * u64::from(ROW_WORDS) * 4, Memory::Device)?,
            pose_gradient: gpu.buffer("pose_gradient", n * pose_gradient_bytes(config), Memory::Device)?,
            parameters,
            profile: false,
        })
    }

    /// Whether device times are taken of every operation.
    #[must_use]
    pub fn with_profile(mut self, profile: bool) -> Self {
        self.profile = profile;
        self
    }

    /// The configuration, as given.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The schedule.
    pub fn schedule(&self) -> &Schedule {
        &self.schedule
    }

    /// Iterations done.
    pub fn iteration(&self) -> u64 {
        self.iteration
    }

    /// Whether all iterations are done.
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

    /// One iteration: pick a photo, move, render, compare, go back, update, adapt the density.
    ///
    /// # Errors
    /// `NonFinite` naming group, index and iteration when a number went bad (nothing bad was applied); errors of the
    /// photo; `Limit` or `OutOfMemory` when the view does not fit; `DeviceLost`.
    pub fn step(&mut self) -> Result<StepReport> {
        let iteration = self.iteration + 1;
        let view = self.sampler.view(iteration);
        let ahead: Vec<usize> = (0..PREFETCH).map(|k| self.sampler.view(iteration + k)).collect();
        self.loader.prefetch(&ahead);
        let photo = self.loader.get(view)?;
        self.step_on(view, &photo)
    }

    /// [`Trainer::step`] on this view and photo.
    pub(crate) fn step_on(&mut self, view: usize, photo: &Pixels) -> Result<StepReport> {
        let iteration = self.iteration + 1;
        if self.schedule.superpoints_begin(iteration) {
            self.begin_motion()?;
        }
        let report = self.run(iteration, view, photo)?;
        self.iteration = iteration;
        self.adapt_density(iteration)?;
        if self.config.log.finite_interval > 0 && iteration.is_multiple_of(self.config.log.finite_interval) {
            self.check_numbers()?;
        }
        Ok(report)
    }

    /// Starts the model of motion from the Gaussians as they are.
    fn begin_motion(&mut self) -> Result<()> {
        if self.parameters.count() == 0 {
            return Ok(());
        }
        let model = deformation::begin(&self.gpu, &self.config, &self.parameters.scene)?;
        self.set_deformation(model);
        Ok(())
    }

    fn set_deformation(&mut self, model: Trained) {
        model.attach(&mut self.parameters.scene.deformation);
        self.deformation = Some(model);
        self.targets.iter_mut().for_each(|t| t.commands = None);
    }

    /// Runs the step on the device, with larger buffers until the view fits.
    fn run(&mut self, iteration: u64, view: usize, photo: &Pixels) -> Result<StepReport> {
        self.parameters.scene.sh_degree = self.schedule.sh_degree(iteration).min(self.parameters.sh_degree);
        let camera = self.views[view].camera.clone();
        if [photo.width, photo.height] != [camera.width, camera.height] {
            let found = format!("{}×{} pixels", photo.width, photo.height);
            return Err(Error::usage(format!("photo of {}", self.views[view].name), found, "the camera's size"));
        }
        loop {
            let at = self.target([camera.width, camera.height])?;
            let frame = Frame::new(&camera, self.parameters.scene.origin, &self.frame_options(view, at))?;
            self.write_step(iteration, view)?;
            let key = RecordingKey { sh_degree: self.parameters.scene.sh_degree, moves: self.deformation.is_some() };
            let target = &self.targets[at];
            target.frame.frame.write(0, bytemuck::bytes_of(&frame))?;
            target.upload.write(0, bytemuck::cast_slice(&photo.rgba))?;
            if target.commands.as_ref().is_none_or(|(k, _)| *k != key) {
                let commands = self.record(at)?;
                self.targets[at].commands = Some((key, commands));
            }
            if let Some((_, commands)) = &mut self.targets[at].commands {
                self.gpu.submit(commands)?;
                self.gpu.wait_for(commands)?;
            }
            if let Some(report) = self.read_back(iteration, view)? {
                return Ok(report);
            }
        }
    }

    fn frame_options(&self, view: usize, at: usize) -> FrameOptions {
        FrameOptions {
            background: self.config.background,
            near: self.config.near,
            time: self.views[view].time,
            gaussians: self.parameters.count(),
            superpoints: self.superpoints(),
            sh_degree: self.parameters.scene.sh_degree,
            instance_capacity: self.targets[at].capacity,
            ..FrameOptions::default()
        }
    }

    fn write_step(&self, iteration: u64, view: usize) -> Result<()> {
        let slots = self.association().map_or(0, |a| a.slots);
        let (gaussians, superpoints) = (self.parameters.count(), self.superpoints());
        let time = self.views[view].time;
        // Annealed smooth training of Deformable 3D Gaussians, as the released code has it: relative to the photos left.
        let spacing = 1.0 / self.sampler.remaining(iteration) as f64;
        let noise =
            self.schedule.time_noise(iteration, spacing) * rng::normal(self.config.seed, TIME_STREAM, iteration);
        let step = self.schedule.step(iteration, Counts { gaussians, superpoints, slots }, [time + noise, time]);
        self.step.write(0, bytemuck::bytes_of(&step))
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
        };
        self.targets.push(Target::new(&self.gpu, size)?);
        Ok(self.targets.len() - 1)
    }

    /// Whether gradients are added without atomics: where bits must repeat, and where that is fastest anyway.
    fn with_slots(&self) -> bool {
        Accumulation::of_device(&self.gpu, self.config.deterministic) == Accumulation::Instances
    }

    /// What the step left. `None`: the view needed more tile instances; nothing was changed, the buffers are larger now.
    fn read_back(&mut self, iteration: u64, view: usize) -> Result<Option<StepReport>> {
        let mut bytes = vec![0; READBACK_BYTES as usize];
        self.readback.read(0, &mut bytes)?;
        let words: Vec<u32> = bytemuck::pod_collect_to_vec(&bytes);
        let word = |part: usize, i: u32| words[(READBACK[part] / 4) as usize + i as usize];
        let float = |part: usize, i: u32| f64::from(f32::from_bits(word(part, i)));
        let instances = u64::from(word(0, COUNT_INSTANCES_HIGH)) << 32 | u64::from(word(0, COUNT_INSTANCES_LOW));
        if word(0, COUNT_FAILED) != 0 {
            self.grow(instances)?;
            return Ok(None);
        }
        let first = (READBACK[3] / 4) as usize;
        if let Some((group, count, index)) = status::first(&words[first..first + status::STATUS_WORDS]) {
            let what = format!("{group} at iteration {iteration} ({count} not finite), first");
            return Err(Error::NonFinite { what, index: index as usize, value: "not finite".into() });
        }
        let c = &self.config.loss;
        let has_property = self.deformation.as_ref().is_some_and(|m| m.property_loss().is_some());
        let property = if has_property { [0, 1, 2].map(|i| float(2, i)) } else { [0.0; 3] };
        let weights = [c.lambda_position, c.lambda_rotation, c.lambda_translation].map(f64::from);
        Ok(Some(StepReport {
            iteration,
            view,
            loss: float(1, 0) + property.iter().zip(weights).map(|(p, w)| p * w).sum::<f64>(),
            l1: float(1, 1),
            ssim: float(1, 2),
            psnr: -10.0 * float(1, 3).max(1e-30).log10(),
            property,
            gaussians: self.parameters.count(),
            superpoints: self.superpoints(),
            visible: word(0, COUNT_VISIBLE),
            instances,
            rejected: word(0, COUNT_REJECTED),
        }))
    }

    fn grow(&mut self, instances: u64) -> Result<()> {
        let wanted = instances.saturating_mul(GROWTH_PERCENT) / 100;
        let limit = u64::from(u32::MAX) / u64::from(ROW_WORDS) / 4;
        if instances > limit {
            let what = format!("tile instances of one view with {} Gaussians", self.parameters.count());
            return Err(Error::Limit { what, need: instances.into(), have: limit.into() });
        }
        self.capacity = wanted.clamp(self.capacity + 1, limit);
        // Sums over gradients that the failed step never wrote may have been reported; nothing of them was applied.
        self.gpu.upload(&self.status, bytemuck::cast_slice(&status::clear()))
    }

    /// Device time of each operation of the last step, in order; empty without timestamps.
    ///
    /// # Errors
    /// `Vulkan` when the device cannot say.
    pub fn timings(&self) -> Result<Vec<Timing>> {
        match self.commands() {
            Some(commands) if self.profile => commands.timings(),
            _ => Ok(Vec::new()),
        }
    }

    /// What density control did since the last call.
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
