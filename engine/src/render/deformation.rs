//! What moves a scene, on the device. Every model ends in one or both of what `deform_project` reads: poses of superpoints
//! ([`Poses`]) and offsets of each Gaussian ([`Offsets`]), which are added after the pose. A model is a variant of one of them,
//! with its buffers and its recording in a module of its own.

mod poses;

use glam::DVec3;

use crate::error::Result;
use crate::gpu::{Buffer, Gpu, Memory, Recorder, Slice, Suite};
use crate::scene::{Deformation, KeyInterval, Motion, MotionSource, Scene};

use super::field::FieldBuffers;
use super::nonrigid_network::NonrigidBuffers;
use super::quality::Quality;
use super::scene_buffers::SceneBuffers;
use super::superpoint_motion::BlendSlices;

pub(crate) use poses::Poses;

/// Planes of the offsets `nonrigid_offset float[10][N]`: Δμ, Δq, Δs.
const OFFSET_PLANES: u64 = super::nonrigid_network::NONRIGID_PLANES as u64;

/// How offsets of each Gaussian reach the kernels.
#[derive(Debug)]
pub(crate) enum Offsets {
    /// There are none.
    None,
    /// Written by somebody else before the frame (training).
    Given(Slice),
    /// Network G runs on the device each frame.
    Network(NonrigidBuffers),
    /// So does a deformation field.
    Field(Box<FieldBuffers>),
}

/// A scene's model of motion on the device.
#[derive(Debug)]
pub(crate) struct DeformationBuffers {
    /// M; 0 when no superpoint moves.
    pub(crate) superpoints: u32,
    /// `uint[N]`.
    pub(crate) superpoint_of_gaussian: Buffer,
    /// Soft superpoints.
    pub(crate) blend: Option<BlendSlices>,
    /// `[T,M,2]` vec4 of the table, or `[M,2]` of the frame's time.
    pub(crate) pose: Buffer,
    pub(crate) poses: Poses,
    pub(crate) offsets: Offsets,
}

/// Asks whether the device does what the scene needs beyond exact frames of a table; `source` as
/// [`Deformation::motion_source`] gives it.
pub(crate) fn prove_device(gpu: &Gpu, scene: &Scene, source: Option<MotionSource>, quality: &Quality) -> Result<()> {
    let has_nonrigid = scene.deformation.nonrigid().is_some() && quality.nonrigid;
    if source == Some(MotionSource::Network) || has_nonrigid {
        gpu.ready_for(Suite::Networks)?;
    }
    if source.is_some() && scene.deformation.blend().is_some() {
        gpu.ready_for(Suite::Soft)?;
    }
    if scene.deformation.field().is_some() { gpu.ready_for(Suite::Fields) } else { Ok(()) }
}

/// The buffer that a model of `gaussians` Gaussians writes its offsets to.
pub(super) fn offset_buffer(gpu: &Gpu, gaussians: usize) -> Result<Buffer> {
    gpu.buffer("nonrigid_offset", gaussians.max(1) as u64 * 4 * OFFSET_PLANES, Memory::Device)
}

impl Offsets {
    fn new(gpu: &Gpu, scene: &Scene, quality: &Quality) -> Result<Self> {
        let n = scene.gaussians.len();
        let network = match &scene.deformation {
            Deformation::None => None,
            Deformation::Field(field) => return Ok(Self::Field(Box::new(FieldBuffers::new(gpu, field, n)?))),
            Deformation::Superpoints(s) => s.nonrigid.as_ref(),
            Deformation::Nonrigid(network) => Some(&**network),
        };
        match network.filter(|_| quality.nonrigid) {
            Some(network) => Ok(Self::Network(NonrigidBuffers::new(gpu, network, n)?)),
            None => Ok(Self::None),
        }
    }

    fn bytes(&self) -> u64 {
        match self {
            Self::None | Self::Given(_) => 0,
            Self::Network(network) => network.bytes(),
            Self::Field(field) => field.bytes(),
        }
    }
}

impl DeformationBuffers {
    /// Uploads the model; `source` as [`Deformation::motion_source`] gives it, `origin` what was subtracted from every centre.
    pub(crate) fn new(
        gpu: &Gpu,
        scene: &Scene,
        source: Option<MotionSource>,
        origin: DVec3,
        quality: &Quality,
    ) -> Result<Self> {
        let (pose, poses) = Poses::new(gpu, &scene.deformation, source, origin, quality)?;
        let of_gaussian = scene.deformation.superpoint_of_gaussian();
        let soft = scene.deformation.blend().filter(|_| poses.moves());
        let blend = soft.map(|b| BlendSlices::upload(gpu, b, scene.deformation.superpoint_count())).transpose()?;
        Ok(Self {
            blend,
            superpoints: if poses.moves() { scene.deformation.superpoint_count() as u32 } else { 0 },
            superpoint_of_gaussian: gpu.buffer_with("superpoint_of_gaussian", bytemuck::cast_slice(of_gaussian))?,
            pose,
            poses,
            offsets: Offsets::new(gpu, scene, quality)?,
        })
    }

    /// Nothing moves yet; every Gaussian has a superpoint for later.
    pub(crate) fn at_rest(gpu: &Gpu, superpoint_of_gaussian: &[u32]) -> Result<Self> {
        let bytes = bytemuck::cast_slice(superpoint_of_gaussian);
        Ok(Self {
            superpoints: 0,
            blend: None,
            superpoint_of_gaussian: gpu.buffer_with("superpoint_of_gaussian", bytes)?,
            pose: gpu.buffer("pose", 32, Memory::Device)?,
            poses: Poses::Static,
            offsets: Offsets::None,
        })
    }

    /// Nothing moves any more, until a model attaches its own buffers.
    pub(crate) fn rest(&mut self) {
        (self.superpoints, self.poses, self.offsets, self.blend) = (0, Poses::Static, Offsets::None, None);
    }

    /// Whether `deform_project` reads poses.
    pub(crate) fn moves(&self) -> bool {
        self.poses.moves()
    }

    /// K of soft superpoints, or 0.
    pub(crate) fn blend_slots(&self) -> u32 {
        self.blend.as_ref().map_or(0, |b| b.slots)
    }

    /// `uint[ceil(K/2)][N]` of soft superpoints.
    pub(crate) fn blend_index(&self) -> Option<Slice> {
        self.blend.as_ref().map(|b| b.index.clone())
    }

    /// `float[K-1][N]` of soft superpoints.
    pub(crate) fn blend_weight(&self) -> Option<Slice> {
        self.blend.as_ref().map(|b| b.weight.clone())
    }

    /// `uint[N]`, where each Gaussian moves with one superpoint.
    pub(crate) fn hard_superpoints(&self) -> Option<Slice> {
        (self.moves() && self.blend.is_none()).then(|| self.superpoint_of_gaussian.whole())
    }

    /// The key-time table that plays, with the keys that are kept.
    pub(crate) fn table(&self) -> Option<&Motion> {
        self.poses.table()
    }

    /// What moves the scene: a table, or a network or field; `None` when it stands still.
    pub(crate) fn source(&self) -> Option<MotionSource> {
        match (&self.poses, &self.offsets) {
            (Poses::Table(_) | Poses::Host(..), _) => Some(MotionSource::Table),
            (Poses::Static, Offsets::None) => None,
            _ => Some(MotionSource::Network),
        }
    }

    /// Whether a frame writes into these buffers, so that two frames must execute one after another.
    pub(crate) fn is_written_by_frames(&self) -> bool {
        matches!(self.poses, Poses::Network { .. }) || !matches!(self.offsets, Offsets::None)
    }

    /// Key interval of a time in the pose table that the kernels see.
    pub(crate) fn interval(&self, time: f64) -> KeyInterval {
        if let Poses::Table(motion) = &self.poses { motion.interval(time) } else { KeyInterval::default() }
    }

    /// Bytes of the poses that the host gives each frame; `None` where it gives none.
    pub(crate) fn host_pose_bytes(&self) -> Option<u64> {
        matches!(self.poses, Poses::Host(..)).then_some(u64::from(self.superpoints) * 32)
    }

    /// Records what has to run before `deform_project`. Returns the offsets of each Gaussian, where there are some. `pose`
    /// holds the frame's poses, or will.
    pub(crate) fn record(
        &self,
        gpu: &Gpu,
        r: &mut Recorder,
        scene: &SceneBuffers,
        frame: &Buffer,
        pose: &Buffer,
    ) -> Result<Option<Slice>> {
        self.poses.record(r, self.superpoints, frame, &self.pose)?;
        match &self.offsets {
            Offsets::None => Ok(None),
            Offsets::Given(offset) => Ok(Some(offset.clone())),
            Offsets::Network(network) => network.record(gpu, r, scene, frame, pose).map(Some),
            Offsets::Field(field) => field.record(gpu, r, scene, frame).map(Some),
        }
    }

    /// Bytes on the device.
    pub(crate) fn bytes(&self) -> u64 {
        let blend = self.blend.as_ref().map_or(0, BlendSlices::bytes);
        self.superpoint_of_gaussian.bytes() + blend + self.pose.bytes() + self.offsets.bytes()
    }
}
