//! A moving scene at one time, as Gaussians that stand still.

use glam::DQuat;

use super::deformation::place_scene;
use super::motion::{DeformationAt, Offset, Placed, place_deformed};
use super::project::Parameters;
use crate::error::Result;
use crate::scene::parameter::Optional;
use crate::scene::{Gaussians, MotionSource, Scene};

/// The Gaussians of `scene` where they are at `time`, networks F and G and deformation fields included. SH coefficients stay:
/// colour depends on the direction from the camera to where the Gaussian is, as in rendering. Of a scene that does not move,
/// every bit stays.
///
/// # Errors
/// [`crate::Error::Usage`] when the asked-for motion source is absent or arrays do not fit together.
pub fn freeze(scene: &Scene, time: f64, source: MotionSource) -> Result<Gaussians> {
    Parameters::from(&scene.gaussians).check()?;
    let sizes_change = scene.deformation.changes_scales();
    if scene.deformation.motion_source(source)?.is_none() && !sizes_change && scene.gaussians.optional.is_empty() {
        return Ok(scene.gaussians.clone());
    }
    let placed = place_scene(scene, time, source)?;
    Ok(frozen(&scene.gaussians, &placed, sizes_change))
}

/// The Gaussians at `time` of a scene that stands still but for `offsets` `[N]`.
///
/// # Errors
/// [`crate::Error::Usage`] when arrays do not fit together.
pub fn freeze_with(gaussians: &Gaussians, offsets: &[Offset], time: f64) -> Result<Gaussians> {
    let parameters = Parameters::from(gaussians);
    parameters.check()?;
    let placed =
        place_deformed(&parameters, &DeformationAt { offsets: Some(offsets), time, ..DeformationAt::default() })?;
    Ok(frozen(gaussians, &placed, true))
}

fn frozen(gaussians: &Gaussians, placed: &Placed, sizes_change: bool) -> Gaussians {
    let mut gaussians = gaussians.clone();
    if sizes_change {
        for (log_scale, scale) in gaussians.log_scale.iter_mut().zip(&placed.scale) {
            *log_scale = scale.map(|s| s.ln() as f32);
        }
    }
    // What depended on time is in the opacity now.
    if !gaussians.optional.is_empty() {
        gaussians.opacity_logit = placed.opacity.iter().map(|o| (o / (1.0 - o)).ln() as f32).collect();
        gaussians.fold_smoothing();
        gaussians.optional = Optional::default();
    }
    for (i, (mean, rotation)) in placed.mean.iter().zip(&placed.rotation).enumerate() {
        gaussians.mean[i] = mean.as_vec3().to_array();
        let q = DQuat::from_mat3(rotation);
        gaussians.rotation[i] = [q.w, q.x, q.y, q.z].map(|c| c as f32);
    }
    gaussians
}
