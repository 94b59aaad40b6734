//! A moving scene at one time, as Gaussians that stand still.

use glam::DQuat;

use super::motion::{Deformation, place_deformed, poses};
use super::network::nonrigid_offsets;
use super::project::Parameters;
use crate::error::Result;
use crate::scene::{Gaussians, MotionSource, Scene};

/// The Gaussians of `scene` where they are at `time`, networks F and G included. SH coefficients stay: colour depends on
/// the direction from the camera to where the Gaussian is, as in rendering. Of a scene that does not move, every bit stays.
///
/// # Errors
/// [`crate::Error::Usage`] when the asked-for motion source is absent or arrays do not fit together.
pub fn freeze(scene: &Scene, time: f64, source: MotionSource) -> Result<Gaussians> {
    let mut gaussians = scene.gaussians.clone();
    let parameters = Parameters::from(&scene.gaussians);
    parameters.check()?;
    let poses = poses(scene, time, source)?;
    if poses.is_none() && scene.nonrigid.is_none() {
        return Ok(gaussians);
    }
    let group = scene.superpoints.as_ref().map_or(&[][..], |s| &s.of_gaussian);
    let rigid = Deformation { group, poses: poses.as_deref(), offsets: None };
    let mut placed = place_deformed(&parameters, &rigid)?;
    if let Some(network) = &scene.nonrigid {
        let offsets = nonrigid_offsets(network, &placed.mean, time);
        placed = place_deformed(&parameters, &Deformation { offsets: Some(&offsets), ..rigid })?;
        for (log_scale, scale) in gaussians.log_scale.iter_mut().zip(&placed.scale) {
            *log_scale = scale.map(|s| s.ln() as f32);
        }
    }
    for (i, (mean, rotation)) in placed.mean.iter().zip(&placed.rotation).enumerate() {
        gaussians.mean[i] = mean.as_vec3().to_array();
        let q = DQuat::from_mat3(rotation);
        gaussians.rotation[i] = [q.w, q.x, q.y, q.z].map(|c| c as f32);
    }
    Ok(gaussians)
}
