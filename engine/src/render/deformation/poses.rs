//! Poses of superpoints on the device: a key-time table, poses from the host, network F.

use glam::DVec3;

use super::super::deform_network::{self, DEFORM_NETWORK, DeformNetworkBuffers, DeformNetworkConstants, pack_weights};
use super::super::pose_table;
use super::super::quality::{Interpolation, Quality, Storage};
use crate::error::Result;
use crate::gpu::{Buffer, Gpu, Groups, Memory, Recorder};
use crate::scene::{DeformNetwork, DeformSize, Deformation, Motion, MotionSource, SuperpointDeformation};

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
        /// Its hidden matrices are stored in half precision.
        fp16: bool,
        /// `[M,3]` canonical centres.
        superpoint_position: Buffer,
        /// Layers and width.
        size: DeformSize,
    },
}

impl Poses {
    /// Poses of a scene's superpoints, and the buffer `pose`.
    pub(super) fn new(
        gpu: &Gpu,
        deformation: &Deformation,
        source: Option<MotionSource>,
        origin: DVec3,
        quality: &Quality,
    ) -> Result<(Buffer, Self)> {
        let superpoints = deformation.superpoint_deformation();
        match (source, superpoints.and_then(|s| s.network.as_ref()), superpoints) {
            (Some(MotionSource::Network), Some(network), Some(s)) => Self::of_network(gpu, network, s, quality),
            (Some(_), _, Some(SuperpointDeformation { table: Some(table), .. })) => {
                Self::of_table(gpu, table, origin, quality)
            }
            _ => Ok((gpu.buffer("pose", 32, Memory::Device)?, Self::Static)),
        }
    }

    fn of_table(gpu: &Gpu, table: &Motion, origin: DVec3, quality: &Quality) -> Result<(Buffer, Self)> {
        let kept = pose_table::thinned(table, quality.table_step);
        if origin != DVec3::ZERO || quality.interpolation != Interpolation::Linear {
            let bytes = table.superpoint_count() as u64 * 32;
            return Ok((gpu.buffer("pose", bytes, Memory::Upload)?, Self::Host(kept, quality.interpolation)));
        }
        let pairs = kept.rotation.iter().zip(&kept.translation);
        let packed: Vec<[f32; 4]> =
            pairs.flat_map(|(r, t)| [[r[0], r[1], r[2], 0.0], [t[0], t[1], t[2], 0.0]]).collect();
        Ok((gpu.buffer_with("pose", bytemuck::cast_slice(&packed))?, Self::Table(kept)))
    }

    fn of_network(
        gpu: &Gpu,
        network: &DeformNetwork,
        superpoints: &SuperpointDeformation,
        quality: &Quality,
    ) -> Result<(Buffer, Self)> {
        let fp16 = quality.network != Storage::F32;
        let position = &superpoints.superpoints.position;
        let weights = gpu.buffer_with("weights", bytemuck::cast_slice(&pack_weights(network, fp16)?))?;
        let superpoint_position = gpu.buffer_with("superpoint_position", bytemuck::cast_slice(position))?;
        let pose = gpu.buffer("pose", position.len() as u64 * 32, Memory::Device)?;
        Ok((pose, Self::Network { weights, fp16, superpoint_position, size: network.size() }))
    }

    pub(super) fn moves(&self) -> bool {
        !matches!(self, Self::Static)
    }

    pub(super) fn table(&self) -> Option<&Motion> {
        if let Self::Table(motion) | Self::Host(motion, _) = self { Some(motion) } else { None }
    }

    /// Records what writes `pose` each frame.
    pub(super) fn record(&self, r: &mut Recorder, superpoints: u32, frame: &Buffer, pose: &Buffer) -> Result<()> {
        let Self::Network { weights, fp16, superpoint_position, size } = self else { return Ok(()) };
        let buffers = DeformNetworkBuffers {
            frame: frame.whole(),
            superpoint_position: superpoint_position.whole(),
            weights: weights.whole(),
            pose: pose.whole(),
        };
        let groups = Groups::Direct(deform_network::groups(superpoints));
        r.dispatch(&DEFORM_NETWORK, DeformNetworkConstants::new(*size, *fp16), (), buffers, groups)
    }

    /// Poses at `time` as `[M,2]` vec4, relative to the origin: Exp(r)(μ' + o) + τ − o = Exp(r)μ' + τ'. They replace what
    /// is in `out`; nothing is done unless the host gives the poses.
    pub(crate) fn write(&self, time: f64, origin: DVec3, out: &mut Vec<[f32; 4]>) {
        if let Self::Host(motion, interpolation) = self {
            pose_table::write_poses(motion, *interpolation, time, origin, out);
        }
    }

    /// Bytes of network F's packed weights, where it is live.
    pub(crate) fn network_bytes(&self) -> u64 {
        if let Self::Network { weights, .. } = self { weights.bytes() } else { 0 }
    }

    /// Products of one evaluation of network F, where it is live.
    pub(crate) fn network_products(&self) -> u64 {
        if let Self::Network { size, .. } = self { size.products() as u64 } else { 0 }
    }
}
