//! Recording frames into a host's command buffers.

use std::collections::VecDeque;

use super::super::blend_image;
use super::super::capacity;
use super::super::frame::{Frame, FrameOptions};
use super::super::limits::TILE_SIZE;
use super::super::pipeline::{FrameBuffers, Shape, record_forward};
use super::super::renderer::{FrameStatistics, MemoryUse};
use super::super::scene_buffers::{Poses, SceneBuffers};
use super::super::work_buffers::{COUNTER_WORDS, WorkBuffers};
use super::options::{Finished, MAX_IN_FLIGHT, Recorded, Target, ViewOptions};
use super::scene::SceneHandle;
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Gpu, HostCommandBuffer, Memory, Sequence, Timing};
use crate::scene::Camera;

/// Bytes of the counters in their ring, and of one place of it: counters, then the serial number of the frame.
const COUNTER_BYTES: u64 = COUNTER_WORDS * 4;
const RING_BYTES: u64 = 64;
/// Everything that depends on image size and capacity.
#[derive(Debug)]
struct Targets {
    size: [u32; 2],
    capacity: u32,
    work: WorkBuffers,
    buffers: FrameBuffers,
    sequence: Sequence,
}

/// Records frames of one scene; several views of one scene share it.
///
/// ```
/// use engine::gpu::{Gpu, GpuOptions};
/// use engine::render::{SceneHandle, SceneOptions, View, ViewOptions};
/// use engine::scene::synthetic::{demo_camera, demo_scene};
///
/// # fn main() -> engine::Result<()> {
/// let gpu = Gpu::new(&GpuOptions::default())?; // or Gpu::from_host, on the host's device
/// let loading = SceneHandle::load(&gpu, || Ok(demo_scene()), &SceneOptions::default());
/// let mut view = View::new(&gpu, &loading.finish()?, &ViewOptions::default())?;
/// let statistics = view.warm_up(&demo_camera(0.0, 64, 48), 0.0)?;
/// assert!(statistics.visible > 0 && view.memory().instance_capacity >= statistics.instances);
/// // From here on `view.record` goes into the host's command buffers and allocates nothing.
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct View {
    gpu: Gpu,
    scene: SceneHandle,
    options: ViewOptions,
    targets: Option<Targets>,
    /// Replaced targets and the last call that used them.
    retired: VecDeque<(u64, Targets)>,
    ring: Buffer,
    /// The call whose counters each place of the ring gets, 0: none.
    slots: [u64; MAX_IN_FLIGHT as usize],
    capacity: u64,
    calls: u64,
    finished: Option<Finished>,
    host_pose: Vec<[f32; 4]>,
}

impl View {
    /// A view; buffers come with its first size.
    ///
    /// # Errors
    /// `Usage` for options without sense, `OutOfMemory`.
    pub fn new(gpu: &Gpu, scene: &SceneHandle, options: &ViewOptions) -> Result<Self> {
        if !(1..=MAX_IN_FLIGHT).contains(&options.in_flight) {
            return Err(Error::usage(
                "frames in flight",
                options.in_flight.to_string(),
                format!("1 to {MAX_IN_FLIGHT}"),
            ));
        }
        if options.storage && blend_image::kernel_of(options.format).is_none() {
            let found = format!("{:?} with a storage view", options.format);
            return Err(Error::usage(
                "format of a view",
                found,
                "Rgba8, Rgba16F or Rgba32F, or an image that is copied to",
            ));
        }
        let ring = gpu.buffer("counter ring", RING_BYTES * u64::from(options.in_flight), Memory::Readback)?;
        ring.write_readback(0, &vec![0; ring.bytes() as usize])?;
        let capacity = capacity::first(scene.gaussians()).min(capacity::limit(gpu, options.max_instances));
        Ok(Self {
            gpu: gpu.clone(),
            scene: scene.clone(),
            options: options.clone(),
            targets: None,
            retired: VecDeque::new(),
            ring,
            slots: [0; MAX_IN_FLIGHT as usize],
            capacity,
            calls: 0,
            finished: None,
            host_pose: Vec::new(),
        })
    }

    /// Records a frame at `time` (unit of the motion table) into a host's command buffer. See the [module's page](super) for
    /// what happens around it.
    ///
    /// # Errors
    /// Nothing is recorded then. `Limit` when a finished frame needed more tile instances than the device or the options
    /// allow; `NonFinite` or `Usage` for a senseless camera or a target that does not fit the options; `OutOfMemory`.
    pub fn record(
        &mut self,
        commands: &HostCommandBuffer,
        camera: &Camera,
        time: f64,
        target: &Target,
    ) -> Result<Recorded> {
        if target.depth.is_some() && !self.options.depth {
            return Err(Error::usage("depth image", "one", "none: the view was made without depth"));
        }
        let said = |storage| if storage { "with a storage view" } else { "without a storage view" };
        if target.color.is_storage() != self.options.storage {
            let expected = format!("one {}: the view was made so", said(self.options.storage));
            return Err(Error::usage("colour image", format!("one {}", said(!self.options.storage)), expected));
        }
        if target.depth.is_some_and(|d| d.is_storage()) {
            return Err(Error::usage("depth image", "one with a storage view", "one that is copied to"));
        }
        let slot = self.next_slot();
        let finished = self.collect(slot)?;
        let frame = self.prepare_frame(camera, time)?;
        let images = [Some(target.color), target.depth];
        let images = &images[..if self.options.depth { 2 } else { 1 }];
        self.with_updates(&frame, |sequence, updates| sequence.encode(commands, slot, updates, images))?;
        self.calls += 1;
        self.slots[slot as usize] = self.calls;
        Ok(Recorded { serial: self.calls, finished })
    }

    /// Makes buffers and pipelines for this size, and runs frames on the engine's queue, without an image, until one fits
    /// its buffers. Blocks; nothing that this view recorded may be in flight.
    ///
    /// # Errors
    /// As [`View::record`].
    pub fn warm_up(&mut self, camera: &Camera, time: f64) -> Result<FrameStatistics> {
        self.all_finished()?;
        loop {
            let slot = self.next_slot();
            let frame = self.prepare_frame(camera, time)?;
            let gpu = self.gpu.clone();
            self.with_updates(&frame, |sequence, updates| gpu.execute(sequence, slot, updates))?;
            self.calls += 1;
            self.slots[slot as usize] = self.calls;
            if let Some(Finished { overflowed: false, statistics, .. }) = self.all_finished()? {
                return Ok(statistics);
            }
        }
    }

    /// Says that everything recorded so far has finished (or will never be executed): counters are looked at and replaced
    /// buffers freed. Returns the latest frame that was executed.
    ///
    /// # Errors
    /// `Limit` when one of the frames needed more tile instances than allowed.
    pub fn all_finished(&mut self) -> Result<Option<Finished>> {
        self.retired.clear();
        let mut latest: Option<Finished> = None;
        for slot in 0..self.options.in_flight {
            if let Some(finished) = self.collect(slot)?
                && latest.is_none_or(|l| l.serial < finished.serial)
            {
                latest = Some(finished);
            }
        }
        Ok(latest)
    }

    /// Shows another scene from the next call on.
    pub fn set_scene(&mut self, scene: &SceneHandle) {
        self.scene = scene.clone();
        let limit = capacity::limit(&self.gpu, self.options.max_instances);
        self.capacity = self.capacity.max(capacity::first(scene.gaussians())).min(limit);
        self.retire();
    }

    /// Another background from the next call on.
    pub fn set_background(&mut self, background: [f32; 3]) {
        self.options.background = background;
    }

    /// The latest frame that is known to have finished.
    pub fn finished(&self) -> Option<Finished> {
        self.finished
    }

    /// Device times of the operations of the latest finished frame; empty without [`ViewOptions::profile`], and after the
    /// buffers were replaced.
    pub fn timings(&self) -> Result<Vec<Timing>> {
        match (&self.targets, self.finished) {
            (Some(targets), Some(finished)) => {
                targets.sequence.timings(((finished.serial - 1) % u64::from(self.options.in_flight)) as u32)
            }
            _ => Ok(Vec::new()),
        }
    }

    /// The recorded operations of the current image size, for plans and counts; `None` before the first frame.
    pub fn sequence(&self) -> Option<&Sequence> {
        self.targets.as_ref().map(|t| &t.sequence)
    }

    /// Device memory in use, the scene's (which other views may share) and that of replaced buffers included.
    pub fn memory(&self) -> MemoryUse {
        let mut used = MemoryUse { scene: self.scene.bytes(), ..MemoryUse::default() };
        for targets in self.targets.iter().chain(self.retired.iter().map(|(_, t)| t)) {
            let (gaussians, instances) = targets.work.bytes();
            used.per_gaussian += gaussians;
            used.per_instance += instances;
            used.images += targets.buffers.color.bytes() + targets.buffers.depth.bytes();
        }
        used.instance_capacity = self.targets.as_ref().map_or(0, |t| t.capacity.into());
        used
    }

    fn next_slot(&self) -> u32 {
        (self.calls % u64::from(self.options.in_flight)) as u32
    }

    /// Looks at the counters of a place in the ring whose frame has finished, and grows when it overflowed.
    fn collect(&mut self, slot: u32) -> Result<Option<Finished>> {
        let serial = std::mem::take(&mut self.slots[slot as usize]);
        // Of this call and those before nothing is in use any more.
        while self.retired.front().is_some_and(|(last, _)| *last <= serial) {
            self.retired.pop_front();
        }
        let (mut counters, mut executed) = ([0; COUNTER_BYTES as usize], [0; 8]);
        let at = u64::from(slot) * RING_BYTES;
        self.ring.read(at, &mut counters)?;
        self.ring.read(at + COUNTER_BYTES, &mut executed)?;
        if serial == 0 || u64::from_le_bytes(executed) != serial {
            return Ok(None);
        }
        let counted = capacity::counted(&counters);
        let (overflowed, statistics) = (counted.overflowed, counted.statistics);
        let finished = Finished { serial, statistics, overflowed };
        if self.finished.is_none_or(|f| f.serial < serial) {
            self.finished = Some(finished);
        }
        if overflowed {
            let limit = capacity::limit(&self.gpu, self.options.max_instances);
            let grown = capacity::grown(self.capacity, statistics.instances, limit, self.scene.gaussians())?;
            // A frame of before the last growth asks for nothing new.
            self.capacity = grown.max(self.capacity);
        }
        Ok(Some(finished))
    }

    /// Makes sure of buffers for this camera, and says what the kernels see of it.
    fn prepare_frame(&mut self, camera: &Camera, time: f64) -> Result<Frame> {
        let options = FrameOptions {
            background: self.options.background,
            near: self.options.near,
            time,
            ..FrameOptions::default()
        };
        let mut frame = self.scene.buffers.frame(camera, options, self.scene.quality.depth_bits)?;
        let (size, capacity) = ([camera.width, camera.height], self.capacity as u32);
        if !self.targets.as_ref().is_some_and(|t| t.size == size && t.capacity == capacity) {
            let made = self.make_targets(size, capacity)?;
            self.retire();
            self.targets = Some(made);
        }
        self.scene.buffers.write_host_poses(time, &mut self.host_pose);
        frame.limits[0] = capacity;
        Ok(frame)
    }

    fn with_updates(&self, frame: &Frame, encode: impl FnOnce(&Sequence, &[&[u8]]) -> Result<()>) -> Result<()> {
        let Some(targets) = &self.targets else {
            return Err(Error::usage("view", "no buffers", "buffers of the camera's size"));
        };
        let serial = (self.calls + 1).to_le_bytes();
        let (frame, pose): (&[u8], &[u8]) = (bytemuck::bytes_of(frame), bytemuck::cast_slice(&self.host_pose));
        if targets.buffers.host_pose.is_some() {
            encode(&targets.sequence, &[frame, pose, &serial])
        } else {
            encode(&targets.sequence, &[frame, &serial])
        }
    }

    fn retire(&mut self) {
        if let Some(old) = self.targets.take() {
            self.retired.push_back((self.calls, old));
        }
    }

    fn make_targets(&self, [width, height]: [u32; 2], capacity: u32) -> Result<Targets> {
        let scene = &*self.scene.buffers;
        let tiles = width.div_ceil(TILE_SIZE) * height.div_ceil(TILE_SIZE);
        let pixels = u64::from(width) * u64::from(height);
        let quality = self.scene.quality;
        let work = WorkBuffers::with_depth_bits(&self.gpu, scene.gaussians, tiles, capacity, quality.depth_bits)?;
        let device = |name: &str, bytes: u64| self.gpu.buffer(name, bytes, Memory::Device);
        let host_pose = matches!(scene.poses, Poses::Host(..));
        let pose_bytes = u64::from(scene.superpoints) * 32;
        let buffers = FrameBuffers {
            frame: device("frame", size_of::<Frame>() as u64)?,
            host_pose: host_pose.then(|| device("pose", pose_bytes)).transpose()?,
            color: device("pixels", if self.options.storage { 16 } else { pixels * self.options.format.bytes() })?,
            depth: device("depth", if self.options.depth { pixels * 4 } else { 16 })?,
            counters: self.ring.clone(),
        };
        let format = Some(self.options.format);
        let (with_depth, to_image) = (self.options.depth, self.options.storage);
        let shape = Shape { tiles, with_depth, quality, format, to_image, ..Shape::default() };
        let sequence = self.sequence_of([width, height], scene, &work, &buffers, &shape)?;
        Ok(Targets { size: [width, height], capacity, work, buffers, sequence })
    }

    /// The frame with what a host's command buffer adds: camera and poses come with the commands, pixels and counters go.
    fn sequence_of(
        &self,
        size: [u32; 2],
        scene: &SceneBuffers,
        work: &WorkBuffers,
        buffers: &FrameBuffers,
        shape: &Shape,
    ) -> Result<Sequence> {
        let pixels = u64::from(size[0]) * u64::from(size[1]);
        let mut r = self.gpu.recorder("embedded frame").with_timestamps(self.options.profile);
        r.update(buffers.frame.slice(0, size_of::<Frame>() as u64), 0)?;
        if let Some(pose) = &buffers.host_pose {
            r.update(pose.slice(0, u64::from(scene.superpoints) * 32), 0)?;
        }
        record_forward(&self.gpu, &mut r, scene, work, buffers, shape)?;
        let pixel_bytes = self.options.format.bytes();
        if !shape.to_image {
            r.copy_to_image(buffers.color.slice(0, pixels * pixel_bytes), size, pixel_bytes)?;
        }
        if shape.with_depth {
            r.copy_to_image(buffers.depth.slice(0, pixels * 4), size, 4)?;
        }
        r.copy_to_slot(&work.counters, self.ring.slice(0, COUNTER_BYTES), RING_BYTES)?;
        r.update(self.ring.slice(COUNTER_BYTES, 8), RING_BYTES)?;
        r.host_read(&self.ring);
        r.finish_sequence(self.options.in_flight)
    }
}
