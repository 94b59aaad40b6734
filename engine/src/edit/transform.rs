//! Moves, turns and scales a selection in the world, for all times.
//!
//! T'(t) = S·T(t) with S = (k, R, s) needs no other key times: with canonical centres k·R·μ, poses r' = R·r and
//! τ' = k·R·τ + s, every interpolated pose gives Exp(r')·k·R·μ + τ' = k·R·(Exp(r)μ + τ) + s, because Exp(R·r) = R·Exp(r)·Rᵀ.
//! The same holds for sums over soft superpoints, and for their quaternions. Colours are seen from directions in the world, so
//! SH coefficients turn with R.

use glam::{DAffine3, DMat3, DQuat, DVec3};
use rayon::prelude::*;

use super::measure::Touched;
use super::similarity::Similarity;
use super::split::{Moves, movable, split};
use crate::error::{Error, Result};
use crate::file::affine;
use crate::scene::parameter::SMOOTHING;
use crate::scene::{Gaussians, Scene};

/// Changes the Gaussians of `mask` `[N]` by `s` in the world, at all times. Exact up to rounding to f32.
///
/// # Errors
/// [`Error::Usage`] for models whose motion is no key-time table.
pub fn transform(scene: &mut Scene, mask: &[bool], s: &Similarity) -> Result<Touched> {
    let gaussians = mask.iter().filter(|m| **m).count();
    if s.is_identity() || gaussians == 0 {
        return Ok(Touched::default());
    }
    let moves = movable(scene, "a change of places")?;
    let part = split(scene, mask);
    let canonical = if moves == Moves::Table { s.linear() } else { *s };
    if !canonical.is_identity() {
        change_gaussians(&mut scene.gaussians, mask, |_| &canonical);
    }
    if s.turn != DQuat::IDENTITY {
        affine::turn_colors(&mut scene.gaussians, s.matrix(), |i| mask[i]);
    }
    if let Some(superpoints) = scene.deformation.superpoints_mut() {
        part.iter().for_each(|&j| point(&mut superpoints.position[j], &canonical));
    }
    if let (Moves::Table, Some(table)) = (moves, scene.deformation.table_mut()) {
        let m = table.superpoint_count();
        for k in 0..table.times.len() {
            for at in part.iter().map(|j| k * m + j) {
                let r = s.turn * promote(table.rotation[at]);
                table.rotation[at] = r.as_vec3().to_array();
                point(&mut table.translation[at], s);
            }
        }
    }
    Ok(Touched { gaussians, superpoints: part.len(), ..Touched::default() })
}

/// Scales the Gaussians of `mask` by different factors along the world's axes, about `pivot`.
///
/// # Errors
/// [`Error::Usage`] where superpoints turn: a turn after such a scale is no rigid motion.
pub fn stretch(scene: &mut Scene, mask: &[bool], factors: DVec3, pivot: DVec3) -> Result<Touched> {
    let gaussians = mask.iter().filter(|m| **m).count();
    if factors == DVec3::ONE || gaussians == 0 {
        return Ok(Touched::default());
    }
    let moves = movable(scene, "a change of places")?;
    let part = split(scene, mask);
    let shift = pivot * (DVec3::ONE - factors);
    if let (Moves::Table, Some(table)) = (moves, scene.deformation.table_mut()) {
        let m = table.superpoint_count();
        let turns = |at: usize| table.rotation[at] != [0.0; 3];
        if let Some(j) = part.iter().find(|&&j| (0..table.times.len()).any(|k| turns(k * m + j))) {
            let found = format!("factors {factors} that differ, and superpoint {j}, which turns");
            let expected = "one factor: a turn after a scale along axes shears, and no rigid pose does that";
            return Err(Error::usage("scale", found, expected));
        }
        for at in (0..table.times.len()).flat_map(|k| part.iter().map(move |j| k * m + j)) {
            table.translation[at] = (promote(table.translation[at]) * factors + shift).as_vec3().to_array();
        }
    }
    let canonical = if moves == Moves::Table { DVec3::ZERO } else { shift };
    let map = DAffine3::from_mat3_translation(DMat3::from_diagonal(factors), canonical);
    stretch_gaussians(&mut scene.gaussians, mask, &map);
    if let Some(superpoints) = scene.deformation.superpoints_mut() {
        for &j in &part {
            let moved = map.transform_point3(promote(superpoints.position[j]));
            superpoints.position[j] = moved.as_vec3().to_array();
        }
    }
    let notes = vec!["colours that depend on the view are as before, seen from the same directions".into()];
    Ok(Touched { gaussians, superpoints: part.len(), notes, ..Touched::default() })
}

fn stretch_gaussians(g: &mut Gaussians, mask: &[bool], map: &DAffine3) {
    let indices: Vec<usize> = (0..g.len()).filter(|&i| mask[i]).collect();
    let mut some = g.selected(&indices);
    // Colours stay.
    (some.sh_degree, some.sh) = (0, vec![0.0; 3 * some.len()]);
    // A stretched smoothing would be as wide in all directions no more.
    some.fold_smoothing();
    affine::transform(&mut some, map);
    let mut smoothing = g.optional.take(SMOOTHING);
    for (k, i) in indices.into_iter().enumerate() {
        (g.mean[i], g.log_scale[i], g.rotation[i]) = (some.mean[k], some.log_scale[k], some.rotation[k]);
        g.opacity_logit[i] = some.opacity_logit[k];
        smoothing.iter_mut().for_each(|sigma| sigma[i] = 0.0);
    }
    smoothing.into_iter().for_each(|sigma| g.optional.set(SMOOTHING, sigma));
}

/// Changes canonical Gaussians of `mask`, but for their colours, by what `of` says for each.
pub(crate) fn change_gaussians<'a>(g: &mut Gaussians, mask: &[bool], of: impl Fn(usize) -> &'a Similarity + Sync) {
    let rows = (&mut g.mean, &mut g.log_scale, &mut g.rotation).into_par_iter().enumerate();
    rows.filter(|(i, _)| mask[*i]).for_each(|(i, (mean, log_scale, rotation))| {
        let s = of(i);
        point(mean, s);
        if s.scale != 1.0 {
            *log_scale = log_scale.map(|v| (f64::from(v) + s.scale.ln()) as f32);
        }
        if s.turn != DQuat::IDENTITY {
            let [w, x, y, z] = rotation.map(f64::from);
            let q = s.turn * DQuat::from_xyzw(x, y, z, w);
            *rotation = [q.w, q.x, q.y, q.z].map(|c| c as f32);
        }
    });
    if let Some(mut smoothing) = g.optional.take(SMOOTHING) {
        smoothing.iter_mut().enumerate().filter(|(i, _)| mask[*i]).for_each(|(i, s)| *s *= of(i).scale as f32);
        g.optional.set(SMOOTHING, smoothing);
    }
}

pub(crate) fn point(x: &mut [f32; 3], s: &Similarity) {
    *x = s.apply(promote(*x)).as_vec3().to_array();
}

pub(crate) fn promote(v: [f32; 3]) -> DVec3 {
    DVec3::from_array(v.map(f64::from))
}
