//! Where the Gaussians of a scene are at a time: each model of [`crate::scene::Deformation`], in f64.

use super::field::field_offsets;
use super::motion::{DeformationAt, Offset, Placed, Pose, place_deformed, table_poses};
use super::network::{network_poses, nonrigid_offsets};
use super::project::Parameters;
use super::soft::Blend64;
use crate::error::Result;
use crate::scene::{Deformation, MotionSource, Scene};

/// Poses of all superpoints of `scene` at `time`; `None` when it has none that move.
///
/// # Errors
/// [`crate::Error::Usage`] when the scene lacks what is asked for.
pub fn poses(scene: &Scene, time: f64, source: MotionSource) -> Result<Option<Vec<Pose>>> {
    let source = scene.deformation.motion_source(source)?;
    let Some(s) = scene.deformation.superpoint_deformation() else { return Ok(None) };
    Ok(match (source, &s.table, &s.network) {
        (Some(MotionSource::Network), _, Some(network)) => Some(network_poses(network, &s.superpoints.position, time)),
        (Some(_), Some(table), _) => Some(table_poses(table, time)),
        _ => None,
    })
}

/// Where the Gaussians of a scene are at `time`: moved by their superpoints, then by network G or a deformation field.
///
/// # Errors
/// [`crate::Error::Usage`] when the asked-for motion source is absent or arrays do not fit together.
pub fn place_scene(scene: &Scene, time: f64, source: MotionSource) -> Result<Placed> {
    let parameters = Parameters::from(&scene.gaussians);
    let poses = poses(scene, time, source)?;
    let group = scene.deformation.superpoint_of_gaussian();
    let blend = Blend64::of(scene);
    let rigid = DeformationAt { group, blend: blend.as_ref(), poses: poses.as_deref(), offsets: None, time };
    let Some(offsets) = offsets(scene, &parameters, &rigid, time)? else {
        return place_deformed(&parameters, &rigid);
    };
    place_deformed(&parameters, &DeformationAt { offsets: Some(&offsets), ..rigid })
}

/// `[N]` what is added to each Gaussian after the rigid motion of its superpoint, where the model does so.
fn offsets(
    scene: &Scene,
    parameters: &Parameters<'_, f32>,
    rigid: &DeformationAt<'_>,
    time: f64,
) -> Result<Option<Vec<Offset>>> {
    let network = match &scene.deformation {
        Deformation::None => return Ok(None),
        Deformation::Field(field) => {
            field.check(scene.gaussians.len())?;
            return Ok(Some(field_offsets(field, &scene.gaussians, time)));
        }
        Deformation::Superpoints(s) => s.nonrigid.as_ref(),
        Deformation::Nonrigid(network) => Some(&**network),
    };
    let Some(network) = network else { return Ok(None) };
    let placed = place_deformed(parameters, rigid)?;
    Ok(Some(nonrigid_offsets(network, &placed.mean, time)))
}
