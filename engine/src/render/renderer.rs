//! The renderer's public face: options, frames in flight, growth, read-back.

mod live;

use std::borrow::Cow;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::error::{Error, Result};
use crate::gpu::kernel::Workload;
use crate::gpu::{Buffer, Commands, Gpu, Memory, Suite, Timing};
use crate::image::Image;
use crate::scene::{Camera, MotionSource, Rejected, Scene};

use super::capacity::{self, Capacity, Lists};
use super::frame::{Frame, FrameOptions};
use super::mean_storage;
use super::pipeline::{self, FrameBuffers, Shape};
use super::quality::Quality;
use super::scene_buffers::SceneBuffers;
use super::splat::splat_words;
use super::tiles::tiles_of;
use super::work_buffers::{COUNTER_WORDS, WorkBuffers};

pub use live::Picked;

/// Submissions of one renderer that may be in flight.
const FRAMES_IN_FLIGHT: usize = 2;
/// Frames that one submission draws side by side, at most.
pub const MOST_BESIDE: usize = 4;
/// Number of the next targets that any renderer makes; 0 is for none.
static NEXT_GENERATION: AtomicU64 = AtomicU64::new(1);

/// What to draw and how.
#[derive(Debug, Clone)]
pub struct RenderOptions {
    /// Colour behind everything.
    pub background: [f32; 3],
    /// Gaussians at camera depth z ≤ near are not drawn; world units.
    pub near: f32,
    /// Whether the weighted depth is rendered too.
    pub depth: bool,
    /// Where the poses of a moving scene come from.
    pub motion: MotionSource,
    /// What may be given up for speed.
    pub quality: Quality,
    /// Largest number of tile instances; `None`: what the device's buffers can hold.
    pub max_instances: Option<u64>,
    /// Whether timestamps are taken around every operation.
    pub profile: bool,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self {
            background: [0.0; 3],
            near: 0.2,
            depth: false,
            motion: MotionSource::Auto,
            quality: Quality::EXACT,
            max_instances: None,
            profile: false,
        }
    }
}

/// What a finished frame counted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct FrameStatistics {
    /// Gaussians that touch the image.
    pub visible: u32,
    /// (Gaussian, tile) pairs.
    pub instances: u64,
    /// Gaussians refused on the device because a derived value was not finite (those refused on upload included).
    pub rejected: u32,
}

/// Device memory of a renderer, bytes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct MemoryUse {
    /// The model.
    pub scene: u64,
    /// Intermediate buffers that grow with the number of Gaussians.
    pub per_gaussian: u64,
    /// Intermediate buffers that grow with the number of tile instances.
    pub per_instance: u64,
    /// Images of all frames in flight.
    pub images: u64,
    /// Tile instances that the buffers hold.
    pub instance_capacity: u64,
}

/// A frame in flight; see [`Renderer::submit`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameId(u64);

/// Frames that one submission draws side by side.
#[derive(Debug)]
struct Batch {
    commands: Commands,
    slots: Vec<Slot>,
}

#[derive(Debug)]
struct Slot {
    buffers: FrameBuffers,
    frame: u64,
    /// Size that the caller asked for.
    asked: [u32; 2],
    /// Size that is rendered.
    size: [u32; 2],
}

/// Everything that depends on image size and capacity.
#[derive(Debug)]
struct Targets {
    /// Size that the caller asked for.
    asked: [u32; 2],
    /// Largest size that was rendered for it: what the buffers and the recorded commands have room for. Smaller frames use them as
    /// they are, so that the resolution may change from frame to frame.
    room: [u32; 2],
    /// Size of the latest frame.
    size: [u32; 2],
    lists: Lists,
    /// Of the frames of a batch: as many as were drawn side by side.
    work: Vec<WorkBuffers>,
    /// Batches of one frame, and of more where there were some.
    batches: [Vec<Batch>; MOST_BESIDE],
    /// Which of `work` the latest frame used.
    latest: usize,
    readback: Option<Buffer>,
}

impl Targets {
    fn slots(&self) -> impl Iterator<Item = &Slot> {
        self.batches.iter().flatten().flat_map(|batch| &batch.slots)
    }
}

/// Renders one scene.
#[derive(Debug)]
pub struct Renderer {
    gpu: Gpu,
    options: RenderOptions,
    scene: SceneBuffers,
    targets: Option<Targets>,
    capacity: Capacity,
    frames: u64,
    submissions: u64,
    /// Number of the targets among those of all renderers.
    generation: u64,
    /// Poses of the latest frame, when the host makes them.
    host_pose: Vec<[f32; 4]>,
    /// Somebody was told of Gaussians that a frame refused.
    warned: bool,
}

impl Renderer {
    /// Uploads a scene. Invalid Gaussians (see [`crate::scene::Gaussians::is_valid`]) are counted and never shown.
    ///
    /// # Errors
    /// `Usage` for an inconsistent scene or a motion source that it lacks, `Limit` and `OutOfMemory` when it does not fit.
    pub fn new(gpu: &Gpu, scene: &Scene, options: &RenderOptions) -> Result<Self> {
        let options = RenderOptions { quality: options.quality.for_scene(scene), ..options.clone() };
        if options.depth {
            gpu.ready_for(Suite::Packed)?;
        }
        let scene = SceneBuffers::new(gpu, scene, options.motion, &options.quality)?;
        let capacity = Capacity::new(gpu, scene.gaussians, options.max_instances);
        let gpu = gpu.clone();
        let host_pose = Vec::new();
        Ok(Self {
            gpu,
            options,
            scene,
            targets: None,
            capacity,
            frames: 0,
            submissions: 0,
            host_pose,
            generation: 0,
            warned: false,
        })
    }

    /// The knobs in use: those asked for, as the scene bears them ([`Quality::for_scene`]).
    pub fn quality(&self) -> &Quality {
        &self.options.quality
    }

    /// Gaussians refused on upload, by reason.
    pub fn rejected(&self) -> Rejected {
        self.scene.rejected
    }

    /// Renders one view at `time` (unit of the motion table) and reads it back.
    ///
    /// # Errors
    /// `Limit` when the view needs more tile instances than the device or the options allow; `NonFinite` or `Usage` for
    /// a senseless camera; `OutOfMemory`; `DeviceLost`.
    pub fn render(&mut self, camera: &Camera, time: f64) -> Result<Image> {
        let (frame, _) = self.draw(camera, time)?;
        self.read(frame)
    }

    /// Renders one view, growing the buffers until it fits, and leaves the image on the device.
    pub fn draw(&mut self, camera: &Camera, time: f64) -> Result<(FrameId, FrameStatistics)> {
        loop {
            let frame = self.submit(camera, time)?;
            if let Some(statistics) = self.finish(frame)? {
                return Ok((frame, statistics));
            }
        }
    }

    /// Starts a frame without waiting for it, unless [`Renderer::frames_in_flight`] are running already.
    pub fn submit(&mut self, camera: &Camera, time: f64) -> Result<FrameId> {
        self.submit_batch([(camera, time)]).map(|[frame]| frame)
    }

    /// Starts frames of one size, at most [`MOST_BESIDE`], that the device draws side by side: what one leaves idle another uses,
    /// and all wait for each stage once. For the two eyes of a stereo image, or for frames one after the other; the images are
    /// those of [`Renderer::submit`]. Each needs work buffers of its own. Together they count as one of
    /// [`Renderer::frames_in_flight`].
    ///
    /// # Errors
    /// As [`Renderer::submit`]; `Usage` for images of two sizes, or another number of them.
    pub fn submit_beside<const K: usize>(&mut self, views: [(&Camera, f64); K]) -> Result<[FrameId; K]> {
        if !(1..=MOST_BESIDE).contains(&K) {
            return Err(Error::usage("frames side by side", K.to_string(), format!("1 to {MOST_BESIDE}")));
        }
        let mut sizes = views.iter().map(|(camera, _)| [camera.width, camera.height]);
        let first = sizes.next().unwrap_or_default();
        if let Some(other) = sizes.find(|size| *size != first) {
            return Err(Error::usage("size of an image", format!("{other:?}"), format!("{first:?} as the first")));
        }
        self.submit_batch(views)
    }

    fn submit_batch<const K: usize>(&mut self, views: [(&Camera, f64); K]) -> Result<[FrameId; K]> {
        let mut ids = [FrameId(0); K];
        let mut frames = [Frame::default(); K];
        let (mut asked, mut size) = ([0; 2], [0; 2]);
        for (frame, (camera, time)) in frames.iter_mut().zip(views) {
            asked = [camera.width, camera.height];
            let camera = &*self.drawn(camera);
            size = [camera.width, camera.height];
            *frame = self.frame(camera, time)?;
        }
        self.prepare(size, asked, K)?;
        let Some(targets) = &mut self.targets else {
            return Err(Error::usage("renderer", "no targets", "targets after prepare"));
        };
        let batch = &mut targets.batches[K - 1][self.submissions as usize % FRAMES_IN_FLIGHT];
        self.gpu.wait_for(&batch.commands)?;
        for ((slot, frame), (_, time)) in batch.slots.iter().zip(&mut frames).zip(views) {
            targets.lists.tell(frame);
            slot.buffers.frame.write(0, bytemuck::bytes_of(frame))?;
            if let Some(buffer) = &slot.buffers.host_pose {
                self.scene.deformation.poses.write(time, self.scene.origin, &mut self.host_pose);
                buffer.write(0, bytemuck::cast_slice(&self.host_pose))?;
            }
        }
        self.gpu.submit(&mut batch.commands)?;
        self.submissions += 1;
        for (slot, id) in batch.slots.iter_mut().zip(&mut ids) {
            self.frames += 1;
            *id = FrameId(self.frames);
            (slot.frame, slot.asked, slot.size) = (self.frames, asked, size);
        }
        targets.latest = K - 1;
        Ok(ids)
    }

    /// Waits for a frame. `None`: it needed more tile instances than there was room for; its image is invalid, the
    /// buffers are grown for the next try.
    pub fn finish(&mut self, frame: FrameId) -> Result<Option<FrameStatistics>> {
        let (batch, slot) = self.slot(frame)?;
        self.gpu.wait_for(&batch.commands)?;
        let mut bytes = [0_u8; COUNTER_WORDS as usize * 4];
        slot.buffers.counters.read(0, &mut bytes)?;
        let counted = capacity::counted(&bytes);
        if counted.overflowed {
            self.capacity.learn(&counted)?;
            return Ok(None);
        }
        let refused = u64::from(counted.statistics.rejected).saturating_sub(self.scene.rejected.total() as u64);
        if refused > 0 && !std::mem::replace(&mut self.warned, true) {
            log::warn!("{refused} Gaussians are left out of an image: their place or shape is not finite there");
        }
        Ok(Some(counted.statistics))
    }

    /// Reads the image of a finished frame, in the size that was asked for: one that was rendered smaller (see
    /// [`Quality::resolution`]) is enlarged bilinearly.
    pub fn read(&mut self, frame: FrameId) -> Result<Image> {
        let (_, slot) = self.slot(frame)?;
        let (color, depth) = (slot.buffers.color.clone(), slot.buffers.depth.clone());
        let (asked, size) = (slot.asked, slot.size);
        let Some(targets) = &mut self.targets else {
            return Err(Error::usage("renderer", "no targets", "a finished frame"));
        };
        let [width, height] = size;
        let pixels = width as usize * height as usize;
        let (color_bytes, depth_bytes) = (pixels as u64 * 16, if depth.is_some() { pixels as u64 * 4 } else { 0 });
        let readback = match &targets.readback {
            Some(buffer) => buffer.clone(),
            None => {
                let room = u64::from(targets.room[0]) * u64::from(targets.room[1]);
                let bytes = room * if depth.is_some() { 20 } else { 16 };
                targets.readback.insert(self.gpu.buffer("image readback", bytes, Memory::Readback)?).clone()
            }
        };
        let mut recorder = self.gpu.recorder("read image");
        recorder.copy(color.slice(0, color_bytes), readback.slice(0, color_bytes))?;
        if let Some(depth) = &depth {
            recorder.copy(depth.slice(0, depth_bytes), readback.slice(color_bytes, depth_bytes))?;
        }
        recorder.host_read(&readback);
        self.gpu.run(recorder)?;
        let mut image =
            Image { width, height, rgba: vec![0.0; pixels * 4], depth: vec![0.0; depth_bytes as usize / 4] };
        readback.read(0, bytemuck::cast_slice_mut(&mut image.rgba))?;
        readback.read(color_bytes, bytemuck::cast_slice_mut(&mut image.depth))?;
        Ok(if asked == [width, height] { image } else { image.enlarged(asked) })
    }

    /// How many submissions may be in flight.
    pub fn frames_in_flight(&self) -> usize {
        FRAMES_IN_FLIGHT
    }

    /// Device times of a finished frame's operations; empty unless [`RenderOptions::profile`].
    pub fn timings(&self, frame: FrameId) -> Result<Vec<Timing>> {
        self.slot(frame)?.0.commands.timings()
    }

    /// [`Renderer::timings`] one by one: label and microseconds. Allocates nothing.
    pub fn each_timing(&self, frame: FrameId, each: impl FnMut(&str, f64)) -> Result<()> {
        self.slot(frame)?.0.commands.each_timing(each)
    }

    /// The recorded commands of a frame, which are those of both frames of a pair.
    pub fn commands_of(&self, frame: FrameId) -> Result<&Commands> {
        Ok(&self.slot(frame)?.0.commands)
    }

    /// The recorded commands of the current image size, for plans and counts; `None` before the first frame.
    pub fn commands(&self) -> Option<&Commands> {
        self.targets.as_ref().and_then(|t| t.batches[0].first()).map(|batch| &batch.commands)
    }

    /// Amounts of work of a frame, from which kernels derive the bytes that they move.
    pub fn workload(&self, statistics: &FrameStatistics) -> Workload {
        let size = self.targets.as_ref().map_or([0, 0], |t| t.size);
        let tile_room = self.targets.as_ref().map_or(0, |t| t.lists.tile_room);
        Workload(
            [
                ("gaussians", u64::from(self.scene.gaussians)),
                ("superpoints", u64::from(self.scene.deformation.superpoints)),
                ("visible", u64::from(statistics.visible)),
                ("instances", statistics.instances),
                ("tiles", tiles_of(size).into()),
                ("tile_room", tile_room.into()),
                ("pixels", u64::from(size[0]) * u64::from(size[1])),
                ("sh_degree", u64::from(self.scene.sh_degree)),
                ("sh_coefficients", u64::from((self.scene.sh_degree + 1) * (self.scene.sh_degree + 1))),
                ("moving", u64::from(self.scene.deformation.moves())),
                ("depth", u64::from(self.options.depth)),
                ("network_bytes", self.scene.deformation.poses.network_bytes()),
                ("network_products", self.scene.deformation.poses.network_products()),
                ("splat_bytes", 4 * splat_words(self.options.quality.packing_constant()) as u64),
                ("mean_bytes", mean_storage::bytes(self.options.quality.position)),
                ("sh_bytes", self.scene.sh_bytes()),
            ]
            .into_iter()
            .collect(),
        )
    }

    /// Device memory in use.
    pub fn memory(&self) -> MemoryUse {
        let mut used = MemoryUse { scene: self.scene.bytes(), ..MemoryUse::default() };
        if let Some(targets) = &self.targets {
            for (gaussians, instances) in targets.work.iter().map(WorkBuffers::bytes) {
                used.per_gaussian += gaussians;
                used.per_instance += instances;
            }
            used.images = targets.slots().map(|s| s.buffers.image_bytes()).sum();
            used.instance_capacity = targets.lists.instances.into();
        }
        used
    }

    /// The camera of the image that is rendered: smaller by the resolution knob.
    fn drawn<'a>(&self, camera: &'a Camera) -> Cow<'a, Camera> {
        let scale = f64::from(self.options.quality.resolution);
        if scale >= 1.0 {
            return Cow::Borrowed(camera);
        }
        let side = |s: u32| ((f64::from(s) * scale).round() as u32).max(1);
        // A senseless camera keeps its size, so that the frame says what is wrong with it.
        if camera.width == 0 || camera.height == 0 {
            return Cow::Borrowed(camera);
        }
        Cow::Owned(camera.resized(side(camera.width), side(camera.height)))
    }

    fn slot(&self, frame: FrameId) -> Result<(&Batch, &Slot)> {
        let batches = self.targets.iter().flat_map(|t| t.batches.iter().flatten());
        let mut slots = batches.flat_map(|batch| batch.slots.iter().map(move |slot| (batch, slot)));
        slots.find(|(_, slot)| slot.frame == frame.0 && frame.0 != 0).ok_or_else(|| {
            Error::usage("frame", format!("{}", frame.0), format!("one of the last {FRAMES_IN_FLIGHT} submissions"))
        })
    }

    fn frame(&self, camera: &Camera, time: f64) -> Result<Frame> {
        let options = FrameOptions {
            background: self.options.background,
            near: self.options.near,
            time,
            ..FrameOptions::default()
        };
        self.scene.frame(camera, options)
    }

    /// Makes targets with room for this size and capacity, and batches of so many frames, where there are none. Where memory is short
    /// tile lists take less.
    fn prepare(&mut self, size: [u32; 2], asked: [u32; 2], beside: usize) -> Result<()> {
        match self.make_room(size, asked, beside) {
            Err(Error::OutOfMemory { .. }) if self.capacity.pack(tiles_of(size)) => {
                self.targets = None;
                self.make_room(size, asked, beside)
            }
            done => done,
        }
    }

    fn make_room(&mut self, size: [u32; 2], asked: [u32; 2], beside: usize) -> Result<()> {
        let has_room = |t: &Targets| {
            let lists = self.capacity.lists(tiles_of(t.room));
            t.lists == lists && t.asked == asked && (0..2).all(|k| size[k] <= t.room[k])
        };
        let mut targets = match self.targets.take() {
            Some(targets) if has_room(&targets) => Targets { size, ..targets },
            // Old buffers go before new ones come: the peak is the larger of the two, not the sum.
            old => {
                drop(old);
                self.generation = NEXT_GENERATION.fetch_add(1, Ordering::Relaxed);
                let (work, batches) = (Vec::new(), [const { Vec::new() }; MOST_BESIDE]);
                let lists = self.capacity.lists(tiles_of(size));
                let mut fresh = Targets { asked, room: size, size, lists, work, batches, latest: 0, readback: None };
                // The buffers of single frames are what windows know of.
                self.add_batches(&mut fresh, 1)?;
                fresh
            }
        };
        let is_new = targets.batches[beside - 1].is_empty();
        let added = if is_new { self.add_batches(&mut targets, beside) } else { Ok(()) };
        self.targets = Some(targets);
        added
    }

    fn add_batches(&self, targets: &mut Targets, beside: usize) -> Result<()> {
        let (tiles, lists) = (tiles_of(targets.room), targets.lists);
        let quality = self.options.quality;
        while targets.work.len() < beside {
            let work = WorkBuffers::new(&self.gpu, self.scene.gaussians, tiles, lists.instances)?;
            work.clear(&self.gpu)?;
            targets.work.push(work);
        }
        let (tile_room, with_depth) = (lists.tile_room, self.options.depth);
        let shape = Shape { tiles, tile_room, with_depth, cleared: true, quality, ..Shape::default() };
        let (room, asked) = (targets.room, targets.asked);
        let slot = |_| Ok(Slot { buffers: self.frame_buffers(room)?, frame: 0, asked, size: room });
        let batch = |_| {
            let slots = (0..beside).map(slot).collect::<Result<Vec<Slot>>>()?;
            let frames: Vec<_> = targets.work.iter().zip(slots.iter().map(|s| &s.buffers)).collect();
            let commands = pipeline::record(&self.gpu, &self.scene, &frames, &shape, self.options.profile)?;
            Ok(Batch { commands, slots })
        };
        targets.batches[beside - 1] = (0..FRAMES_IN_FLIGHT).map(batch).collect::<Result<_>>()?;
        Ok(())
    }

    fn frame_buffers(&self, size: [u32; 2]) -> Result<FrameBuffers> {
        let pixels = u64::from(size[0]) * u64::from(size[1]);
        let host_pose = self.scene.deformation.host_pose_bytes();
        let depth = self.options.depth.then(|| self.gpu.buffer("depth", pixels * 4, Memory::Device));
        Ok(FrameBuffers {
            frame: self.gpu.buffer("frame", size_of::<Frame>() as u64, Memory::Constants)?,
            host_pose: host_pose.map(|bytes| self.gpu.buffer("pose", bytes, Memory::Constants)).transpose()?,
            color: self.gpu.buffer("color", pixels * 16, Memory::Device)?,
            depth: depth.transpose()?,
            counters: self.gpu.buffer("counters readback", COUNTER_WORDS * 4, Memory::Readback)?,
        })
    }
}
