//! Gradients of the whole image with respect to everything that it depends on.

use glam::DVec3;
use rayon::prelude::*;

use super::motion::pose_gradient;
use super::project::{OneGaussian, OneGradient, View, backward};
use super::splats::{SplatGradient, Upstream, splat_gradients};
use crate::error::{Error, Result};
use crate::reference::{
    DeformationAt, Gaussians64, Offset, Parameters, Pose, ReferenceOptions, Splat, place_deformed, sorted_splats,
};
use crate::scene::Camera;
use crate::scene::parameter::{Optional, PARAMETERS};

/// dL/d of every input of the image.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Gradients {
    /// `[N,3]`.
    pub mean: Vec<[f64; 3]>,
    /// `[N,4]` of the raw quaternion w,x,y,z.
    pub rotation: Vec<[f64; 4]>,
    /// `[N,3]`.
    pub log_scale: Vec<[f64; 3]>,
    /// `[N]`.
    pub opacity_logit: Vec<f64>,
    /// `[N,K,3]`.
    pub sh: Vec<f64>,
    /// `[N,width]` of what only some scenes have.
    pub optional: Optional<f64>,
    /// `[N,2]` of the projected centre, px; 0 for what is not drawn.
    pub mean2d: Vec<[f64; 2]>,
    /// `[M]` of the poses' so(3) vectors and translations.
    pub poses: Vec<Pose>,
    /// `[N,K]` of the weights of soft superpoints, each free for itself; empty without them.
    pub blend_weight: Vec<f64>,
    /// `[N]` of the non-rigid offsets; empty without them.
    pub offsets: Vec<Offset>,
    /// `[N]` what the blending left at each splat; 0 for what is not drawn.
    pub splats: Vec<SplatGradient>,
    /// `[N]` per-Gaussian gradients before the sum over superpoints.
    pub each: Vec<OneGradient>,
}

/// The visible splats front to back, as the image blends them.
pub fn visible_splats(
    gaussians: &Gaussians64,
    deformation: &DeformationAt<'_>,
    camera: &Camera,
    options: &ReferenceOptions,
) -> Result<Vec<Splat>> {
    let parameters = Parameters::from(gaussians);
    parameters.check()?;
    let placed = place_deformed(&parameters, deformation)?;
    let valid = vec![true; placed.mean.len()];
    Ok(sorted_splats(&parameters, &placed, &valid, camera, options))
}

/// Gaussian `i` with what moves it.
fn one(gaussians: &Gaussians64, deformation: &DeformationAt<'_>, i: usize) -> OneGaussian {
    let (sh, sh_degree) = Parameters::from(gaussians).sh(i);
    OneGaussian {
        mean: DVec3::from_array(gaussians.mean[i]),
        rotation: gaussians.rotation[i],
        log_scale: gaussians.log_scale[i],
        opacity_logit: gaussians.opacity_logit[i],
        sh,
        sh_degree,
        poses: deformation.weighted_poses(i),
        offset: deformation.offsets.map(|offsets| offsets[i]),
        optional: gaussians.optional.selected(&[i]),
        antialiased: gaussians.antialiased,
    }
}

/// Gradients of L, given dL/d image.
///
/// Fails as the image does, and when `upstream` has not the image's size.
pub fn image_gradients(
    gaussians: &Gaussians64,
    deformation: &DeformationAt<'_>,
    camera: &Camera,
    options: &ReferenceOptions,
    upstream: &Upstream<'_>,
) -> Result<Gradients> {
    let pixels = camera.width as usize * camera.height as usize;
    let alpha = upstream.alpha.map_or(pixels, <[f64]>::len);
    if upstream.color.len() != 3 * pixels || alpha != pixels {
        let found = format!("{} and {alpha} values", upstream.color.len());
        return Err(Error::usage("gradient of the image", found, format!("{} and {pixels}", 3 * pixels)));
    }
    let splats = visible_splats(gaussians, deformation, camera, options)?;
    let rows = splat_gradients(&splats, camera, options.background, upstream);
    let view = View { time: deformation.time, ..View::from(camera) };
    let count = gaussians.mean.len();
    let sh_values = gaussians.sh.len().checked_div(count).unwrap_or(0);
    let mut gradients = Gradients {
        splats: vec![SplatGradient::default(); count],
        each: vec![OneGradient { sh: vec![0.0; sh_values], ..OneGradient::default() }; count],
        ..Gradients::default()
    };
    let each: Vec<(usize, OneGradient)> = splats
        .par_iter()
        .zip(&rows)
        .map(|(splat, row)| {
            let color = std::array::from_fn(|c| if splat.color[c] > 0.0 { row.color[c] } else { 0.0 });
            (splat.index, backward(&one(gaussians, deformation, splat.index), &view, row, color))
        })
        .collect();
    for ((i, gradient), row) in each.into_iter().zip(rows) {
        gradients.each[i] = gradient;
        gradients.splats[i] = row;
    }
    gather(&mut gradients, deformation);
    for parameter in gaussians.optional.present().iter() {
        let zeros = vec![0.0; PARAMETERS[parameter].width as usize];
        let row = |g: &OneGradient| g.optional.get(parameter).map_or(zeros.clone(), <[f64]>::to_vec);
        gradients.optional.set(parameter, gradients.each.iter().flat_map(row).collect());
    }
    Ok(gradients)
}

/// Copies the per-Gaussian gradients to their arrays and sums those of the poses, in the order of the Gaussians.
fn gather(gradients: &mut Gradients, deformation: &DeformationAt<'_>) {
    let each = &gradients.each;
    gradients.mean = each.iter().map(|g| g.mean.to_array()).collect();
    gradients.rotation = each.iter().map(|g| g.rotation).collect();
    gradients.log_scale = each.iter().map(|g| g.log_scale).collect();
    gradients.opacity_logit = each.iter().map(|g| g.opacity_logit).collect();
    gradients.sh = each.iter().flat_map(|g| g.sh.iter().copied()).collect();
    gradients.mean2d = each.iter().map(|g| g.mean2d.to_array()).collect();
    if deformation.offsets.is_some() {
        gradients.offsets = each.iter().map(|g| g.offset).collect();
    }
    if let Some(poses) = deformation.poses {
        let mut sums = vec![[DVec3::ZERO; 2]; poses.len()];
        let (neighbors, index) = deformation.blend.map_or((1, deformation.group), |b| (b.neighbors, &b.index));
        let slots = each.iter().flat_map(|g| (0..neighbors).map(|slot| g.pose(slot)));
        for (slot, &m) in slots.clone().zip(index) {
            sums[m as usize][0] += slot.omega;
            sums[m as usize][1] += slot.translation;
        }
        if deformation.blend.is_some() {
            gradients.blend_weight = slots.map(|slot| slot.weight).collect();
        }
        let sums = sums.iter().zip(poses).map(|(s, pose)| pose_gradient(pose, s[0], s[1]));
        gradients.poses = sums.map(|[rotation, translation]| Pose { rotation, translation }).collect();
    }
}
