//! Motion that is each Gaussian's own, as a key-time table of one pose per Gaussian.
//!
//! A Gaussian that is at μ(t) with rotation q(t) has the pose r = log(q(t) q⁻¹), τ = μ(t) − Exp(r)μ: exact at the key times.
//! Times are halved until no Gaussian's centre is farther from the line between two keys than the bound; then the finer
//! table is kept. Gaussians that never leave their place share one superpoint. Sizes that change over time have no place
//! in a table: each Gaussian gets its mean size, and how much sizes change is said.

use glam::{DQuat, DVec3};

use super::motion::{Offset, SCALE_MIN, exp};
use crate::error::{Error, Result};
use crate::scene::{Gaussians, Motion, Superpoints};

/// Largest table, bytes.
const MAX_TABLE: usize = 1 << 30;
/// Most intervals between key times.
const MAX_INTERVALS: usize = 128;
/// A Gaussian stands still when it moves less than this, relative to the extent, and turns less than this, radians.
const STILL: f64 = 1.0e-4;

/// A Gaussian at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlacedGaussian {
    /// World units.
    pub mean: [f32; 3],
    /// w,x,y,z, unit length.
    pub rotation: [f64; 4],
    /// Logarithms of the standard deviations.
    pub log_scale: [f32; 3],
}

impl PlacedGaussian {
    /// μ + Δμ, norm(norm(q) + Δq), exp(log_scale) + Δs (at least [`SCALE_MIN`]).
    pub fn shifted(g: &Gaussians, i: usize, offset: &Offset) -> Self {
        let q = unit(g.rotation[i].map(f64::from));
        let scale = |a: usize| (f64::from(g.log_scale[i][a]).exp() + offset.scale[a]).max(SCALE_MIN).ln() as f32;
        Self {
            mean: std::array::from_fn(|a| (f64::from(g.mean[i][a]) + offset.mean[a]) as f32),
            rotation: unit(std::array::from_fn(|c| q[c] + offset.rotation[c])),
            log_scale: if offset.scale == [0.0; 3] { g.log_scale[i] } else { std::array::from_fn(scale) },
        }
    }
}

/// At which times a table has poses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TableTimes<'a> {
    /// At these.
    At(&'a [f32]),
    /// At 3, 5, 9, … times from 0 to 1, until the centres between two are on the line up to this share of the extent (the
    /// radius that holds 90 % of the centres).
    Within(f64),
}

/// A table that was made.
#[derive(Debug, Clone, PartialEq)]
pub struct Tabulated {
    /// One pose for each Gaussian that moves, and one for all others.
    pub motion: Motion,
    /// Which is whose.
    pub superpoints: Superpoints,
    /// Largest distance of a centre from the line between its neighbours among the times, relative to the extent: what a
    /// table of half as many times would be off by. 0 for given times.
    pub error: f64,
    /// How far the sizes of 95 % of the Gaussians are at most from the mean that each now has, as a share of it.
    pub size_change: f64,
}

/// Poses of all Gaussians at some times.
struct Table {
    times: Vec<f64>,
    placed: Vec<Vec<PlacedGaussian>>,
}

/// Where all Gaussians `[N]` are at a time.
pub type Place<'a> = dyn FnMut(&Gaussians, f64) -> Result<Vec<PlacedGaussian>> + 'a;

/// The motion that `place` says, as a table; `gaussians` get their mean sizes. `what` names it in errors.
///
/// # Errors
/// [`Error::Limit`] when the table would be too large, [`Error::Usage`] when a Gaussian is moved to no finite place, those of
/// `place`.
pub fn tabulate(
    gaussians: &mut Gaussians,
    place: &mut Place<'_>,
    times: TableTimes<'_>,
    what: &str,
) -> Result<Tabulated> {
    let g = &*gaussians;
    let n = g.len();
    let extent = extent(&g.mean);
    let most = MAX_TABLE / (24 * n.max(1));
    let limit = |need: usize| Error::Limit {
        what: format!("{what}: key times of {n} Gaussians in a table of {MAX_TABLE} bytes"),
        need: need as u128,
        have: most as u128,
    };
    let (table, error) = match times {
        TableTimes::At(times) if times.len() > most => return Err(limit(times.len())),
        TableTimes::At(times) => {
            let times: Vec<f64> = times.iter().map(|&t| f64::from(t)).collect();
            let placed = times.iter().map(|&t| place(g, t)).collect::<Result<_>>()?;
            (Table { times, placed }, 0.0)
        }
        TableTimes::Within(bound) => refine(g, place, extent, most, bound)?.ok_or_else(|| limit(3))?,
    };
    let finite = |p: &PlacedGaussian| p.mean.iter().chain(&p.log_scale).all(|v| v.is_finite());
    if let Some(i) = (0..n).find(|&i| table.placed.iter().any(|p| !finite(&p[i]))) {
        return Err(Error::usage(what, format!("Gaussian {i} is moved to no finite place"), "finite numbers"));
    }
    let size_change = fix_scales(gaussians, &table);
    let (motion, superpoints) = poses(gaussians, &table, extent);
    Ok(Tabulated { motion, superpoints, error, size_change })
}

fn unit(q: [f64; 4]) -> [f64; 4] {
    let length = q.iter().map(|c| c * c).sum::<f64>().sqrt();
    if length > 0.0 && length.is_finite() { q.map(|c| c / length) } else { [1.0, 0.0, 0.0, 0.0] }
}

/// Radius about the median that holds 90 % of the centres.
fn extent(means: &[[f32; 3]]) -> f64 {
    if means.is_empty() {
        return 1.0;
    }
    let sorted = |values: &mut dyn Iterator<Item = f32>| {
        let mut values: Vec<f32> = values.collect();
        values.sort_unstable_by(f32::total_cmp);
        values
    };
    let middle = [0, 1, 2].map(|a| f64::from(sorted(&mut means.iter().map(|m| m[a]))[means.len() / 2]));
    let radius = |m: &[f32; 3]| promote(*m).distance(DVec3::from_array(middle)) as f32;
    f64::from(sorted(&mut means.iter().map(radius))[(means.len() - 1) * 9 / 10]).max(1.0e-6)
}

/// Twice as many intervals until the middle of each is on the line; `None` when not even three times fit.
fn refine(g: &Gaussians, place: &mut Place<'_>, extent: f64, most: usize, bound: f64) -> Result<Option<(Table, f64)>> {
    let mut at = |t: f64| place(g, f64::from(t as f32));
    let mut table = Table { times: vec![0.0, 1.0], placed: vec![at(0.0)?, at(1.0)?] };
    loop {
        if 2 * table.times.len() - 1 > most {
            return Ok(None);
        }
        let (mut times, mut placed) = (Vec::new(), Vec::new());
        let mut error: f64 = 0.0;
        let intervals = table.times.len() - 1;
        let mut old = table.placed.into_iter();
        for i in 0..intervals {
            let (start, end) = (table.times[i], table.times[i + 1]);
            times.extend([start, 0.5 * (start + end)]);
            placed.extend(old.next());
            placed.push(at(0.5 * (start + end))?);
        }
        times.extend(table.times.last());
        placed.extend(old.next());
        for w in placed.windows(3).step_by(2) {
            error = error.max(off_the_line(w) / extent);
        }
        table = Table { times, placed };
        let fits_again = 4 * intervals < most && 4 * intervals <= MAX_INTERVALS;
        if (error <= bound && intervals >= 2) || !fits_again {
            return Ok(Some((table, error)));
        }
    }
}

/// Largest distance of a centre in the middle from the middle of the line.
fn off_the_line(w: &[Vec<PlacedGaussian>]) -> f64 {
    let distance = |i: usize| {
        let middle = 0.5 * (promote(w[0][i].mean) + promote(w[2][i].mean));
        middle.distance(promote(w[1][i].mean))
    };
    (0..w[1].len()).map(distance).filter(|d| d.is_finite()).fold(0.0, f64::max)
}

/// Gives every Gaussian its mean size; returns how far those of 95 % are from it at most, as a share.
fn fix_scales(g: &mut Gaussians, table: &Table) -> f64 {
    let mut changes: Vec<f64> = Vec::with_capacity(g.len());
    for (i, log_scale) in g.log_scale.iter_mut().enumerate() {
        let mut change: f64 = 0.0;
        for (axis, value) in log_scale.iter_mut().enumerate() {
            let first = table.placed.first().map_or(*value, |p| p[i].log_scale[axis]);
            if table.placed.iter().all(|p| p[i].log_scale[axis].to_bits() == first.to_bits()) {
                *value = first;
                continue;
            }
            let all = table.placed.iter().map(|p| f64::from(p[i].log_scale[axis]).exp());
            let mean = all.clone().sum::<f64>() / table.placed.len() as f64;
            change = all.fold(change, |c, scale| c.max((scale / mean - 1.0).abs()));
            *value = mean.ln() as f32;
        }
        changes.push(change);
    }
    changes.sort_unstable_by(f64::total_cmp);
    changes.get(changes.len().saturating_sub(1) * 19 / 20).copied().unwrap_or(0.0)
}

/// One superpoint for each Gaussian that moves, and one for all others.
fn poses(g: &Gaussians, table: &Table, extent: f64) -> (Motion, Superpoints) {
    let pose = |i: usize, placed: &PlacedGaussian| {
        let [w, x, y, z] = unit(g.rotation[i].map(f64::from));
        let rest = DQuat::from_xyzw(x, y, z, w);
        let [w, x, y, z] = placed.rotation;
        let turn = DQuat::from_xyzw(x, y, z, w) * rest.conjugate();
        let r = (if turn.w < 0.0 { -turn } else { turn }).to_scaled_axis();
        (r, promote(placed.mean) - exp(r) * promote(g.mean[i]))
    };
    let is_still = |i: usize| {
        table.placed.iter().all(|p| {
            let (r, _) = pose(i, &p[i]);
            promote(p[i].mean).distance(promote(g.mean[i])) <= STILL * extent && r.length() <= STILL
        })
    };
    let moving: Vec<usize> = (0..g.len()).filter(|&i| !is_still(i)).collect();
    let mut of_gaussian = vec![moving.len() as u32; g.len()];
    moving.iter().enumerate().for_each(|(j, &i)| of_gaussian[i] = j as u32);
    let mut position: Vec<[f32; 3]> = moving.iter().map(|&i| g.mean[i]).collect();
    let any_still = moving.len() < g.len();
    position.extend(any_still.then_some([0.0; 3]));
    let mut motion = Motion { times: table.times.iter().map(|&t| t as f32).collect(), ..Motion::default() };
    // Of the two vectors of a rotation, the one nearer to the key before: interpolation must not go round.
    let mut last = vec![DVec3::ZERO; moving.len()];
    for placed in &table.placed {
        for (&i, last) in moving.iter().zip(&mut last) {
            let (r, translation) = pose(i, &placed[i]);
            let r = nearest_turn(r, *last);
            *last = r;
            motion.rotation.push(r.as_vec3().to_array());
            motion.translation.push(translation.as_vec3().to_array());
        }
        motion.rotation.extend(any_still.then_some([0.0; 3]));
        motion.translation.extend(any_still.then_some([0.0; 3]));
    }
    (motion, Superpoints { of_gaussian, position })
}

/// r or r − 2π r/|r|, whichever is nearer to `last`.
fn nearest_turn(r: DVec3, last: DVec3) -> DVec3 {
    let angle = r.length();
    if angle < 1.0e-9 {
        return r;
    }
    let other = r * (1.0 - std::f64::consts::TAU / angle);
    if other.distance(last) < r.distance(last) { other } else { r }
}

fn promote(v: [f32; 3]) -> DVec3 {
    DVec3::from_array(v.map(f64::from))
}
