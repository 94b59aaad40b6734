//! The loss of one photo, and its gradients by the poses of superpoints and by the camera: the kernels of a training step,
//! with the Gaussians left as they are and poses that the host gives.
//!
//! Per Gaussian the device leaves the gradient by a left tangent ω of its superpoint's rotation and by the translation τ. The
//! host sums them in f64 and in a fixed order: by superpoint for the poses, over all of them for the camera, which sees a scene
//! that moves as one just as if it moved the other way.

mod sums;

use std::collections::HashMap;

use glam::DVec3;

use super::blend_backward::{self, Accumulation, BackwardInput, BackwardTarget, ROW_WORDS};
use super::deform_project_backward::{Output, ProjectBackward, SLOT_PLANES};
use super::deformation::ProjectInputs;
use super::image_loss::{LOSS_WORDS, LossPassBuffers, TargetFormat};
use super::status;
use super::step::Step;
use super::target::{Target, TargetSize};
use crate::data::pixels::{LEFT_OUT, Pixels};
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Commands, Gpu, Memory, Recorder, Slice};
use crate::reference::{Pose, exp};
use crate::render::capacity;
use crate::render::deformation::{Offsets, Poses};
use crate::render::frame::FrameOptions;
use crate::render::pipeline::record_forward;
use crate::render::quality::Quality;
use crate::render::scene_buffers::SceneBuffers;
use crate::render::work_buffers::COUNTER_WORDS;
use crate::scene::parameter::planes;
use crate::scene::{Camera, MotionSource, Scene};

pub use sums::{CameraGradient, Twist};

/// Where counters, loss, status and the gradients begin in the readback, bytes.
const READBACK: [u64; 4] = [0, 256, 512, 1024];

/// What the loss depends on besides scene, poses, camera and photo.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PhotoLossOptions {
    /// Colour behind everything, in the image and behind transparent photos.
    pub background: [f32; 3],
    /// Near plane, world units.
    pub near: f32,
    /// λ of D-SSIM; the rest is L1.
    pub lambda_dssim: f32,
    /// Whether the same bits come out on every run, also where the device adds faster without.
    pub deterministic: bool,
}

/// A photo on the device.
#[derive(Debug)]
pub struct DevicePhoto {
    size: [u32; 2],
    buffer: Buffer,
    format: TargetFormat,
    /// Commands that compare with it, and the buffers that they were recorded for.
    recorded: Option<(u64, Commands)>,
}

/// What one photo says.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Evaluation {
    /// (1 − λ)·L1 + λ·(1 − SSIM), a mean over the pixels; 0 for a given gradient.
    pub loss: f64,
    /// Mean absolute error.
    pub l1: f64,
    /// Structural similarity; 0 where λ is.
    pub ssim: f64,
    /// Mean squared error.
    pub mse: f64,
    /// `[M]` gradients by the poses.
    pub poses: Vec<Twist>,
    /// Gradient by the camera, where it was asked for.
    pub camera: Option<CameraGradient>,
}

/// A scene on the device whose superpoints stand where each evaluation wants them.
#[derive(Debug)]
pub struct PhotoLoss<'a> {
    gpu: Gpu,
    scene: &'a Scene,
    options: PhotoLossOptions,
    buffers: SceneBuffers,
    /// By image size.
    targets: HashMap<[u32; 2], Target>,
    /// Changes when the targets are others.
    generation: u64,
    capacity: u64,
    step: Buffer,
    status: Buffer,
    failed: Buffer,
    splat_gradient: Buffer,
    gradient: Buffer,
    pose_gradient: Buffer,
    readback: Buffer,
}

/// What an attempt left.
enum Attempt {
    Done(Evaluation),
    /// There was no room for this many tile instances.
    NoRoom(u64),
}

impl<'a> PhotoLoss<'a> {
    /// Uploads a scene with a key-time table, whose keys say nothing here but that there are superpoints.
    ///
    /// # Errors
    /// `Usage` for a scene without a table, or with network G; as the renderer otherwise.
    pub fn new(gpu: &Gpu, scene: &'a Scene, options: PhotoLossOptions) -> Result<Self> {
        let mut buffers = SceneBuffers::new(gpu, scene, MotionSource::Table, &Quality::EXACT)?;
        let moved = &mut buffers.deformation;
        if !matches!(moved.offsets, Offsets::None) {
            return Err(Error::usage("motion of the scene", "network G", "superpoints alone"));
        }
        moved.pose = gpu.buffer("pose", 32 * u64::from(moved.superpoints), Memory::Upload)?;
        moved.poses = Poses::Given;
        let n = u64::from(buffers.gaussians.max(1));
        let rows = n * u64::from(ROW_WORDS) * 4;
        let poses = n * 4 * u64::from((SLOT_PLANES * moved.blend_slots()).max(6));
        let parameters = u64::from(planes(buffers.sh_degree, buffers.present));
        let device = |name: &str, bytes: u64| gpu.buffer(name, bytes, Memory::Device);
        let step = Step {
            gaussians: buffers.gaussians,
            superpoints: buffers.deformation.superpoints,
            weight_dssim: options.lambda_dssim,
            ..Step::with_usual_adam()
        };
        Ok(Self {
            gpu: gpu.clone(),
            scene,
            options,
            targets: HashMap::new(),
            generation: 0,
            capacity: capacity::first(buffers.gaussians),
            step: gpu.buffer_with("step", bytemuck::bytes_of(&step))?,
            status: gpu.buffer_with("status", bytemuck::cast_slice(&status::clear()))?,
            failed: gpu.buffer_with("failed", bytemuck::cast_slice(&[0_u32; COUNTER_WORDS as usize]))?,
            splat_gradient: device("splat_gradient", rows)?,
            gradient: device("gradient", 4 * n * parameters)?,
            pose_gradient: device("pose_gradient", poses)?,
            readback: gpu.buffer("photo loss readback", READBACK[3] + poses + rows, Memory::Readback)?,
            buffers,
        })
    }

    /// Uploads a photo.
    ///
    /// # Errors
    /// `OutOfMemory`, `Limit`.
    pub fn photo(&self, photo: &Pixels) -> Result<DevicePhoto> {
        let buffer = self.gpu.buffer_with("photo", bytemuck::cast_slice(&photo.rgba))?;
        let format = TargetFormat::of_photos(photo.rgba.contains(&LEFT_OUT));
        Ok(DevicePhoto { size: [photo.width, photo.height], buffer, format, recorded: None })
    }

    /// The loss of `photo`, seen by `camera`, with the superpoints at `poses` `[M]`, and its gradients. The camera's are made only
    /// if asked for.
    ///
    /// # Errors
    /// `Usage` for sizes that differ, `NonFinite` naming what is not finite, `Limit` and `OutOfMemory` when the view does not
    /// fit, `DeviceLost`.
    pub fn evaluate(
        &mut self,
        photo: &mut DevicePhoto,
        camera: &Camera,
        poses: &[Pose],
        by_camera: bool,
    ) -> Result<Evaluation> {
        if photo.size != [camera.width, camera.height] {
            let found = format!("{}×{} pixels", photo.size[0], photo.size[1]);
            return Err(Error::usage(format!("photo of {}", camera.name), found, "the camera's size"));
        }
        self.repeat(camera, poses, by_camera, |this| {
            if photo.recorded.as_ref().is_none_or(|(generation, _)| *generation != this.generation) {
                let commands = this.record(photo.size, Some((&photo.buffer, photo.format)))?.finish()?;
                photo.recorded = Some((this.generation, commands));
            }
            let Some((_, commands)) = &mut photo.recorded else { return Ok(()) };
            this.gpu.submit(commands)?;
            this.gpu.wait_for(commands)
        })
    }

    /// The gradients of Σ `image_gradient`·image, `[H,W,4]` of r, g, b and A.
    ///
    /// # Errors
    /// As [`PhotoLoss::evaluate`].
    pub fn pull_back(
        &mut self,
        image_gradient: &[f32],
        camera: &Camera,
        poses: &[Pose],
        by_camera: bool,
    ) -> Result<Evaluation> {
        let size = [camera.width, camera.height];
        let pixels = size[0] as usize * size[1] as usize;
        if image_gradient.len() != 4 * pixels {
            let expected = format!("{} values", 4 * pixels);
            return Err(Error::usage("gradient of the image", image_gradient.len().to_string(), expected));
        }
        let evaluation = self.repeat(camera, poses, by_camera, |this| {
            let Some(target) = this.targets.get(&size) else { return Ok(()) };
            this.gpu.upload(&target.image_gradient, bytemuck::cast_slice(image_gradient))?;
            let recorder = this.record(size, None)?;
            this.gpu.run(recorder).map(|_| ())
        })?;
        Ok(Evaluation { loss: 0.0, l1: 0.0, ssim: 0.0, mse: 0.0, ..evaluation })
    }

    /// The image `[H,W,3]` that `camera` sees with the superpoints at `poses` `[M]`.
    ///
    /// # Errors
    /// `Limit` and `OutOfMemory` when the view does not fit, `DeviceLost`.
    pub fn image(&mut self, camera: &Camera, poses: &[Pose]) -> Result<Vec<f32>> {
        self.write_poses(poses)?;
        loop {
            self.prepare(camera)?;
            let Some(target) = self.targets.get(&[camera.width, camera.height]) else { return Ok(Vec::new()) };
            let (frame, counters) = (&target.frames[0], &target.work.counters);
            let mut r = self.gpu.recorder("image");
            record_forward(&self.gpu, &mut r, &self.buffers, &target.work, frame, &target.shape)?;
            r.copy(counters.clone(), self.readback.slice(READBACK[0], counters.bytes))?;
            r.host_read(&self.readback);
            self.gpu.run(r)?;
            let mut head = [0; READBACK[1] as usize];
            self.readback.read(0, &mut head)?;
            match head.first_chunk().map(capacity::counted).filter(|c| c.overflowed) {
                Some(counted) => self.make_room(counted.statistics.instances)?,
                None => {
                    let rgba: Vec<f32> = bytemuck::pod_collect_to_vec(&self.gpu.download(&frame.color)?);
                    return Ok(rgba.as_chunks::<4>().0.iter().flat_map(|p| [p[0], p[1], p[2]]).collect());
                }
            }
        }
    }

    /// Room for this many tile instances.
    fn make_room(&mut self, instances: u64) -> Result<()> {
        let limit = capacity::limit(&self.gpu, None).min(u64::from(u32::MAX) / u64::from(ROW_WORDS) / 4);
        self.capacity = capacity::grown(self.capacity, instances, limit, self.buffers.gaussians)?;
        self.gpu.upload(&self.status, bytemuck::cast_slice(&status::clear()))?;
        self.targets.clear();
        Ok(())
    }

    /// Runs until there is room for the view.
    fn repeat(
        &mut self,
        camera: &Camera,
        poses: &[Pose],
        by_camera: bool,
        mut run: impl FnMut(&mut Self) -> Result<()>,
    ) -> Result<Evaluation> {
        self.write_poses(poses)?;
        loop {
            self.prepare(camera)?;
            run(self)?;
            match self.outcome(camera, poses, by_camera)? {
                Attempt::Done(evaluation) => return Ok(evaluation),
                Attempt::NoRoom(instances) => self.make_room(instances)?,
            }
        }
    }

    /// Poses relative to the scene's origin o on the device: Exp(r)(μ' + o) + τ − o.
    fn write_poses(&self, poses: &[Pose]) -> Result<()> {
        let (origin, expected) = (self.buffers.origin, self.buffers.deformation.superpoints as usize);
        if poses.len() != expected {
            return Err(Error::usage("poses", poses.len().to_string(), format!("{expected}, one per superpoint")));
        }
        let rows: Vec<[[f32; 4]; 2]> = poses
            .iter()
            .map(|pose| {
                let moved = if origin == DVec3::ZERO { origin } else { exp(pose.rotation) * origin - origin };
                [pose.rotation, pose.translation + moved].map(|v| v.as_vec3().extend(0.0).to_array())
            })
            .collect();
        self.buffers.deformation.pose.write(0, bytemuck::cast_slice(&rows))
    }

    /// Buffers for the camera's image, and its frame.
    fn prepare(&mut self, camera: &Camera) -> Result<()> {
        let size = [camera.width, camera.height];
        if !self.targets.contains_key(&size) {
            self.generation += 1;
            let wanted = TargetSize {
                image: size,
                gaussians: self.buffers.gaussians,
                capacity: self.capacity.min(u64::from(u32::MAX)) as u32,
                with_slots: Accumulation::of_device(&self.gpu, self.options.deterministic) == Accumulation::Instances,
                with_exposure: false,
                with_ssim: self.options.lambda_dssim > 0.0,
                steps: 1,
            };
            self.targets.insert(size, Target::new(&self.gpu, wanted, &self.failed)?);
        }
        let Some(target) = self.targets.get(&size) else { return Ok(()) };
        let options = FrameOptions {
            background: self.options.background,
            near: self.options.near,
            time: camera.time,
            instance_capacity: target.capacity,
            ..FrameOptions::default()
        };
        let frame = self.buffers.frame(camera, options)?;
        target.frames[0].frame.write(0, bytemuck::bytes_of(&frame))
    }

    /// Forward, loss (with a photo) and backward.
    fn record(&self, size: [u32; 2], photo: Option<(&Buffer, TargetFormat)>) -> Result<Recorder> {
        let mut r = self.gpu.recorder("photo loss");
        let Some(t) = self.targets.get(&size) else { return Ok(r) };
        let frame = &t.frames[0];
        record_forward(&self.gpu, &mut r, &self.buffers, &t.work, frame, &t.shape)?;
        if let Some((photo, format)) = photo {
            let loss = LossPassBuffers {
                frame: &frame.frame,
                step: &self.step,
                color: &frame.color,
                target: photo,
                image_gradient: &t.image_gradient,
                loss: &t.loss,
                status: &self.status,
            };
            t.image_loss.record(&mut r, &loss, format)?;
        }
        self.record_backward(&mut r, t)?;
        r.copy(t.work.counters.clone(), self.readback.slice(READBACK[0], t.work.counters.bytes))?;
        r.copy(&t.loss, self.readback.slice(READBACK[1], LOSS_WORDS as u64 * 4))?;
        r.copy(&self.status, self.readback.slice(READBACK[2], status::STATUS_WORDS as u64 * 4))?;
        let [poses, rows] = [&self.pose_gradient, &self.splat_gradient];
        r.copy(poses, self.readback.slice(READBACK[3], poses.bytes()))?;
        r.copy(rows, self.readback.slice(READBACK[3] + poses.bytes(), rows.bytes()))?;
        r.host_read(&self.readback);
        Ok(r)
    }

    fn record_backward(&self, r: &mut Recorder, t: &Target) -> Result<()> {
        let frame = &t.frames[0];
        let input = BackwardInput::new(&t.work, &t.frames[0], &t.image_gradient, self.buffers.gaussians, &t.shape);
        let target = match (&t.shape.slots, &t.instance_gradient) {
            (Some(slots), Some(rows)) => BackwardTarget::Instances(slots.clone(), Slice::from(rows)),
            _ => BackwardTarget::NativeAtomics,
        };
        blend_backward::record(&self.gpu, r, &input, &target, &Slice::from(&self.splat_gradient))?;
        let pass = ProjectBackward {
            scene: &self.buffers,
            frame: &frame.frame,
            work: &t.work,
            step: &self.step,
            status: &self.status,
            splat_gradient: &self.splat_gradient,
            pose_gradient: &self.pose_gradient,
            model: ProjectInputs::default(),
            output: Output::Gradient(&self.gradient),
        };
        pass.record(r)
    }

    /// What the last run left.
    fn outcome(&self, camera: &Camera, poses: &[Pose], by_camera: bool) -> Result<Attempt> {
        let mut head = vec![0; READBACK[3] as usize];
        self.readback.read(0, &mut head)?;
        let counters = head.first_chunk().map(capacity::counted);
        if let Some(counted) = counters.filter(|c| c.overflowed) {
            return Ok(Attempt::NoRoom(counted.statistics.instances));
        }
        let words: Vec<u32> = bytemuck::pod_collect_to_vec(&head);
        let first = (READBACK[2] / 4) as usize;
        if let Some((group, count, index)) = status::first(&words[first..first + status::STATUS_WORDS]) {
            let what = format!("{group} for photo {} ({count} not finite), first", camera.name);
            return Err(Error::NonFinite { what, index: index as usize, value: "not finite".into() });
        }
        let loss = |i: u64| f64::from(f32::from_bits(words[(READBACK[1] / 4 + i) as usize]));
        let of_poses = self.floats(READBACK[3], self.pose_gradient.bytes())?;
        let poses_found = self.pose_sums(&of_poses, poses);
        let camera = if by_camera {
            let rows = self.floats(READBACK[3] + self.pose_gradient.bytes(), self.splat_gradient.bytes())?;
            Some(self.camera_gradient(&poses_found, &rows, camera, poses))
        } else {
            None
        };
        let [loss, l1, ssim, mse] = [0, 1, 2, 3].map(loss);
        Ok(Attempt::Done(Evaluation { loss, l1, ssim, mse, poses: poses_found, camera }))
    }

    fn floats(&self, offset: u64, bytes: u64) -> Result<Vec<f32>> {
        let mut values = vec![0.0_f32; bytes as usize / 4];
        self.readback.read(offset, bytemuck::cast_slice_mut(&mut values))?;
        Ok(values)
    }
}
