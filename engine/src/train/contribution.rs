//! How much of an image each Gaussian makes up.

use super::blend_backward::{self, BackwardInput, BackwardTarget, ROW_WORDS};
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Gpu, Memory, Slice};
use crate::render::RenderOptions;
use crate::render::capacity;
use crate::render::frame::{Frame, FrameOptions};
use crate::render::pipeline::{FrameBuffers, Shape, record_forward};
use crate::render::quality::Quality;
use crate::render::scene_buffers::SceneBuffers;
use crate::render::segments::States;
use crate::render::tiles::{SlotBuffers, tiles_of};
use crate::render::work_buffers::{COUNTER_WORDS, WorkBuffers};
use crate::scene::{Camera, Scene};

/// Where a row of `splat_gradient` has what it makes up of the three channels.
const CHANNELS: usize = 6;

/// A scene on the device, of whose Gaussians it is asked what they make up.
#[derive(Debug)]
pub struct Contributions {
    gpu: Gpu,
    scene: SceneBuffers,
    near: f32,
    background: [f32; 3],
    capacity: u64,
    target: Option<Target>,
    host_pose: Vec<[f32; 4]>,
}

/// Buffers of one image size.
#[derive(Debug)]
struct Target {
    size: [u32; 2],
    capacity: u32,
    work: WorkBuffers,
    slots: SlotBuffers,
    states: Option<States>,
    frame: FrameBuffers,
    image_gradient: Buffer,
    rows: Buffer,
    splat_gradient: Buffer,
}

impl Contributions {
    /// Uploads a scene; of the options background, near plane and motion count.
    ///
    /// # Errors
    /// As [`Renderer::new`](crate::render::Renderer::new).
    pub fn new(gpu: &Gpu, scene: &Scene, options: &RenderOptions) -> Result<Self> {
        let scene = SceneBuffers::new(gpu, scene, options.motion, &Quality::EXACT)?;
        Ok(Self {
            gpu: gpu.clone(),
            near: options.near,
            background: options.background,
            capacity: capacity::first(scene.gaussians),
            scene,
            target: None,
            host_pose: Vec::new(),
        })
    }

    /// Σ αT·`weight` over the pixels, for each Gaussian `[N,3]`, of a view at `time`; `weight` is `[H,W,3]`. The same bits on
    /// every run.
    ///
    /// # Errors
    /// `Usage` for weights of another size; as [`Renderer::render`](crate::render::Renderer::render).
    pub fn of_view(&mut self, camera: &Camera, time: f64, weight: &[[f32; 3]]) -> Result<Vec<[f32; 3]>> {
        let pixels = camera.width as usize * camera.height as usize;
        if weight.len() != pixels {
            return Err(Error::usage("weights of pixels", weight.len().to_string(), pixels.to_string()));
        }
        let gradient: Vec<[f32; 4]> = weight.iter().map(|[r, g, b]| [*r, *g, *b, 0.0]).collect();
        loop {
            let target = match self.target.take() {
                Some(target) if target.size == [camera.width, camera.height] => target,
                _ => self.target([camera.width, camera.height])?,
            };
            let target = self.target.insert(target);
            self.gpu.upload(&target.image_gradient, bytemuck::cast_slice(&gradient))?;
            if let Some(rows) = self.attempt(camera, time)? {
                return Ok(rows);
            }
        }
    }

    fn target(&self, size: [u32; 2]) -> Result<Target> {
        let (gpu, n) = (&self.gpu, self.scene.gaussians);
        let tiles = tiles_of(size);
        let capacity = u32::try_from(self.capacity).unwrap_or(u32::MAX);
        let pixels = u64::from(size[0]) * u64::from(size[1]);
        let device = |name: &str, words: u64| gpu.buffer(name, 4 * words.max(4), Memory::Device);
        let host_pose = self.scene.deformation.host_pose_bytes();
        Ok(Target {
            size,
            capacity,
            work: WorkBuffers::new(gpu, n, tiles, capacity)?,
            slots: SlotBuffers::new(gpu, n, capacity)?,
            states: States::of_device(gpu, size)?,
            frame: FrameBuffers {
                frame: gpu.buffer("frame", size_of::<Frame>() as u64, Memory::Constants)?,
                host_pose: host_pose.map(|bytes| gpu.buffer("pose", bytes, Memory::Constants)).transpose()?,
                color: device("color", 4 * pixels)?,
                depth: None,
                counters: gpu.buffer("counters readback", 4 * COUNTER_WORDS, Memory::Readback)?,
            },
            image_gradient: device("image_gradient", 4 * pixels)?,
            rows: device("instance_gradient", u64::from(capacity) * u64::from(ROW_WORDS))?,
            splat_gradient: device("splat_gradient", u64::from(n) * u64::from(ROW_WORDS))?,
        })
    }

    /// `None` when the view needed more tile instances than there was room for: there is more then.
    fn attempt(&mut self, camera: &Camera, time: f64) -> Result<Option<Vec<[f32; 3]>>> {
        let (gpu, scene) = (&self.gpu, &self.scene);
        let Some(t) = &self.target else { return Ok(None) };
        let options = FrameOptions {
            background: self.background,
            near: self.near,
            time,
            instance_capacity: t.capacity,
            ..FrameOptions::default()
        };
        let frame = scene.frame(camera, options)?;
        t.frame.frame.write(0, bytemuck::bytes_of(&frame))?;
        scene.deformation.poses.write(time, scene.origin, &mut self.host_pose);
        if let Some(buffer) = &t.frame.host_pose {
            buffer.write(0, bytemuck::cast_slice(&self.host_pose))?;
        }
        let tiles = tiles_of(t.size);
        let shape = Shape { tiles, slots: Some(t.slots.clone()), states: t.states.clone(), ..Shape::default() };
        let mut r = gpu.recorder("contributions");
        record_forward(gpu, &mut r, scene, &t.work, &t.frame, &shape)?;
        let input = BackwardInput::new(&t.work, &t.frame, &t.image_gradient, scene.gaussians, &shape);
        let target = BackwardTarget::Instances(t.slots.clone(), Slice::from(&t.rows));
        blend_backward::record(gpu, &mut r, &input, &target, &Slice::from(&t.splat_gradient))?;
        r.copy(&t.work.counters, t.frame.counters.slice(0, t.work.counters.bytes))?;
        r.host_read(&t.frame.counters);
        gpu.run(r)?;

        let mut bytes = [0_u8; COUNTER_WORDS as usize * 4];
        t.frame.counters.read(0, &mut bytes)?;
        let counted = capacity::counted(&bytes);
        if counted.overflowed {
            let limit = capacity::limit(gpu, None).min(u64::from(u32::MAX) / u64::from(ROW_WORDS) / 4);
            self.capacity = capacity::grown(self.capacity, counted.statistics.instances, limit, scene.gaussians)?;
            self.target = None;
            return Ok(None);
        }
        if scene.gaussians == 0 {
            return Ok(Some(Vec::new()));
        }
        let rows: Vec<f32> = bytemuck::pod_collect_to_vec(&gpu.download(&t.splat_gradient)?);
        let of_row = |row: &[f32]| [row[CHANNELS], row[CHANNELS + 1], row[CHANNELS + 2]];
        let rows = rows.chunks_exact(ROW_WORDS as usize).take(scene.gaussians as usize);
        Ok(Some(rows.map(of_row).collect()))
    }
}
