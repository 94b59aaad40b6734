//! A scene on the device: the model's arrays, plane by plane, and where its motion comes from.

use glam::DVec3;

use crate::error::{Error, Result};
use crate::gpu::{Buffer, Gpu, Memory, Suite};
use crate::scene::{
    Camera, DeformSize, Gaussians, KeyInterval, Motion, MotionSource, NonrigidNetwork, Rejected, Scene,
};

use super::bounds::Bounds;
use super::deform_network::pack_weights;
use super::field::FieldBuffers;
use super::frame::{Frame, FrameOptions};
use super::mean_storage;
use super::nonrigid_network::{NONRIGID_PLANES, pack_parameters};
use super::pose_table;
use super::quality::{Interpolation, Quality, Storage};
use super::sh_storage;
use super::work_buffers::DEPTH_KEY_BITS;

/// A scene is moved to the origin when its centre is farther away than this many times its extent: poses then keep their
/// precision, because |Exp(r)μ + τ| no longer cancels.
const RECENTRE_RATIO: f64 = 64.0;

/// How poses reach the kernels.
#[derive(Debug)]
pub(crate) enum Poses {
    /// Nothing moves.
    Static,
    /// The key-time table lies on the device; two keys are interpolated in `deform_project`.
    Table(Motion),
    /// Poses of each frame come from the host in f64 (a moving scene far from the world's origin, or geodesics).
    Host(Motion, Interpolation),
    /// `pose` is written by somebody else before the frame (training).
    Given,
    /// Network F runs on the device each frame.
    Network {
        /// Packed weights.
        weights: Buffer,
        /// `[M,3]` canonical centres.
        superpoint_position: Buffer,
        /// Layers and width.
        size: DeformSize,
    },
}

/// Network G on the device.
#[derive(Debug, Clone)]
pub(crate) struct NonrigidBuffers {
    /// Packed weights.
    pub(crate) parameter: Buffer,
    /// `float[10][N]`.
    pub(crate) offset: Buffer,
}

impl NonrigidBuffers {
    fn new(gpu: &Gpu, network: &NonrigidNetwork, gaussians: usize) -> Result<Self> {
        let parameter = pack_parameters(network)?;
        Ok(Self {
            parameter: gpu.buffer_with("nonrigid_parameter", bytemuck::cast_slice(&parameter))?,
            offset: gpu.buffer(
                "nonrigid_offset",
                gaussians.max(1) as u64 * 4 * NONRIGID_PLANES as u64,
                Memory::Device,
            )?,
        })
    }
}

/// The model's arrays on the device.
#[derive(Debug)]
pub(crate) struct SceneBuffers {
    pub(crate) gaussians: u32,
    pub(crate) superpoints: u32,
    pub(crate) sh_degree: u32,
    /// World position of the coordinates' origin.
    pub(crate) origin: DVec3,
    pub(crate) poses: Poses,
    /// Network F's hidden matrices are stored in half precision.
    pub(crate) fp16_weights: bool,
    /// Storage of the SH bands.
    pub(crate) sh_storage: Storage,
    /// Box that holds every Gaussian's centre over all time, relative to the origin; for depth keys.
    pub(crate) bounds: Bounds,
    pub(crate) rejected: Rejected,
    /// Network G: its weights, and the offsets that it writes each frame.
    pub(crate) nonrigid: Option<NonrigidBuffers>,
    /// A deformation field, and the offsets that it writes each frame.
    pub(crate) field: Option<FieldBuffers>,
    pub(crate) mean: Buffer,
    pub(crate) log_scale: Buffer,
    pub(crate) rotation: Buffer,
    pub(crate) opacity_logit: Buffer,
    pub(crate) superpoint_of_gaussian: Buffer,
    /// `[T,M,2]` vec4 of the table, or `[M,2]` written by network F.
    pub(crate) pose: Buffer,
    pub(crate) sh: [Buffer; 4],
}

/// Asks whether the device does what the scene needs beyond exact frames of a table.
fn prove_device(gpu: &Gpu, scene: &Scene, motion: Selected, quality: &Quality) -> Result<()> {
    if quality.changes_kernels() {
        gpu.ready_for(Suite::Packed)?;
    }
    if matches!(motion, Selected::Network) || scene.nonrigid.is_some() && quality.nonrigid {
        gpu.ready_for(Suite::Networks)?;
    }
    if scene.field.is_some() { gpu.ready_for(Suite::Fields) } else { Ok(()) }
}

impl SceneBuffers {
    pub(crate) fn new(gpu: &Gpu, scene: &Scene, source: MotionSource, quality: &Quality) -> Result<Self> {
        let g = &scene.gaussians;
        check_lengths(g)?;
        let motion = select_motion(scene, source)?;
        prove_device(gpu, scene, motion, quality)?;
        let mut rejected = Rejected::default();
        let valid: Vec<bool> = (0..g.len()).map(|i| g.is_valid(i, &mut rejected)).collect();
        let moving = !matches!(motion, Selected::None);
        let origin = if moving { far_origin(g, &valid) } else { DVec3::ZERO };
        let mean: Vec<[f32; 3]> = g
            .mean
            .iter()
            .zip(&valid)
            // A refused Gaussian keeps its index; a NaN centre is culled by the first comparison on the device.
            .map(
                |(m, ok)| {
                    if *ok { (DVec3::from(m.map(f64::from)) - origin).as_vec3().to_array() } else { [f32::NAN; 3] }
                },
            )
            .collect();
        let of_gaussian = scene.superpoints.as_ref().map_or(&[][..], |s| &s.of_gaussian);
        let superpoints = motion.superpoints(scene) as u32;
        let (pose, poses) = upload_motion(gpu, scene, motion, origin, quality)?;
        let sh_degree = g.sh_degree.min(quality.sh_degree);
        let band = |b: u32| {
            let planes = if b > sh_degree { Vec::new() } else { sh_band(g, b) };
            let words = sh_storage::encode(quality.sh, b as usize, &planes, g.len());
            gpu.buffer_with(&format!("sh_{b}"), bytemuck::cast_slice(&words))
        };
        let fp16_weights = quality.network != Storage::F32;
        let nonrigid = scene.nonrigid.as_ref().filter(|_| quality.nonrigid);
        scene.check_field()?;
        let bounds = if quality.depth_bits < DEPTH_KEY_BITS {
            Bounds::of(scene, &mean, &poses, origin)
        } else {
            Bounds::EVERYWHERE
        };
        Ok(Self {
            gaussians: g.len() as u32,
            superpoints,
            sh_degree,
            origin,
            poses,
            fp16_weights,
            sh_storage: quality.sh,
            bounds,
            rejected,
            nonrigid: nonrigid.map(|n| NonrigidBuffers::new(gpu, n, g.len())).transpose()?,
            field: scene.field.as_ref().map(|f| FieldBuffers::new(gpu, f, g.len())).transpose()?,
            mean: gpu.buffer_with("mean", bytemuck::cast_slice(&mean_storage::encode(quality.position, &mean)))?,
            log_scale: gpu.buffer_with("log_scale", bytemuck::cast_slice(&planes(&g.log_scale)))?,
            rotation: gpu.buffer_with("rotation", bytemuck::cast_slice(&g.rotation))?,
            opacity_logit: gpu.buffer_with("opacity_logit", bytemuck::cast_slice(&g.opacity_logit))?,
            superpoint_of_gaussian: gpu.buffer_with("superpoint_of_gaussian", bytemuck::cast_slice(of_gaussian))?,
            pose,
            sh: [band(0)?, band(1)?, band(2)?, band(3)?],
        })
    }

    /// Whether `deform_project` reads poses.
    pub(crate) fn moves(&self) -> bool {
        !matches!(self.poses, Poses::Static)
    }

    /// Key interval of a time in the pose table that the kernels see.
    pub(crate) fn interval(&self, time: f64) -> KeyInterval {
        if let Poses::Table(motion) = &self.poses { motion.interval(time) } else { KeyInterval::default() }
    }

    /// A frame of this scene; background, near plane and time come from `options`.
    pub(crate) fn frame(&self, camera: &Camera, options: FrameOptions, depth_bits: u32) -> Result<Frame> {
        let options = FrameOptions {
            interval: self.interval(options.time),
            gaussians: self.gaussians,
            superpoints: self.superpoints,
            sh_degree: self.sh_degree,
            ..options
        };
        let mut frame = Frame::new(camera, self.origin, &options)?;
        self.bounds.set_depth_key(&mut frame, depth_bits);
        Ok(frame)
    }

    /// Poses at `time` as `[M,2]` vec4, relative to the origin: Exp(r)(μ' + o) + τ − o = Exp(r)μ' + τ'. They replace what
    /// is in `out`; `false`, and nothing is done, unless the scene has [`Poses::Host`].
    pub(crate) fn write_host_poses(&self, time: f64, out: &mut Vec<[f32; 4]>) -> bool {
        let Poses::Host(motion, interpolation) = &self.poses else { return false };
        pose_table::write_poses(motion, *interpolation, time, self.origin, out);
        true
    }

    /// SH bytes that a visible Gaussian costs.
    pub(crate) fn sh_bytes(&self) -> u64 {
        let words = self.sh.iter().take(self.sh_degree as usize + 1).map(Buffer::bytes).sum::<u64>();
        words / u64::from(self.gaussians.max(1))
    }

    /// Bytes of network F's packed weights, where it is live.
    pub(crate) fn network_bytes(&self) -> u64 {
        if let Poses::Network { weights, .. } = &self.poses { weights.bytes() } else { 0 }
    }

    /// Products of one evaluation of network F, where it is live.
    pub(crate) fn network_products(&self) -> u64 {
        if let Poses::Network { size, .. } = &self.poses { size.products() as u64 } else { 0 }
    }

    /// Bytes of the model on the device.
    pub(crate) fn bytes(&self) -> u64 {
        let shared = [
            &self.mean,
            &self.log_scale,
            &self.rotation,
            &self.opacity_logit,
            &self.superpoint_of_gaussian,
            &self.pose,
        ];
        let nonrigid = self.nonrigid.as_ref().map_or(0, |n| n.parameter.bytes() + n.offset.bytes());
        let field = self.field.as_ref().map_or(0, FieldBuffers::bytes);
        field
            + nonrigid
            + shared.iter().map(|b| b.bytes()).sum::<u64>()
            + self.sh.iter().map(Buffer::bytes).sum::<u64>()
    }
}

#[derive(Clone, Copy)]
enum Selected {
    None,
    Table,
    Network,
}

impl Selected {
    fn superpoints(&self, scene: &Scene) -> usize {
        match self {
            Self::None => 0,
            _ => scene.superpoints.as_ref().map_or(0, |s| s.position.len()),
        }
    }
}

fn select_motion(scene: &Scene, source: MotionSource) -> Result<Selected> {
    let missing = |what: &str| Err(Error::usage("motion", what, "a source that the model contains"));
    let table = scene.motion.as_ref().is_some_and(|m| !m.times.is_empty());
    let Some(superpoints) = &scene.superpoints else {
        return match source {
            MotionSource::Auto => Ok(Selected::None),
            MotionSource::Network if scene.field.is_some() => Ok(Selected::None),
            MotionSource::Table if scene.field.is_some() => {
                missing("table, but a deformation field moves the model (`spgs convert --bake` makes a table)")
            }
            MotionSource::Table => missing("table, but the model does not move"),
            MotionSource::Network => missing("network, but the model does not move"),
        };
    };
    let selected = match source {
        MotionSource::Auto if table => Selected::Table,
        MotionSource::Auto if scene.deform.is_some() => Selected::Network,
        MotionSource::Auto => Selected::None,
        MotionSource::Table if table => Selected::Table,
        MotionSource::Table => return missing("table, but the model has no key-time table"),
        MotionSource::Network if scene.deform.is_some() => Selected::Network,
        MotionSource::Network => return missing("network, but the model has no network F"),
    };
    let m = superpoints.position.len();
    let count = superpoints.of_gaussian.len();
    if count != scene.gaussians.len() {
        return Err(Error::usage(
            "superpoints.of_gaussian",
            count.to_string(),
            format!("{} entries", scene.gaussians.len()),
        ));
    }
    if let Some(bad) = superpoints.of_gaussian.iter().find(|&&j| j as usize >= m) {
        return Err(Error::usage("superpoints.of_gaussian", bad.to_string(), format!("an index below {m}")));
    }
    if let (Selected::Table, Some(motion)) = (&selected, &scene.motion) {
        let expected = motion.times.len() * m;
        if motion.rotation.len() != expected || motion.translation.len() != expected {
            let found = format!("{} rotations, {} translations", motion.rotation.len(), motion.translation.len());
            return Err(Error::usage("motion table", found, format!("{expected} each")));
        }
    }
    Ok(selected)
}

fn upload_motion(
    gpu: &Gpu,
    scene: &Scene,
    selected: Selected,
    origin: DVec3,
    quality: &Quality,
) -> Result<(Buffer, Poses)> {
    let m = selected.superpoints(scene) as u64;
    match (selected, &scene.motion, &scene.deform, &scene.superpoints) {
        (Selected::Table, Some(motion), _, _)
            if origin == DVec3::ZERO && quality.interpolation == Interpolation::Linear =>
        {
            let motion = pose_table::thinned(motion, quality.table_step);
            let pairs = motion.rotation.iter().zip(&motion.translation);
            let packed: Vec<[f32; 4]> =
                pairs.flat_map(|(r, t)| [[r[0], r[1], r[2], 0.0], [t[0], t[1], t[2], 0.0]]).collect();
            Ok((gpu.buffer_with("pose", bytemuck::cast_slice(&packed))?, Poses::Table(motion)))
        }
        (Selected::Table, Some(motion), _, _) => {
            let motion = pose_table::thinned(motion, quality.table_step);
            Ok((gpu.buffer("pose", m * 32, Memory::Upload)?, Poses::Host(motion, quality.interpolation)))
        }
        (Selected::Network, _, Some(network), Some(superpoints)) => {
            let weights = gpu.buffer_with(
                "weights",
                bytemuck::cast_slice(&pack_weights(network, quality.network != Storage::F32)?),
            )?;
            let superpoint_position =
                gpu.buffer_with("superpoint_position", bytemuck::cast_slice(&superpoints.position))?;
            Ok((
                gpu.buffer("pose", m * 32, Memory::Device)?,
                Poses::Network { weights, superpoint_position, size: network.size() },
            ))
        }
        _ => Ok((gpu.buffer("pose", 32, Memory::Device)?, Poses::Static)),
    }
}

/// `[N,3]` → three planes of N.
pub(crate) fn planes(values: &[[f32; 3]]) -> Vec<f32> {
    (0..3).flat_map(|axis| values.iter().map(move |v| v[axis])).collect()
}

/// Coefficients of one SH band as planes of N: plane = (k − b²)·3 + channel. Empty above the scene's degree.
pub(crate) fn sh_band(g: &Gaussians, band: u32) -> Vec<f32> {
    if band > g.sh_degree {
        return Vec::new();
    }
    let k3 = g.sh_coefficients() * 3;
    let (first, last) = ((band * band) as usize * 3, ((band + 1) * (band + 1)) as usize * 3);
    (first..last).flat_map(|c| (0..g.len()).map(move |i| g.sh[i * k3 + c])).collect()
}

/// Centre of the valid Gaussians' bounds when it is far away in terms of their extent, else zero.
fn far_origin(g: &Gaussians, valid: &[bool]) -> DVec3 {
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for (m, _) in g.mean.iter().zip(valid).filter(|(_, ok)| **ok) {
        let m = DVec3::from(m.map(f64::from));
        low = low.min(m);
        high = high.max(m);
    }
    let centre = (low + high) * 0.5;
    let far = low.x <= high.x && centre.length() > RECENTRE_RATIO * (high - low).length().max(1.0);
    // Rounded to f32, so that subtracting it from f32 means is exact.
    if far { centre.as_vec3().as_dvec3() } else { DVec3::ZERO }
}

fn check_lengths(g: &Gaussians) -> Result<()> {
    let n = g.len();
    let lengths = [
        ("log_scale", g.log_scale.len(), n),
        ("rotation", g.rotation.len(), n),
        ("opacity_logit", g.opacity_logit.len(), n),
        ("sh", g.sh.len(), n * g.sh_coefficients() * 3),
    ];
    for (name, found, expected) in lengths {
        if found != expected {
            return Err(Error::usage(format!("gaussians.{name}"), format!("{found} values"), format!("{expected}")));
        }
    }
    if g.sh_degree > 3 {
        return Err(Error::usage("SH degree", g.sh_degree.to_string(), "0 to 3"));
    }
    if n > 1 << 30 {
        return Err(Error::Limit { what: "Gaussians".into(), need: n as u128, have: 1 << 30 });
    }
    Ok(())
}
