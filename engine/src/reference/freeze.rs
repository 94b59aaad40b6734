//! A moving scene at one time, as Gaussians that stand still.

use glam::DQuat;

use super::field::field_offsets;
use super::motion::{Deformation, Offset, Placed, place_deformed, poses};
use super::network::nonrigid_offsets;
use super::project::Parameters;
use crate::error::Result;
use crate::scene::{Gaussians, MotionSource, Scene};

/// The Gaussians of `scene` where they are at `time`, networks F and G and deformation fields included. SH coefficients stay:
/// colour depends on the direction from the camera to where the Gaussian is, as in rendering. Of a scene that does not move,
/// every bit stays.
///
/// # Errors
/// [`crate::Error::Usage`] when the asked-for motion source is absent or arrays do not fit together.
pub fn freeze(scene: &Scene, time: f64, source: MotionSource) -> Result<Gaussians> {
    Parameters::from(&scene.gaussians).check()?;
    if scene.motion_source(source)?.is_none() && scene.nonrigid.is_none() && scene.field.is_none() {
        return Ok(scene.gaussians.clone());
    }
    let placed = place_scene(scene, time, source)?;
    Ok(frozen(&scene.gaussians, &placed, scene.nonrigid.is_some() || scene.field.is_some()))
}

/// The Gaussians of a scene that stands still but for `offsets` `[N]`.
///
/// # Errors
/// [`crate::Error::Usage`] when arrays do not fit together.
pub fn freeze_with(gaussians: &Gaussians, offsets: &[Offset]) -> Result<Gaussians> {
    let parameters = Parameters::from(gaussians);
    parameters.check()?;
    let placed = place_deformed(&parameters, &Deformation { offsets: Some(offsets), ..Deformation::default() })?;
    Ok(frozen(gaussians, &placed, true))
}

/// Where the Gaussians of a scene are at `time`: moved by their superpoints, then by network G or a deformation field.
///
/// # Errors
/// [`crate::Error::Usage`] when the asked-for motion source is absent or arrays do not fit together.
pub fn place_scene(scene: &Scene, time: f64, source: MotionSource) -> Result<Placed> {
    let parameters = Parameters::from(&scene.gaussians);
    let poses = poses(scene, time, source)?;
    let group = scene.superpoints.as_ref().map_or(&[][..], |s| &s.of_gaussian);
    let rigid = Deformation { group, poses: poses.as_deref(), offsets: None };
    if let Some(field) = &scene.field {
        scene.check_field()?;
        let offsets = field_offsets(field, &scene.gaussians, time);
        return place_deformed(&parameters, &Deformation { offsets: Some(&offsets), ..rigid });
    }
    let placed = place_deformed(&parameters, &rigid)?;
    let Some(network) = &scene.nonrigid else {
        return Ok(placed);
    };
    let offsets = nonrigid_offsets(network, &placed.mean, time);
    place_deformed(&parameters, &Deformation { offsets: Some(&offsets), ..rigid })
}

fn frozen(gaussians: &Gaussians, placed: &Placed, sizes_change: bool) -> Gaussians {
    let mut gaussians = gaussians.clone();
    if sizes_change {
        for (log_scale, scale) in gaussians.log_scale.iter_mut().zip(&placed.scale) {
            *log_scale = scale.map(|s| s.ln() as f32);
        }
    }
    for (i, (mean, rotation)) in placed.mean.iter().zip(&placed.rotation).enumerate() {
        gaussians.mean[i] = mean.as_vec3().to_array();
        let q = DQuat::from_mat3(rotation);
        gaussians.rotation[i] = [q.w, q.x, q.y, q.z].map(|c| c as f32);
    }
    gaussians
}
