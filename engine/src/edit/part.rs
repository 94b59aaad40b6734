//! Changes a selection in the frame of a part, so that the change goes along with the part's motion.
//!
//! With the part's pose T_p and a change S of the world at t₀, T'(t) = C(t)·T(t), C(t) = T_p(t)·T_p(t₀)⁻¹·S·T_p(t₀)·T_p(t)⁻¹.
//! Canonical Gaussians are changed by A, and poses become C(t)·T(t)·A⁻¹, which are rigid for any scale in S. For a superpoint
//! that moves as the part does, A = T(t₀)⁻¹·S·T(t₀) leaves its poses as they are. Gaussians of soft superpoints need one A for
//! all of theirs: the part's. SH coefficients turn with S: view-dependent colour is exact at t₀, and keeps its directions in
//! the world at other times, as it does in every frame.

use glam::DQuat;

use super::measure::{Bound, Touched};
use super::similarity::Similarity;
use super::split::{Moves, movable, split};
use super::table::{corners, remake};
use super::transform::{change_gaussians, point, promote, transform};
use crate::error::{Error, Result};
use crate::file::affine;
use crate::reference::{Pose, table_poses};
use crate::scene::{Motion, Scene};

/// Changes the Gaussians of `mask` by `s` at time `t0`, and at other times as superpoint `part` carries that along.
///
/// # Errors
/// [`Error::Usage`] for models whose motion is no key-time table, and for a superpoint that is not there; [`Error::Limit`] for
/// more key times than a table may have.
pub fn transform_in_part(
    scene: &mut Scene,
    mask: &[bool],
    part: usize,
    s: &Similarity,
    t0: f64,
    bound: &Bound,
) -> Result<Touched> {
    let gaussians = mask.iter().filter(|m| **m).count();
    if s.is_identity() || gaussians == 0 {
        return Ok(Touched::default());
    }
    if movable(scene, "a change of places")? == Moves::Still {
        return transform(scene, mask, s);
    }
    let count = scene.deformation.superpoint_count();
    if part >= count {
        return Err(Error::usage("frame superpoint", part.to_string(), format!("less than {count}")));
    }
    let own = split(scene, mask);
    let Some(deformation) = scene.deformation.superpoint_deformation() else { return Ok(Touched::default()) };
    let Some(old) = deformation.table.clone() else { return Ok(Touched::default()) };
    let start = table_poses(&old, t0);
    let of_part = |pose: &Pose| {
        let pose = Similarity::from(*pose);
        pose.inverse().after(s).after(&pose)
    };
    let is_soft = deformation.blend.is_some();
    // What canonical Gaussians of each superpoint are changed by.
    let shared = of_part(&start[part]);
    let canonical: Vec<Similarity> = start.iter().map(|p| if is_soft { shared } else { of_part(p) }).collect();
    let group = deformation.superpoints.of_gaussian.clone();
    change_gaussians(&mut scene.gaussians, mask, |i| &canonical[group[i] as usize]);
    if s.turn != DQuat::IDENTITY {
        affine::turn_colors(&mut scene.gaussians, s.matrix(), |i| mask[i]);
    }
    if let Some(superpoints) = scene.deformation.superpoints_mut() {
        own.iter().for_each(|&j| point(&mut superpoints.position[j], &canonical[j]));
    }
    let poses = |time: f64| table_poses(&old, time);
    // Where the poses stay they keep their bits: what differs from the part's motion is made anew.
    let remade: Vec<usize> = own.iter().copied().filter(|&j| !same(&old, j, part)).collect();
    let inverse: Vec<Similarity> = remade.iter().map(|&j| canonical[j].inverse()).collect();
    let exact = |time: f64| -> Vec<Similarity> {
        let now = poses(time);
        let of = Similarity::from(now[part]);
        let change = of.after(&shared).after(&of.inverse());
        let all = remade.iter().zip(&inverse);
        all.map(|(&j, inverse)| change.after(&Similarity::from(now[j])).after(inverse)).collect()
    };
    let (mut keys_added, mut error_px) = (0, None);
    if !remade.is_empty() {
        let corners = corners(scene, &remade);
        // The part turns there and back around the change.
        let turning = 4.0 * s.turn.to_scaled_axis().length() + 2.0 * largest_turn(&old, part);
        if let Some(table) = scene.deformation.table_mut() {
            let always = [f64::NEG_INFINITY, f64::INFINITY];
            error_px = Some(remake(table, &remade, &exact, &[], turning, always, &corners, bound)?);
            keys_added = table.times.len() as i64 - old.times.len() as i64;
        }
    }
    Ok(Touched { gaussians, superpoints: own.len(), keys_added, error_px, notes: Vec::new() })
}

/// Largest turn of a superpoint between neighbouring keys, radians.
fn largest_turn(table: &Motion, j: usize) -> f64 {
    let m = table.superpoint_count();
    let at = |k: usize| promote(table.rotation[k * m + j]);
    (1..table.times.len()).map(|k| at(k).distance(at(k - 1))).fold(0.0, f64::max)
}

/// Whether two superpoints have the same poses, bit for bit.
fn same(table: &Motion, one: usize, two: usize) -> bool {
    let m = table.superpoint_count();
    (0..table.times.len()).all(|k| {
        let [a, b] = [one, two].map(|j| k * m + j);
        table.rotation[a] == table.rotation[b] && table.translation[a] == table.translation[b]
    })
}
