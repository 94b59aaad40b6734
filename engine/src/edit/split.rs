//! Superpoints of a selection by itself: where others move with one too, the selection gets a copy of it.

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::scene::gaussians::retain_chunks;
use crate::scene::{Deformation, Motion, Scene, SuperpointDeformation, Superpoints};

use super::rows::is_field;

/// What poses of a scene can be changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Moves {
    /// Nothing moves: Gaussians are changed themselves.
    Still,
    /// A key-time table.
    Table,
}

/// How a scene moves, for edits that change where Gaussians are. Network F and the association, which cannot follow, are
/// taken away where a table plays.
///
/// # Errors
/// [`Error::Usage`] for network F without a table, network G, and deformation fields.
pub(crate) fn movable(scene: &mut Scene, what: &str) -> Result<Moves> {
    if scene.deformation.nonrigid().is_some() {
        let found = format!("{what} in a model with network G, which sees where Gaussians are");
        return Err(Error::usage("edit", found, "a model without network G, or an edit that moves nothing"));
    }
    let s = match &mut scene.deformation {
        Deformation::None | Deformation::Nonrigid(_) => return Ok(Moves::Still),
        Deformation::Field(_) => return Err(is_field(what)),
        Deformation::Superpoints(s) => s,
    };
    if s.table.as_ref().is_some_and(|table| !table.times.is_empty()) {
        s.network = None;
        s.association = None;
        return Ok(Moves::Table);
    }
    if s.network.is_some() {
        let found = format!("{what} in a model that only network F moves");
        return Err(Error::usage("edit", found, "a key-time table: `spgs convert --bake` makes one"));
    }
    Ok(Moves::Still)
}

/// Gives the Gaussians of `mask` superpoints of their own, with the same poses, and returns these; none without superpoints.
/// Superpoints without weight for a Gaussian do not count as its own.
pub(crate) fn split(scene: &mut Scene, mask: &[bool]) -> Vec<usize> {
    let Deformation::Superpoints(s) = &mut scene.deformation else { return Vec::new() };
    let m = s.superpoints.position.len();
    let nothing = || [vec![false; m], vec![false; m]];
    let with = |mut used: [Vec<bool>; 2], i: usize| {
        s.slots(i).for_each(|(j, _)| used[usize::from(mask[i])][j] = true);
        used
    };
    let both = |mut a: [Vec<bool>; 2], b: [Vec<bool>; 2]| {
        a.iter_mut().flatten().zip(b.iter().flatten()).for_each(|(a, b)| *a |= b);
        a
    };
    let all = (0..mask.len()).into_par_iter().with_min_len(4096);
    let [outside, inside] = all.fold(nothing, with).reduce(nothing, both);
    let mut own: Vec<usize> = (0..m).collect();
    let mut copied = Vec::new();
    for j in (0..m).filter(|&j| inside[j] && outside[j]) {
        own[j] = m + copied.len();
        copied.push(j);
    }
    let part: Vec<usize> = (0..m).filter(|&j| inside[j]).map(|j| own[j]).collect();
    if !copied.is_empty() {
        copy(s, &copied);
        rename(s, mask, &own);
    }
    part
}

/// Adds copies of superpoints, with their poses; one may be copied several times.
pub(crate) fn copy(s: &mut SuperpointDeformation, copied: &[usize]) {
    let m = s.superpoints.position.len();
    let more: Vec<[f32; 3]> = copied.iter().map(|&j| s.superpoints.position[j]).collect();
    s.superpoints.position.extend(more);
    if let Some(table) = &mut s.table {
        let wider = |rows: &[[f32; 3]]| -> Vec<[f32; 3]> {
            let rows = rows.chunks_exact(m);
            rows.flat_map(|row| row.iter().copied().chain(copied.iter().map(|&j| row[j]))).collect()
        };
        (table.rotation, table.translation) = (wider(&table.rotation), wider(&table.translation));
    }
}

fn rename(s: &mut SuperpointDeformation, mask: &[bool], own: &[usize]) {
    for (j, _) in s.superpoints.of_gaussian.iter_mut().zip(mask).filter(|(_, is_selected)| **is_selected) {
        *j = own[*j as usize] as u32;
    }
    if let Some(b) = &mut s.blend {
        for (at, (j, w)) in b.index.iter_mut().zip(&b.weight).enumerate() {
            if mask[at / b.neighbors] && *w > 0.0 {
                *j = own[*j as usize] as u32;
            }
        }
    }
}

/// `[M]` whether a Gaussian moves with each superpoint.
pub(crate) fn used(scene: &Scene) -> Vec<bool> {
    let mut used = vec![false; scene.deformation.superpoint_count()];
    if let Some(s) = scene.deformation.superpoint_deformation() {
        (0..scene.gaussians.len()).flat_map(|i| s.slots(i)).for_each(|(j, _)| used[j] = true);
    }
    used
}

/// Takes superpoints without Gaussians away, but for those of `stays` `[M]`, and says how many. All stay with an association,
/// which names them.
pub(crate) fn tidy(scene: &mut Scene, stays: &[bool]) -> usize {
    let kept: Vec<bool> =
        used(scene).into_iter().enumerate().map(|(j, u)| u || stays.get(j).copied().unwrap_or(false)).collect();
    let Deformation::Superpoints(s) = &mut scene.deformation else { return 0 };
    let gone = kept.iter().filter(|kept| !**kept).count();
    if gone == 0 || gone == kept.len() || s.association.is_some() {
        return 0;
    }
    let mut index = Vec::with_capacity(kept.len());
    let mut next = 0;
    for &kept in &kept {
        index.push(next);
        next += u32::from(kept);
    }
    retain_chunks(&mut s.superpoints.position, 1, &kept);
    if let Some(table) = &mut s.table {
        let all = kept.repeat(table.times.len());
        retain_chunks(&mut table.rotation, 1, &all);
        retain_chunks(&mut table.translation, 1, &all);
    }
    s.superpoints.of_gaussian.iter_mut().for_each(|j| *j = index[*j as usize]);
    if let Some(b) = &mut s.blend {
        // A slot without weight may name one that goes: then it names another.
        b.index.iter_mut().for_each(|j| *j = if kept[*j as usize] { index[*j as usize] } else { 0 });
    }
    gone
}

/// Gives a scene in which nothing moves one superpoint that rests, at the ends of `times`, so that some of it can move.
pub(crate) fn with_table(scene: &mut Scene, times: [f32; 2]) {
    let n = scene.gaussians.len();
    let times = if times[0] < times[1] { times.to_vec() } else { vec![times[0]] };
    let table = |m: usize| {
        let poses = vec![[0.0; 3]; times.len() * m];
        Motion { times: times.clone(), rotation: poses.clone(), translation: poses }
    };
    match &mut scene.deformation {
        Deformation::Superpoints(s) if s.table.is_none() && s.network.is_none() => {
            s.table = Some(table(s.superpoints.position.len()));
        }
        Deformation::None => {
            let superpoints = Superpoints { of_gaussian: vec![0; n], position: vec![[0.0; 3]] };
            scene.deformation = SuperpointDeformation::of_table(superpoints, table(1)).into();
        }
        _ => {}
    }
}
