//! Gradients of a rendered image with respect to the scene, outside of training: the same kernels as a training step, with
//! the Gaussians left as they are.

use super::blend_backward::{self, BackwardInput, BackwardTarget, ROW_WORDS};
use super::deform_project_backward::{Output, ProjectBackward, SLOT_PLANES};
use super::deformation::ProjectInputs;
use super::status;
use super::step::Step;
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Gpu, Memory, Slice};
use crate::reference::gradient::splats::TWO_LN_2;
use crate::render::deformation::{Offsets, Poses};
use crate::render::frame::{Frame, FrameOptions};
use crate::render::limits::{COUNT_FAILED, COUNT_INSTANCES_HIGH, COUNT_INSTANCES_LOW};
use crate::render::pipeline::{FrameBuffers, Shape, record_forward};
use crate::render::quality::Quality;
use crate::render::scene_buffers::SceneBuffers;
use crate::render::segments::States;
use crate::render::tiles::{SlotBuffers, tiles_of};
use crate::render::work_buffers::{COUNTER_WORDS, WorkBuffers};
use crate::scene::parameter::{Optional, PARAMETERS, first_plane, planes};
use crate::scene::{Camera, Gaussians, MotionSource, Scene};

/// What the image depends on besides scene, camera and time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GradientOptions {
    /// Near plane, world units.
    pub near: f32,
    /// Colour behind everything.
    pub background: [f32; 3],
}

/// dL/d of a scene's parameters.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SceneGradients {
    /// `[N,3]`.
    pub mean: Vec<[f32; 3]>,
    /// `[N,4]` of the raw quaternion w,x,y,z.
    pub rotation: Vec<[f32; 4]>,
    /// `[N,3]`.
    pub log_scale: Vec<[f32; 3]>,
    /// `[N]`.
    pub opacity_logit: Vec<f32>,
    /// `[N,K,3]`.
    pub sh: Vec<f32>,
    /// `[N,width]` of what only some scenes have.
    pub optional: Optional,
    /// `[N,2]` of the projected centre, px; 0 for what is not drawn.
    pub mean2d: Vec<[f32; 2]>,
    /// `[N,6]` by a left tangent of the rotation of each Gaussian's superpoint, and of its translation; empty when nothing
    /// moves, and with soft superpoints.
    pub pose: Vec<[f32; 6]>,
    /// `[N,K,7]` of soft superpoints: the same of each slot, then dL/dw of its weight, less what is common to all slots.
    pub blend: Vec<[f32; 7]>,
}

/// Gradients of L given `image_gradient` = dL/d(r, g, b, A) at each pixel, `[H,W,4]`. Poses come from the scene's table.
/// Sums are made in a fixed order: the same bits on every run.
///
/// # Errors
/// `Usage` for an image gradient of another size or a scene far from the origin that moves; as the renderer otherwise.
pub fn scene_gradients(
    gpu: &Gpu,
    scene: &Scene,
    camera: &Camera,
    time: f64,
    options: &GradientOptions,
    image_gradient: &[f32],
) -> Result<SceneGradients> {
    let pixels = u64::from(camera.width) * u64::from(camera.height);
    if image_gradient.len() as u64 != 4 * pixels {
        let found = image_gradient.len().to_string();
        return Err(Error::usage("gradient of the image", found, format!("{} values", 4 * pixels)));
    }
    let source = if scene.deformation.table().is_some() { MotionSource::Table } else { MotionSource::Auto };
    let buffers = SceneBuffers::new(gpu, scene, source, &Quality::EXACT)?;
    let moved = &buffers.deformation;
    if !matches!((&moved.poses, &moved.offsets), (Poses::Static | Poses::Table(_), Offsets::None)) {
        return Err(Error::usage("motion of the scene", "no table near the origin", "a static scene or such a table"));
    }
    let image_gradient = gpu.buffer_with("image_gradient", bytemuck::cast_slice(image_gradient))?;
    let mut run = Run { gpu, scene: &buffers, camera, time, options, image_gradient };
    let mut capacity = u64::from(buffers.gaussians).max(64) * 16;
    loop {
        let too_many = || Error::Limit { what: "tile instances".into(), need: capacity.into(), have: u32::MAX.into() };
        let room = u32::try_from(capacity).map_err(|_| too_many())?;
        match run.attempt(room)? {
            Attempt::Done(gradients) => return Ok(*gradients),
            Attempt::Needs(instances) => capacity = instances,
        }
    }
}

enum Attempt {
    Done(Box<SceneGradients>),
    /// There was no room for this many tile instances.
    Needs(u64),
}

struct Run<'a> {
    gpu: &'a Gpu,
    scene: &'a SceneBuffers,
    camera: &'a Camera,
    time: f64,
    options: &'a GradientOptions,
    image_gradient: Buffer,
}

impl Run<'_> {
    fn frame(&self, capacity: u32) -> Result<Frame> {
        let options = FrameOptions {
            background: self.options.background,
            near: self.options.near,
            time: self.time,
            interval: self.scene.deformation.interval(self.time),
            gaussians: self.scene.gaussians,
            superpoints: self.scene.deformation.superpoints,
            sh_degree: self.scene.sh_degree,
            instance_capacity: capacity,
        };
        Frame::new(self.camera, self.scene.origin, &options)
    }

    fn attempt(&mut self, capacity: u32) -> Result<Attempt> {
        let (gpu, scene) = (self.gpu, self.scene);
        let n = u64::from(scene.gaussians);
        let [width, height] = [self.camera.width, self.camera.height];
        let tiles = tiles_of([width, height]);
        let device = |name: &str, words: u64| gpu.buffer(name, 4 * words.max(4), Memory::Device);
        let work = WorkBuffers::new(gpu, scene.gaussians, tiles, capacity)?;
        let slots = SlotBuffers::new(gpu, scene.gaussians, capacity)?;
        let frame = FrameBuffers {
            frame: gpu.buffer_with("frame", bytemuck::bytes_of(&self.frame(capacity)?))?,
            host_pose: None,
            color: device("color", 4 * u64::from(width) * u64::from(height))?,
            depth: None,
            counters: gpu.buffer("counters readback", 4 * COUNTER_WORDS, Memory::Readback)?,
        };
        let states = States::of_device(gpu, [width, height])?;
        let shape = Shape { tiles, slots: Some(slots.clone()), states, ..Shape::default() };
        let rows = device("instance_gradient", u64::from(capacity) * u64::from(ROW_WORDS))?;
        let splat_gradient = device("splat_gradient", n * u64::from(ROW_WORDS))?;
        let planes = planes(scene.sh_degree, scene.present);
        let gradient = device("gradient", n * u64::from(planes))?;
        let pose_planes = u64::from((SLOT_PLANES * scene.deformation.blend_slots()).max(6));
        let pose_gradient = device("pose_gradient", pose_planes * n)?;

        let mut r = gpu.recorder("scene gradients");
        record_forward(gpu, &mut r, scene, &work, &frame, &shape)?;
        let input = BackwardInput::new(&work, &frame, &self.image_gradient, scene.gaussians, &shape);
        let target = BackwardTarget::Instances(slots, Slice::from(&rows));
        blend_backward::record(gpu, &mut r, &input, &target, &Slice::from(&splat_gradient))?;
        let step = gpu.buffer_with("step", bytemuck::bytes_of(&Step::default()))?;
        let status = gpu.buffer_with("status", bytemuck::cast_slice(&status::clear()))?;
        let pass = ProjectBackward {
            scene,
            frame: &frame.frame,
            work: &work,
            step: &step,
            status: &status,
            splat_gradient: &splat_gradient,
            pose_gradient: &pose_gradient,
            model: ProjectInputs::default(),
            output: Output::Gradient(&gradient),
        };
        pass.record(&mut r)?;
        gpu.run(r)?;

        let counters = words(gpu, &work.counters)?;
        if counters[COUNT_FAILED as usize] != 0 {
            let (low, high) = (counters[COUNT_INSTANCES_LOW as usize], counters[COUNT_INSTANCES_HIGH as usize]);
            return Ok(Attempt::Needs(u64::from(low) | u64::from(high) << 32));
        }
        let part = |buffer: &Buffer, count: u64| Ok::<_, Error>(floats(words(gpu, &buffer.slice(0, 4 * count))?));
        let gradient = part(&gradient, n * u64::from(planes))?;
        let pose = if scene.deformation.moves() { part(&pose_gradient, pose_planes * n)? } else { Vec::new() };
        let splats = part(&work.splats, 12 * n)?;
        let tile_count = words(gpu, &work.tile_count.slice(0, 4 * n))?;
        let rows = part(&splat_gradient, n * u64::from(ROW_WORDS))?;
        let mut gradients = unpack(&gradient, &pose, n as usize, scene)?;
        gradients.mean2d = (0..n as usize)
            .map(|g| if tile_count[g] > 0 { mean2d(&splats[12 * g..], &rows[12 * g..]) } else { [0.0; 2] })
            .collect();
        Ok(Attempt::Done(Box::new(gradients)))
    }
}

fn words(gpu: &Gpu, slice: &Slice) -> Result<Vec<u32>> {
    let bytes = if slice.bytes == 0 { Vec::new() } else { gpu.download(slice.clone())? };
    Ok(bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
}

fn floats(words: Vec<u32>) -> Vec<f32> {
    words.into_iter().map(f32::from_bits).collect()
}

/// dL/d centre, px, from a splat and its row: Σ h Lᵀ(u, v) with L in the kernels' units.
fn mean2d(splat: &[f32], row: &[f32]) -> [f32; 2] {
    let k = TWO_LN_2 as f32;
    [k * splat[2] * row[1], k * (splat[3] * row[1] + splat[4] * row[2])]
}

/// Planes to arrays per Gaussian.
fn unpack(planes: &[f32], pose: &[f32], n: usize, scene: &SceneBuffers) -> Result<SceneGradients> {
    let of_parameters = Gaussians::from_parameters(scene.sh_degree, scene.present, |parameter| {
        let [first, width] =
            [first_plane(parameter, scene.present), PARAMETERS[parameter].width].map(|plane| plane as usize);
        Ok::<_, Error>((0..n).flat_map(|g| (first..first + width).map(move |p| planes[p * n + g])).collect())
    })?;
    let slots = scene.deformation.blend_slots() as usize;
    let pose_rows = if pose.is_empty() || slots > 0 { 0 } else { n };
    let slot = |g: usize, k: usize| std::array::from_fn(|p| pose[(k * SLOT_PLANES as usize + p) * n + g]);
    let blend = (0..n * slots).map(|at| slot(at / slots, at % slots)).collect();
    let Gaussians { mean, log_scale, rotation, opacity_logit, sh, optional, .. } = of_parameters;
    let pose = (0..pose_rows).map(|g| std::array::from_fn(|k| pose[k * n + g])).collect();
    Ok(SceneGradients { mean, rotation, log_scale, opacity_logit, sh, optional, mean2d: Vec::new(), pose, blend })
}
