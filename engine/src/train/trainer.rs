//! [`Trainer`]: state and the one step that reads like the paper's algorithm.

use std::sync::Arc;

use super::adapt::DensityChange;
use super::association::{AssociationInit, AssociationOptions, StepBuffers, SuperpointState};
use super::blend_backward::{self, Accumulation, BackwardInput, BackwardTarget, ROW_WORDS};
use super::checkpoint::{Checkpoint, MotionState, NetworkState};
use super::config::{Config, Form};
use super::deform_project_backward::{DEFORM_PROJECT_BACKWARD, DEFORM_PROJECT_BACKWARD_THREADS, OUTPUT_ADAM};
use super::image_loss::{ImageLossBuffers, LOSS_WORDS, TargetFormat};
use super::linear::Output;
use super::network_f::{Backward, NetworkF};
use super::network_g::{self, NetworkG};
use super::parameters::{ParameterState, Parameters};
use super::property_loss::PropertyLoss;
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
use crate::gpu::{Buffer, Commands, Gpu, Groups, Memory, Recorder, Slice, Timing};
use crate::render::frame::{Frame, FrameOptions};
use crate::render::limits::{COUNT_FAILED, COUNT_INSTANCES_HIGH, COUNT_INSTANCES_LOW, COUNT_REJECTED, COUNT_VISIBLE};
use crate::render::pipeline::record_forward;
use crate::render::scene_buffers::Poses;
use crate::scene::{DeformNetwork, Gaussians, Motion, NonrigidNetwork, Scene};

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

/// Superpoints, association, network F.
#[derive(Debug)]
pub(super) struct Moving {
    pub(super) superpoints: SuperpointState,
    pub(super) network: NetworkF,
    pub(super) pose: Buffer,
}

/// Network G with what it gives and gets.
#[derive(Debug)]
pub(super) struct Nonrigid {
    pub(super) network: NetworkG,
    pub(super) offset: Buffer,
    pub(super) gradient: Buffer,
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
    pub(super) moving: Option<Moving>,
    pub(super) nonrigid: Option<Nonrigid>,
    pub(super) density_change: Option<DensityChange>,
    pub(super) targets: Vec<Target>,
    pub(super) capacity: u64,
    pub(super) step: Buffer,
    pub(super) status: Buffer,
    pub(super) readback: Buffer,
    pub(super) splat_gradient: Buffer,
    pub(super) pose_gradient: Buffer,
    /// Stand for buffers that a kernel declares but does not use as specialised.
    pub(super) unused: [Buffer; 3],
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
        let first = if first.len() > most { thinned(first, most) } else { first.clone() };
        let state = ParameterState::new(&first, config.gaussians.sh_degree);
        Self::assemble(gpu, config, data, stage, 0, &state)
    }

    /// Goes on from a checkpoint.
    ///
    /// # Errors
    /// As [`Trainer::new`].
    pub fn resume(gpu: &Gpu, data: &TrainingData, checkpoint: &Checkpoint) -> Result<Self> {
        let c = checkpoint;
        let mut trainer = Self::assemble(gpu, &c.config, data, c.stage, c.iteration, &c.parameters)?;
        trainer.restore_motion(c)?;
        if let Some(g) = &c.nonrigid {
            trainer.set_nonrigid(&g.nonrigid()?)?;
            if let Some(own) = &trainer.nonrigid {
                own.network.upload_moments([&g.moment_1, &g.moment_2])?;
            }
        }
        Ok(trainer)
    }

    /// Begins the non-rigid stage on a trained model: all Gaussians and network G are trained, network F and the association
    /// are not. Moments start at zero.
    ///
    /// # Errors
    /// As [`Trainer::new`].
    pub fn nonrigid(gpu: &Gpu, config: &Config, data: &TrainingData, trained: &Checkpoint) -> Result<Self> {
        let state = ParameterState {
            superpoint_of_gaussian: trained.parameters.superpoint_of_gaussian.clone(),
            ..ParameterState::new(&trained.parameters.gaussians, trained.parameters.gaussians.sh_degree)
        };
        let mut trainer = Self::assemble(gpu, config, data, Stage::Nonrigid, 0, &state)?;
        trainer.restore_motion(trained)?;
        trainer.set_nonrigid(&NonrigidNetwork::init(config.seed))?;
        Ok(trainer)
    }

    fn set_nonrigid(&mut self, network: &NonrigidNetwork) -> Result<()> {
        let n = self.parameters.count().max(1);
        let buffer = |name: &str| self.gpu.buffer(name, u64::from(n) * 40, Memory::Device);
        let (offset, gradient) = (buffer("nonrigid_offset")?, buffer("nonrigid_gradient")?);
        self.nonrigid = Some(Nonrigid { network: NetworkG::new(&self.gpu, network, n)?, offset, gradient });
        Ok(())
    }

    fn restore_motion(&mut self, checkpoint: &Checkpoint) -> Result<()> {
        let gpu = self.gpu.clone();
        if let Some(m) = &checkpoint.motion {
            let [first, second] = &m.association_moments;
            let options = self.association_options();
            let superpoints = SuperpointState::from_parts(&gpu, &m.position, &m.association, [first, second], options)?;
            let network = NetworkF::new(&gpu, &m.network.deform()?, m.position.len() as u32)?;
            network.upload_moments([&m.network.moment_1, &m.network.moment_2])?;
            self.set_motion(superpoints, network)?;
        }
        Ok(())
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
        if config.budget.max_bytes > 0 {
            gpu.set_byte_budget(config.budget.max_bytes);
        }
        let workers = std::thread::available_parallelism().map_or(1, |n| n.get().min(8));
        let status = gpu.buffer("status", status::STATUS_WORDS as u64 * 4, Memory::Device)?;
        gpu.upload(&status, bytemuck::cast_slice(&status::clear()))?;
        let parameters = Parameters::upload(gpu, state)?;
        let n = u64::from(parameters.count().max(1));
        let unused = |name: &str| gpu.buffer(name, 512, Memory::Device);
        Ok(Self {
            gpu: gpu.clone(),
            config: config.clone(),
            schedule: Schedule::new(&config.scaled(), stage, data.extent),
            views: data.views.clone(),
            loader: ImageLoader::new(data.views.clone(), config.budget.image_bytes, workers)?,
            sampler: ViewSampler::new(config.seed, data.views.len()),
            iteration,
            moving: None,
            nonrigid: None,
            density_change: None,
            targets: Vec::new(),
            capacity: (n * FIRST_INSTANCES_PER_GAUSSIAN).max(4096),
            step: gpu.buffer("step", size_of::<Step>() as u64, Memory::Upload)?,
            status,
            readback: gpu.buffer("step readback", READBACK_BYTES, Memory::Readback)?,
            splat_gradient: gpu.buffer("splat_gradient", n * u64::from(ROW_WORDS) * 4, Memory::Device)?,
            pose_gradient: gpu.buffer("pose_gradient", n * 24, Memory::Device)?,
            unused: [unused("gradient")?, unused("nonrigid_offset")?, unused("nonrigid_gradient")?],
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

    /// One iteration: pick a photo, move, render, compare, go back, update, adapt the density.
    ///
    /// # Errors
    /// `NonFinite` naming group, index and iteration when a number went bad (nothing bad was applied); errors of the
    /// photo; `Limit` or `OutOfMemory` when the view does not fit; `DeviceLost`.
    pub fn step(&mut self) -> Result<StepReport> {
        let iteration = self.iteration + 1;
        if self.schedule.superpoints_begin(iteration) {
            self.begin_motion()?;
        }
        let view = self.sampler.view(iteration);
        let ahead: Vec<usize> = (0..PREFETCH).map(|k| self.sampler.view(iteration + k)).collect();
        self.loader.prefetch(&ahead);
        let photo = self.loader.get(view)?;
        let report = self.run(iteration, view, &photo)?;
        self.iteration = iteration;
        self.adapt_density(iteration)?;
        if self.config.log.finite_interval > 0 && iteration.is_multiple_of(self.config.log.finite_interval) {
            self.check_numbers()?;
        }
        Ok(report)
    }

    /// Samples superpoints from the Gaussians as they are and starts network F.
    fn begin_motion(&mut self) -> Result<()> {
        if self.parameters.count() == 0 {
            return Ok(());
        }
        let s = &self.parameters.scene;
        let options = self.association_options();
        let superpoints = SuperpointState::init(
            &self.gpu,
            &Slice::from(&s.mean),
            &Slice::from(&s.superpoint_of_gaussian),
            self.parameters.count(),
            options,
        )?;
        let weights = DeformNetwork::init(self.config.seed, self.config.motion.zero_heads);
        let network = NetworkF::new(&self.gpu, &weights, superpoints.superpoints())?;
        self.set_motion(superpoints, network)
    }

    fn association_options(&self) -> AssociationOptions {
        let m = &self.config.motion;
        AssociationOptions {
            superpoints: m.superpoints,
            neighbors: m.neighbors,
            slots: m.association_slots,
            init: match m.association_init {
                Form::Code => AssociationInit::Code,
                Form::Paper => AssociationInit::Paper,
            },
            property_loss: match self.config.loss.prop_loss {
                Form::Code => PropertyLoss::Code,
                Form::Paper => PropertyLoss::Paper,
            },
            seed: self.config.seed,
        }
    }

    fn set_motion(&mut self, superpoints: SuperpointState, network: NetworkF) -> Result<()> {
        let m = superpoints.superpoints();
        let pose = self.gpu.buffer("pose", u64::from(m) * 32, Memory::Device)?;
        let scene = &mut self.parameters.scene;
        scene.superpoints = m;
        scene.poses = Poses::Given;
        scene.pose = pose.clone();
        self.moving = Some(Moving { superpoints, network, pose });
        self.targets.iter_mut().for_each(|t| t.commands = None);
        Ok(())
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
            let key = RecordingKey { sh_degree: self.parameters.scene.sh_degree, moves: self.moving.is_some() };
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
            superpoints: self.parameters.scene.superpoints,
            sh_degree: self.parameters.scene.sh_degree,
            instance_capacity: self.targets[at].capacity,
            ..FrameOptions::default()
        }
    }

    fn write_step(&self, iteration: u64, view: usize) -> Result<()> {
        let slots = self.moving.as_ref().map_or(0, |m| m.superpoints.options().slots);
        let (gaussians, superpoints) = (self.parameters.count(), self.parameters.scene.superpoints);
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

    /// Records a step for a target: the order of the paper's algorithm.
    fn record(&self, at: usize) -> Result<Commands> {
        let t = &self.targets[at];
        let mut r = self.gpu.recorder("train step").with_timestamps(self.profile);
        r.copy(&t.upload, &t.photo)?;
        if let Some(m) = &self.moving {
            let (step, position) = (Slice::from(&self.step), Slice::from(&m.superpoints.position));
            m.network.record_forward(&mut r, m.superpoints.superpoints(), &step, &position, &Slice::from(&m.pose))?;
        }
        let mut shape = t.shape.clone();
        if let Some(g) = &self.nonrigid {
            let offset = Slice::from(&g.offset);
            g.network.record_forward(&mut r, self.parameters.count(), &self.nonrigid_inputs(t).borrow(), &offset)?;
            shape.nonrigid_offset = Some(offset);
        }
        record_forward(&self.gpu, &mut r, &self.parameters.scene, &t.work, &t.frame, &shape)?;
        let shared = self.step_buffers(t);
        // In the non-rigid stage network F and the association are frozen.
        let learning = self.moving.as_ref().filter(|_| self.nonrigid.is_none());
        if let Some(m) = learning {
            m.superpoints.record_before(&mut r, &shared)?;
        }
        let loss = ImageLossBuffers {
            frame: &t.frame.frame,
            step: &self.step,
            color: &t.frame.color,
            target: &t.photo,
            image_gradient: &t.image_gradient,
            loss: &t.loss,
            status: &self.status,
        };
        t.image_loss.record(&mut r, &loss, TargetFormat::Rgba8)?;
        self.record_blend_backward(&mut r, t)?;
        self.record_project_backward(&mut r, t)?;
        if let Some(m) = learning {
            m.superpoints.record_reduce_pose(&mut r, &shared, &Slice::from(&self.pose_gradient))?;
            let backward = Backward {
                step: &shared.step,
                counters: &shared.counters,
                status: &shared.status,
                superpoint_gradient: &Slice::from(&m.superpoints.gradient),
                plane_stride: m.superpoints.superpoints(),
            };
            m.network.record_backward(&mut r, m.superpoints.superpoints(), Output::Adam, &backward)?;
            m.superpoints.record_commit(&mut r, &shared)?;
        }
        if let Some(g) = &self.nonrigid {
            let backward = network_g::Backward {
                step: &shared.step,
                counters: &shared.counters,
                status: &shared.status,
                nonrigid_gradient: &Slice::from(&g.gradient),
            };
            let inputs = self.nonrigid_inputs(t);
            g.network.record_backward(&mut r, self.parameters.count(), Output::Adam, &inputs.borrow(), &backward)?;
        }
        self.record_readback(&mut r, t)?;
        r.finish()
    }

    fn nonrigid_inputs(&self, t: &Target) -> NonrigidInputs {
        let s = &self.parameters.scene;
        NonrigidInputs {
            frame: Slice::from(&t.frame.frame),
            mean: Slice::from(&s.mean),
            superpoint_of_gaussian: Slice::from(&s.superpoint_of_gaussian),
            pose: Slice::from(&s.pose),
            moving: s.moves(),
        }
    }

    fn step_buffers(&self, t: &Target) -> StepBuffers {
        let s = &self.parameters.scene;
        StepBuffers {
            step: Slice::from(&self.step),
            counters: t.work.counters.clone(),
            status: Slice::from(&self.status),
            mean: Slice::from(&s.mean),
            superpoint_of_gaussian: Slice::from(&s.superpoint_of_gaussian),
            pose: Slice::from(&s.pose),
        }
    }

    fn record_blend_backward(&self, r: &mut Recorder, t: &Target) -> Result<()> {
        let input = BackwardInput {
            frame: Slice::from(&t.frame.frame),
            counters: t.work.counters.clone(),
            ranges: t.work.ranges.clone(),
            values: Slice::from(t.work.tile_values()),
            tile_count: Slice::from(&t.work.tile_count),
            splats: Slice::from(&t.work.splats),
            color: Slice::from(&t.frame.color),
            image_gradient: Slice::from(&t.image_gradient),
            gaussians: self.parameters.count(),
            tiles: t.shape.tiles,
        };
        let target = match (&t.shape.slots, &t.instance_gradient) {
            (Some(slots), Some(rows)) => BackwardTarget::Instances(slots.clone(), Slice::from(rows)),
            _ if self.gpu.info().capabilities.float_atomics => BackwardTarget::NativeAtomics,
            _ => BackwardTarget::CompareAndSwap,
        };
        blend_backward::record(&self.gpu, r, &input, &target, &Slice::from(&self.splat_gradient))
    }

    fn record_project_backward(&self, r: &mut Recorder, t: &Target) -> Result<()> {
        let (p, s) = (&self.parameters, &self.parameters.scene);
        let slice = |b: &Buffer| Slice::from(b);
        let [sh_0, sh_1, sh_2, sh_3] = &s.sh;
        // The paper's form of the property losses pulls at the centres too.
        let learning = self.moving.as_ref().filter(|_| self.nonrigid.is_none());
        let mean_gradient = learning.and_then(|m| m.superpoints.mean_gradient());
        let buffers = [
            slice(&t.frame.frame),
            slice(&self.step),
            t.work.counters.clone(),
            slice(&self.status),
            slice(&t.work.splats),
            slice(&t.work.tile_count),
            slice(&self.splat_gradient),
            slice(&s.mean),
            slice(&s.log_scale),
            slice(&s.rotation),
            slice(&s.opacity_logit),
            slice(&s.superpoint_of_gaussian),
            slice(&s.pose),
            slice(sh_0),
            slice(sh_1),
            slice(sh_2),
            slice(sh_3),
            slice(&p.moment_1),
            slice(&p.moment_2),
            slice(&self.unused[0]),
            slice(&self.pose_gradient),
            slice(self.nonrigid.as_ref().map_or(&self.unused[1], |g| &g.offset)),
            slice(self.nonrigid.as_ref().map_or(&self.unused[2], |g| &g.gradient)),
            slice(&p.density),
            slice(&p.max_radius),
            slice(mean_gradient.unwrap_or(&self.unused[1])),
        ];
        let spec = [
            s.sh_degree,
            u32::from(s.moves()),
            u32::from(self.nonrigid.is_some()),
            OUTPUT_ADAM,
            u32::from(mean_gradient.is_some()),
        ];
        let groups = u64::from(p.count().div_ceil(DEFORM_PROJECT_BACKWARD_THREADS).max(1));
        r.dispatch(&DEFORM_PROJECT_BACKWARD, &spec, &[], &buffers, Groups::Direct(groups))
    }

    fn record_readback(&self, r: &mut Recorder, t: &Target) -> Result<()> {
        let [counters, loss, property, status] = READBACK;
        r.copy(t.work.counters.clone(), self.readback.slice(counters, t.work.counters.bytes))?;
        r.copy(&t.loss, self.readback.slice(loss, LOSS_WORDS as u64 * 4))?;
        if let Some(m) = self.moving.as_ref().filter(|_| self.nonrigid.is_none()) {
            r.copy(&m.superpoints.property_loss, self.readback.slice(property, 16))?;
        }
        r.copy(&self.status, self.readback.slice(status, status::STATUS_WORDS as u64 * 4))?;
        r.host_read(&self.readback);
        Ok(())
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
        let property =
            if self.moving.is_some() && self.nonrigid.is_none() { [0, 1, 2].map(|i| float(2, i)) } else { [0.0; 3] };
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
            superpoints: self.parameters.scene.superpoints,
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
        match self.targets.last().and_then(|t| t.commands.as_ref()) {
            Some((_, commands)) if self.profile => commands.timings(),
            _ => Ok(Vec::new()),
        }
    }

    /// Everything that the next step depends on.
    ///
    /// # Errors
    /// `NonFinite` when a number has gone bad: that is no state to go on from; `DeviceLost`, `OutOfMemory`.
    pub fn checkpoint(&self) -> Result<Checkpoint> {
        self.check_numbers()?;
        let motion = self.moving.as_ref().map(|m| self.motion_state(m)).transpose()?;
        Ok(Checkpoint {
            config: self.config.clone(),
            stage: self.schedule.stage(),
            iteration: self.iteration,
            parameters: self.parameters.download(&self.gpu)?,
            motion,
            nonrigid: self.nonrigid.as_ref().map(nonrigid_state).transpose()?,
        })
    }

    fn motion_state(&self, m: &Moving) -> Result<MotionState> {
        let of_gaussian = Slice::from(&self.parameters.scene.superpoint_of_gaussian);
        let (superpoints, association) = m.superpoints.download(&self.gpu, &of_gaussian)?;
        let [moment_1, moment_2] = m.network.download_moments()?;
        Ok(MotionState {
            position: superpoints.position,
            association,
            association_moments: m.superpoints.download_moments(&self.gpu)?,
            network: NetworkState { weights: m.network.download()?.flatten(), moment_1, moment_2 },
        })
    }

    /// The scene as it is: Gaussians at the SH degree in use, superpoints, association, network F.
    ///
    /// # Errors
    /// `DeviceLost`, `OutOfMemory`.
    pub fn scene(&self) -> Result<Scene> {
        let degree = self.schedule.sh_degree(self.iteration.max(1)).min(self.parameters.sh_degree);
        let gaussians = super::parameters::with_sh_degree(&self.parameters.download_gaussians(&self.gpu)?, degree);
        let mut scene = Scene { gaussians, ..Scene::default() };
        if let Some(m) = &self.moving {
            let of_gaussian = Slice::from(&self.parameters.scene.superpoint_of_gaussian);
            let (superpoints, association) = m.superpoints.download(&self.gpu, &of_gaussian)?;
            scene.superpoints = Some(superpoints);
            scene.association = Some(association);
            scene.deform = Some(m.network.download()?);
        }
        scene.nonrigid = self.nonrigid.as_ref().map(|g| g.network.download()).transpose()?;
        Ok(scene)
    }

    /// Poses of network F at `times`, as a table; `None` before motion begins.
    ///
    /// # Errors
    /// `DeviceLost`, `OutOfMemory`.
    pub fn motion_at(&self, times: &[f32]) -> Result<Option<Motion>> {
        let Some(m) = &self.moving else { return Ok(None) };
        let count = m.superpoints.superpoints();
        let mut motion = Motion { times: times.to_vec(), ..Motion::default() };
        let mut r = self.gpu.recorder("poses");
        let position = Slice::from(&m.superpoints.position);
        m.network.record_forward(&mut r, count, &Slice::from(&self.step), &position, &Slice::from(&m.pose))?;
        let mut commands = r.finish()?;
        for &time in times {
            let step = Step { counts: [0, count, 0, 0], time: [time, time, 0.0, 0.0], ..Step::default() };
            self.step.write(0, bytemuck::bytes_of(&step))?;
            self.gpu.submit(&mut commands)?;
            self.gpu.wait_for(&commands)?;
            let poses: Vec<[f32; 4]> = bytemuck::pod_collect_to_vec(&self.gpu.download(&m.pose)?);
            for pair in poses.chunks_exact(2).take(count as usize) {
                motion.rotation.push([pair[0][0], pair[0][1], pair[0][2]]);
                motion.translation.push([pair[1][0], pair[1][1], pair[1][2]]);
            }
        }
        Ok(Some(motion))
    }

    /// What density control did since the last call.
    pub fn take_density_change(&mut self) -> Option<DensityChange> {
        self.density_change.take()
    }
}

fn nonrigid_state(g: &Nonrigid) -> Result<NetworkState> {
    let [moment_1, moment_2] = g.network.download_moments()?;
    Ok(NetworkState { weights: g.network.download()?.flatten(), moment_1, moment_2 })
}

/// Owned slices of [`network_g::Inputs`].
struct NonrigidInputs {
    frame: Slice,
    mean: Slice,
    superpoint_of_gaussian: Slice,
    pose: Slice,
    moving: bool,
}

impl NonrigidInputs {
    fn borrow(&self) -> network_g::Inputs<'_> {
        network_g::Inputs {
            frame: &self.frame,
            mean: &self.mean,
            superpoint_of_gaussian: &self.superpoint_of_gaussian,
            pose: &self.pose,
            moving: self.moving,
        }
    }
}

/// `most` Gaussians, evenly spread over the list.
fn thinned(g: &Gaussians, most: usize) -> Gaussians {
    g.selected(&(0..most).map(|i| i * g.len() / most).collect::<Vec<_>>())
}
