//! Recording frames into a host's command buffers.

use std::collections::VecDeque;

use super::super::capacity::{self, Capacity, Lists};
use super::super::frame::{Frame, FrameOptions};
use super::super::pipeline::{FrameBuffers, Shape, record_forward};
use super::super::renderer::{FrameStatistics, MemoryUse};
use super::super::scene_buffers::SceneBuffers;
use super::super::tiles::tiles_of;
use super::super::work_buffers::{COUNTER_WORDS, WorkBuffers};
use super::check;
use super::options::{Finished, MAX_IN_FLIGHT, Recorded, Target, ViewOptions};
use super::scene::SceneHandle;
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Gpu, HostCommandBuffer, Memory, Sequence, Suite, Timing};
use crate::scene::Camera;

/// Bytes of the counters in their ring, and of one place of it: counters, then the serial number of the frame.
const COUNTER_BYTES: u64 = COUNTER_WORDS * 4;
const RING_BYTES: u64 = 64;

/// Whose counters a place of the ring gets.
#[derive(Debug, Clone, Copy, Default)]
struct Place {
    /// Which writing of the commands, for a host or for warming up, counted from 1; 0: none. The device writes it into the ring,
    /// too, which says that the commands were executed.
    encoding: u64,
    /// Which call of [`View::record`], counted from 1; 0: it warmed up.
    serial: u64,
}

/// Everything that depends on image size and capacity.
#[derive(Debug)]
struct Targets {
    size: [u32; 2],
    lists: Lists,
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
    /// Replaced targets and the last encoding that used them.
    retired: VecDeque<(u64, Targets)>,
    ring: Buffer,
    places: [Place; MAX_IN_FLIGHT as usize],
    capacity: Capacity,
    /// How often commands were written.
    encodings: u64,
    /// Calls of `record`.
    records: u64,
    /// The latest encoding that is known to have finished; 0: none.
    latest: u64,
    /// The latest of `record`'s.
    finished: Option<Finished>,
    host_pose: Vec<[f32; 4]>,
}

impl View {
    /// A view; buffers come with its first size.
    ///
    /// # Errors
    /// `Usage` or `NonFinite` for options without sense, `Usage` for a scene of another [`Gpu`], `OutOfMemory`.
    pub fn new(gpu: &Gpu, scene: &SceneHandle, options: &ViewOptions) -> Result<Self> {
        check::options(options)?;
        check::scene(gpu, scene)?;
        gpu.ready_for(Suite::Packed)?;
        let ring = gpu.buffer("counter ring", RING_BYTES * u64::from(options.in_flight), Memory::Readback)?;
        ring.write_readback(0, &vec![0; ring.bytes() as usize])?;
        let capacity = Capacity::new(gpu, scene.buffers.gaussians, options.max_instances);
        Ok(Self {
            gpu: gpu.clone(),
            scene: scene.clone(),
            options: options.clone(),
            targets: None,
            retired: VecDeque::new(),
            ring,
            places: [Place::default(); MAX_IN_FLIGHT as usize],
            capacity,
            encodings: 0,
            records: 0,
            latest: 0,
            finished: None,
            host_pose: Vec::new(),
        })
    }

    /// Records a frame at `time` into a host's command buffer. See the [module's page](super) for what happens around it.
    ///
    /// `time` has the unit of the scene's motion ([`Extent::times`](super::Extent)) and may be any number that is finite as `f32`:
    /// before the first key of a table and after the last the pose there is held; a network or a deformation field is
    /// evaluated at that very time, about which training said nothing beyond 0 and 1.
    ///
    /// # Errors
    /// Nothing is recorded then. `Limit` when a finished frame needed more tile instances than the device or the options
    /// allow; `NonFinite` or `Usage` for a senseless camera (whose rotation must be one, within 0.001) or a target that does not fit
    /// the options; `OutOfMemory`.
    pub fn record(
        &mut self,
        commands: &HostCommandBuffer,
        camera: &Camera,
        time: f64,
        target: &Target,
    ) -> Result<Recorded> {
        check::target(target, &self.options)?;
        let slot = self.next_slot();
        let finished = self.collect(slot)?;
        let frame = self.prepare_frame(camera, time)?;
        let images = [Some(target.color), target.depth];
        let images = &images[..if self.options.depth { 2 } else { 1 }];
        self.with_updates(&frame, |sequence, updates| sequence.encode(commands, slot, updates, images))?;
        self.records += 1;
        self.encoded(slot, self.records);
        Ok(Recorded { serial: self.records, finished })
    }

    /// Makes buffers and pipelines for this size, and runs frames on the engine's queue, without an image, until one fits
    /// its buffers. Blocks; nothing that this view recorded may be in flight. These frames have no serial number.
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
            self.encoded(slot, 0);
            if let Some(Finished { overflowed: false, statistics, .. }) = self.collect(slot)? {
                return Ok(statistics);
            }
        }
    }

    /// Makes buffers and pipelines for this size without running anything. A first frame that needs more tile instances than
    /// there is room for by then is incomplete; [`View::warm_up`] prevents that.
    ///
    /// # Errors
    /// As [`View::record`].
    pub fn prepare(&mut self, camera: &Camera, time: f64) -> Result<()> {
        self.prepare_frame(camera, time).map(|_| ())
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
    ///
    /// # Errors
    /// `Usage` for a scene of another [`Gpu`]; the view keeps the one it has.
    pub fn set_scene(&mut self, scene: &SceneHandle) -> Result<()> {
        check::scene(&self.gpu, scene)?;
        self.scene = scene.clone();
        self.capacity.set_gaussians(scene.buffers.gaussians);
        self.retire();
        Ok(())
    }

    /// Another background from the next call on, which refuses one that is not finite.
    pub fn set_background(&mut self, background: [f32; 3]) {
        self.options.background = background;
    }

    /// The latest frame of [`View::record`] that is known to have finished.
    pub fn finished(&self) -> Option<Finished> {
        self.finished
    }

    /// Device times of the operations of the latest finished frame, one of warming up included; empty without
    /// [`ViewOptions::profile`], and after the buffers were replaced.
    pub fn timings(&self) -> Result<Vec<Timing>> {
        match (&self.targets, self.latest.checked_sub(1)) {
            (Some(targets), Some(before)) => {
                targets.sequence.timings((before % u64::from(self.options.in_flight)) as u32)
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
            used.images += targets.buffers.image_bytes();
        }
        used.instance_capacity = self.targets.as_ref().map_or(0, |t| t.lists.instances.into());
        used
    }

    fn next_slot(&self) -> u32 {
        (self.encodings % u64::from(self.options.in_flight)) as u32
    }

    /// Commands were written whose counters go into this place of the ring; `serial` 0: to warm up.
    fn encoded(&mut self, slot: u32, serial: u64) {
        self.encodings += 1;
        self.places[slot as usize] = Place { encoding: self.encodings, serial };
    }

    /// Looks at the counters of a place in the ring whose frame has finished, and grows when it overflowed.
    fn collect(&mut self, slot: u32) -> Result<Option<Finished>> {
        let Place { encoding, serial } = std::mem::take(&mut self.places[slot as usize]);
        // Of these commands and those before nothing is in use any more.
        while self.retired.front().is_some_and(|(last, _)| *last <= encoding) {
            self.retired.pop_front();
        }
        let (mut counters, mut executed) = ([0; COUNTER_BYTES as usize], [0; 8]);
        let at = u64::from(slot) * RING_BYTES;
        self.ring.read(at, &mut counters)?;
        self.ring.read(at + COUNTER_BYTES, &mut executed)?;
        if encoding == 0 || u64::from_le_bytes(executed) != encoding {
            return Ok(None);
        }
        let counted = capacity::counted(&counters);
        let (overflowed, statistics) = (counted.overflowed, counted.statistics);
        let finished = Finished { serial, statistics, overflowed };
        self.latest = self.latest.max(encoding);
        if serial > self.finished.map_or(0, |f| f.serial) {
            self.finished = Some(finished);
        }
        self.capacity.learn(&counted)?;
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
        let mut frame = self.scene.buffers.frame(camera, options)?;
        check::rigid(camera)?;
        let size = [camera.width, camera.height];
        let mut lists = self.capacity.lists(tiles_of(size));
        if !self.targets.as_ref().is_some_and(|t| t.size == size && t.lists == lists) {
            let made = match self.make_targets(size, lists) {
                Err(Error::OutOfMemory { .. }) if self.capacity.pack(tiles_of(size)) => {
                    lists = self.capacity.lists(tiles_of(size));
                    self.make_targets(size, lists)?
                }
                made => made?,
            };
            self.retire();
            self.targets = Some(made);
        }
        let scene = &self.scene.buffers;
        scene.deformation.poses.write(time, scene.origin, &mut self.host_pose);
        lists.tell(&mut frame);
        Ok(frame)
    }

    fn with_updates(&self, frame: &Frame, encode: impl FnOnce(&Sequence, &[&[u8]]) -> Result<()>) -> Result<()> {
        let Some(targets) = &self.targets else {
            return Err(Error::usage("view", "no buffers", "buffers of the camera's size"));
        };
        let encoding = (self.encodings + 1).to_le_bytes();
        let (frame, pose): (&[u8], &[u8]) = (bytemuck::bytes_of(frame), bytemuck::cast_slice(&self.host_pose));
        if targets.buffers.host_pose.is_some() {
            encode(&targets.sequence, &[frame, pose, &encoding])
        } else {
            encode(&targets.sequence, &[frame, &encoding])
        }
    }

    fn retire(&mut self) {
        if let Some(old) = self.targets.take() {
            self.retired.push_back((self.encodings, old));
        }
    }

    fn make_targets(&self, [width, height]: [u32; 2], lists: Lists) -> Result<Targets> {
        let scene = &*self.scene.buffers;
        let tiles = tiles_of([width, height]);
        let pixels = u64::from(width) * u64::from(height);
        let quality = self.scene.quality;
        let work = WorkBuffers::new(&self.gpu, scene.gaussians, tiles, lists.instances)?;
        let device = |name: &str, bytes: u64| self.gpu.buffer(name, bytes, Memory::Device);
        let buffers = FrameBuffers {
            frame: device("frame", size_of::<Frame>() as u64)?,
            host_pose: scene.deformation.host_pose_bytes().map(|bytes| device("pose", bytes)).transpose()?,
            color: device("pixels", if self.options.storage { 16 } else { pixels * self.options.format.bytes() })?,
            depth: self.options.depth.then(|| device("depth", pixels * 4)).transpose()?,
            counters: self.ring.clone(),
        };
        let format = Some(self.options.format);
        let (with_depth, to_image, tile_room) = (self.options.depth, self.options.storage, lists.tile_room);
        let shape = Shape { tiles, tile_room, with_depth, quality, format, to_image, ..Shape::default() };
        let sequence = self.sequence_of([width, height], scene, &work, &buffers, &shape)?;
        Ok(Targets { size: [width, height], lists, work, buffers, sequence })
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
            r.update(pose.slice(0, u64::from(scene.deformation.superpoints) * 32), 0)?;
        }
        record_forward(&self.gpu, &mut r, scene, work, buffers, shape)?;
        let pixel_bytes = self.options.format.bytes();
        if !shape.to_image {
            r.copy_to_image(buffers.color.slice(0, pixels * pixel_bytes), size, pixel_bytes)?;
        }
        if let Some(depth) = &buffers.depth {
            r.copy_to_image(depth.slice(0, pixels * 4), size, 4)?;
        }
        r.copy_to_slot(&work.counters, self.ring.slice(0, COUNTER_BYTES), RING_BYTES)?;
        r.update(self.ring.slice(COUNTER_BYTES, 8), RING_BYTES)?;
        r.host_read(&self.ring);
        r.finish_sequence(self.options.in_flight)
    }
}
