//! Key-time tables with other poses and other key times.

use std::collections::HashMap;

use glam::DVec3;
use rayon::prelude::*;

use super::measure::Bound;
use super::similarity::{Similarity, unwrapped};
use crate::error::{Error, Result};
use crate::reference::table_poses;
use crate::scene::{Motion, Scene};

/// Most key times that an edit may make.
pub(crate) const MOST_KEYS: usize = 65_536;
/// Intervals are halved this often at most.
const ROUNDS: usize = 12;
/// Where between two keys the error is measured.
const PROBES: [f64; 3] = [0.21, 0.5, 0.79];
/// Rotation vectors that differ by less are the same but for rounding, radians.
const SAME: f64 = 1e-5;
/// Largest turn between two samples along which rotations are followed, radians.
const STEP: f64 = 0.4;
/// Rotation vectors are not followed beyond this length, radians: near 2π, where no turn at all has every axis, a path of
/// rotations that passes by has no continuous vectors. There two keys one f32 apart take over to the shortest vector.
const LONGEST: f64 = 5.0;
/// The same on the way to such keys.
const LONGEST_BEFORE: f64 = 5.8;

/// Key times: those given, each once, in order. Times that are not finite are left out.
pub(crate) fn sorted(times: impl IntoIterator<Item = f64>) -> Vec<f32> {
    let mut times: Vec<f32> = times.into_iter().map(|t| t as f32).filter(|t| t.is_finite()).collect();
    times.sort_unstable_by(f32::total_cmp);
    times.dedup();
    times
}

/// The same motion at other key times: at its own ones with all bits.
pub(crate) fn resampled(motion: &Motion, times: &[f32]) -> Motion {
    let rows: Vec<_> = times.iter().map(|&t| table_poses(motion, f64::from(t))).collect();
    let (rotation, translation) = (|r: DVec3| r.as_vec3().to_array(), |t: DVec3| t.as_vec3().to_array());
    Motion {
        times: times.to_vec(),
        rotation: rows.iter().flatten().map(|p| rotation(p.rotation)).collect(),
        translation: rows.iter().flatten().map(|p| translation(p.translation)).collect(),
    }
}

/// Rejects tables that are too large.
///
/// # Errors
/// [`Error::Limit`].
pub(crate) fn check_keys(count: usize, what: &str) -> Result<()> {
    if count <= MOST_KEYS {
        return Ok(());
    }
    Err(Error::Limit { what: format!("{what}: key times"), need: count as u128, have: MOST_KEYS as u128 })
}

/// Corners of a box around what moves with a superpoint: canonical centres and two standard deviations around them. A rigid
/// displacement is largest at a corner.
pub(crate) fn corners(scene: &Scene, part: &[usize]) -> Vec<Vec<DVec3>> {
    let Some(s) = scene.deformation.superpoint_deformation() else { return Vec::new() };
    let mut place = vec![usize::MAX; s.superpoints.position.len()];
    part.iter().enumerate().for_each(|(k, &j)| place[j] = k);
    let g = &scene.gaussians;
    let nothing = || vec![(DVec3::INFINITY, DVec3::NEG_INFINITY); part.len()];
    let with = |mut boxes: Vec<(DVec3, DVec3)>, i: usize| {
        let mean = DVec3::from_array(g.mean[i].map(f64::from));
        let reach = 2.0 * g.log_scale[i].map(f64::from).into_iter().fold(f64::NEG_INFINITY, f64::max).exp();
        for (j, _) in s.slots(i).filter(|(j, _)| place[*j] != usize::MAX) {
            let (low, high) = &mut boxes[place[j]];
            (*low, *high) = (low.min(mean - reach), high.max(mean + reach));
        }
        boxes
    };
    let both = |mut a: Vec<(DVec3, DVec3)>, b: Vec<(DVec3, DVec3)>| {
        a.iter_mut().zip(b).for_each(|(a, b)| *a = (a.0.min(b.0), a.1.max(b.1)));
        a
    };
    let boxes = (0..g.len()).into_par_iter().with_min_len(4096).fold(nothing, with).reduce(nothing, both);
    let eight = |(low, high): (DVec3, DVec3)| {
        let corner = |k: usize| DVec3::select(glam::BVec3::new(k & 1 > 0, k & 2 > 0, k & 4 > 0), high, low);
        if low.x <= high.x { (0..8).map(corner).collect() } else { Vec::new() }
    };
    boxes.into_iter().map(eight).collect()
}

/// Gives the superpoints `part` of `motion` the rigid poses that `exact` says for any time, at its key times, those of
/// `knots` and as many more as it takes for points (`corners` of each) to stay within the bound between keys. `turning` is the
/// largest turn in radians that `exact` adds within a key interval; before and after `changed` it adds nothing. Returns the largest
/// error, pixels.
///
/// # Errors
/// [`Error::Limit`] for more keys than a table may have.
pub(crate) fn remake(
    motion: &mut Motion,
    part: &[usize],
    exact: &(dyn Fn(f64) -> Vec<Similarity> + Sync),
    knots: &[f64],
    turning: f64,
    changed: [f64; 2],
    corners: &[Vec<DVec3>],
    bound: &Bound,
) -> Result<f64> {
    let old = motion.clone();
    let mut times = sorted(old.times.iter().map(|&t| f64::from(t)).chain(knots.iter().copied()));
    // Errors of intervals that stayed as they were.
    let mut known = HashMap::new();
    let mut round = 0;
    loop {
        check_keys(times.len(), "edit")?;
        let plain = resampled(&old, &times);
        motion.clone_from(&plain);
        let mut jumps = follow(motion, &old, part, exact, turning);
        jumps.retain(|&t| times.binary_search_by(|key| key.total_cmp(&(t as f32))).is_err());
        round += 1;
        if !jumps.is_empty() && round <= ROUNDS {
            known.clear();
            times = sorted(times.iter().map(|&t| f64::from(t)).chain(jumps));
            continue;
        }
        let stays = unchanged(motion, &plain, part, changed);
        let errors = interval_errors(motion, part, exact, &stays, corners, bound, &mut known);
        let worst = errors.iter().copied().fold(0.0, f64::max);
        let is_wide = |k: &usize| errors[*k] > bound.pixels;
        let wide: Vec<f64> = (0..errors.len()).filter(is_wide).map(|k| middle(&times, k)).collect();
        let before = times.len();
        if !wide.is_empty() && round <= ROUNDS {
            times = sorted(times.iter().map(|&t| f64::from(t)).chain(wide));
        }
        if times.len() == before {
            return Ok(worst);
        }
    }
}

fn middle(times: &[f32], k: usize) -> f64 {
    0.5 * (f64::from(times[k]) + f64::from(times[k + 1]))
}

/// Writes the exact poses at the key times; rotations are followed from the first key on, in steps small enough to tell a turn
/// from one the other way. Returns key times that it lacks where a vector gets too long.
fn follow(
    motion: &mut Motion,
    old: &Motion,
    part: &[usize],
    exact: &(dyn Fn(f64) -> Vec<Similarity> + Sync),
    turning: f64,
) -> Vec<f64> {
    let (m, mut jumps) = (motion.superpoint_count(), Vec::new());
    let mut rotation = vec![DVec3::ZERO; part.len()];
    for k in 0..motion.times.len() {
        let time = f64::from(motion.times[k]);
        // Nothing lies between keys of which one takes over from the other.
        if k > 0 && !takes_over(&motion.times, k) {
            let last = f64::from(motion.times[k - 1]);
            let (from, to) = (table_poses(old, last), table_poses(old, time));
            let largest = part.iter().map(|&j| from[j].rotation.distance(to[j].rotation)).fold(0.0, f64::max);
            let steps = ((largest + turning) / STEP).ceil().clamp(1.0, 1000.0) as usize;
            let longest = if takes_over(&motion.times, k + 1) { LONGEST_BEFORE } else { LONGEST };
            for step in 1..steps {
                let key = (last + (time - last) * step as f64 / steps as f64) as f32;
                let between = exact(f64::from(key));
                rotation.iter_mut().zip(&between).for_each(|(r, s)| *r = unwrapped(s.turn, *r));
                if rotation.iter().any(|r| r.length() > longest) {
                    jumps.extend([f64::from(key), f64::from(key.next_up())]);
                    rotation.iter_mut().zip(&between).for_each(|(r, s)| *r = unwrapped(s.turn, DVec3::ZERO));
                }
            }
        }
        for ((&j, r), s) in part.iter().zip(&mut rotation).zip(exact(time)) {
            let is_long = takes_over(&motion.times, k) && r.length() > std::f64::consts::PI;
            *r = unwrapped(s.turn, if is_long { DVec3::ZERO } else { *r });
            motion.rotation[k * m + j] = r.as_vec3().to_array();
            motion.translation[k * m + j] = s.shift.as_vec3().to_array();
        }
        let goes_on = k + 1 == motion.times.len() || takes_over(&motion.times, k + 1);
        if !goes_on && rotation.iter().any(|r| r.length() > LONGEST) {
            jumps.push(f64::from(motion.times[k].next_up()));
            rotation.iter_mut().zip(exact(time)).for_each(|(r, s)| *r = unwrapped(s.turn, DVec3::ZERO));
        }
    }
    jumps
}

/// Whether a key takes over from one just before it; no time lies between them.
fn takes_over(times: &[f32], k: usize) -> bool {
    k > 0 && k < times.len() && times[k] == times[k - 1].next_up()
}

/// Key intervals before and after `changed` in which the motion is the same, but for rounding: interpolation takes the same way there,
/// unless vectors have gone on by whole turns.
fn unchanged(motion: &Motion, old: &Motion, part: &[usize], changed: [f64; 2]) -> Vec<bool> {
    let m = motion.superpoint_count();
    let same = |k: usize| {
        let vector = |of: &Motion, i: usize| DVec3::from_array(of.rotation[i].map(f64::from));
        part.iter().map(|j| k * m + j).all(|i| vector(motion, i).distance(vector(old, i)) < SAME)
    };
    let same: Vec<bool> = (0..motion.times.len()).map(same).collect();
    let outside = |k: usize| f64::from(motion.times[k + 1]) <= changed[0] || f64::from(motion.times[k]) >= changed[1];
    (0..motion.times.len().saturating_sub(1)).map(|k| outside(k) && same[k] && same[k + 1]).collect()
}

/// Largest displacement in each key interval, pixels; 0 where the motion `stays`.
fn interval_errors(
    motion: &Motion,
    part: &[usize],
    exact: &(dyn Fn(f64) -> Vec<Similarity> + Sync),
    stays: &[bool],
    corners: &[Vec<DVec3>],
    bound: &Bound,
    known: &mut HashMap<[u32; 2], f64>,
) -> Vec<f64> {
    let name = |k: usize| [motion.times[k].to_bits(), motion.times[k + 1].to_bits()];
    let error = |k: usize| {
        if stays[k] || takes_over(&motion.times, k + 1) {
            return 0.0;
        }
        if let Some(error) = known.get(&name(k)) {
            return *error;
        }
        let [from, to] = [k, k + 1].map(|k| f64::from(motion.times[k]));
        let at = |share: f64| {
            let time = from + (to - from) * share;
            let found = table_poses(motion, time);
            let found: Vec<Similarity> = part.iter().map(|&j| Similarity::from(found[j])).collect();
            largest(&found, &exact(time), corners, bound)
        };
        PROBES.into_iter().map(at).fold(0.0, f64::max)
    };
    let errors: Vec<f64> = (0..motion.times.len().saturating_sub(1)).into_par_iter().map(error).collect();
    known.extend(errors.iter().enumerate().map(|(k, error)| (name(k), *error)));
    errors
}

/// Largest displacement of corners between two poses of each superpoint, pixels. What may be off most is looked at first; the rest
/// cannot be off by more.
fn largest(found: &[Similarity], wanted: &[Similarity], corners: &[Vec<DVec3>], bound: &Bound) -> f64 {
    let placed = |k: usize| corners[k].iter().map(move |x| (found[k].apply(*x), wanted[k].apply(*x)));
    let most = |k: usize| {
        let [Some(low), Some(high)] = [corners[k].first(), corners[k].last()] else { return 0.0 };
        let distance = placed(k).map(|(a, b)| a.distance(b)).fold(0.0, f64::max);
        bound.views.most(wanted[k].apply(0.5 * (*low + *high)), 0.5 * low.distance(*high), distance)
    };
    let mut order: Vec<(f64, usize)> = (0..corners.len()).map(|k| (most(k), k)).collect();
    order.sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
    let mut worst = 0.0;
    for (most, k) in order {
        if most <= worst {
            break;
        }
        worst = placed(k).map(|(a, b)| bound.views.displacement(a, b)).fold(worst, f64::max);
    }
    worst
}
