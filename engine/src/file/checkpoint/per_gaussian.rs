//! Motion that is each Gaussian's own, as a key-time table of one pose per Gaussian.
//!
//! A Gaussian that is at μ(t) with rotation q(t) has the pose r = log(q(t) q⁻¹), τ = μ(t) − Exp(r)μ: exact at the key times.
//! Times are halved until no Gaussian's centre is farther from the line between two keys than the bound; then the finer
//! table is kept. Gaussians that never leave their place share one superpoint. Sizes that change over time have no place
//! in a table: each Gaussian keeps its mean log scale, and the largest change is said.

use std::path::Path;

use glam::{DQuat, DVec3};

use crate::error::{Error, Result};
use crate::file::codec::unit;
use crate::reference::exp;
use crate::scene::{Gaussians, Motion, Scene, Superpoints};

/// Largest distance of a Gaussian's centre from the table, relative to the scene's extent (radius of 90 %).
const ERROR: f64 = 1.0e-3;
/// Largest table, bytes.
const MAX_TABLE: usize = 1 << 30;
/// Most intervals between key times.
const MAX_INTERVALS: usize = 128;
/// A Gaussian stands still when it moves less than this, relative to the extent, and turns less than this, radians.
const STILL: f64 = 1.0e-4;

/// A Gaussian at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Placed {
    pub(super) mean: [f32; 3],
    /// w,x,y,z, unit length.
    pub(super) rotation: [f64; 4],
    pub(super) log_scale: [f32; 3],
}

/// What places every Gaussian at a time.
pub(super) trait Deformation {
    /// `[N]`.
    fn place(&self, gaussians: &Gaussians, time: f64) -> Vec<Placed>;
}

/// μ + Δμ, norm(norm(q) + Δq).
pub(super) fn added(g: &Gaussians, i: usize, mean: &[f32], rotation: &[f32]) -> Placed {
    let q = unit(g.rotation[i]);
    let sum: [f32; 4] = std::array::from_fn(|c| q[c] as f32 + rotation[c]);
    Placed { mean: std::array::from_fn(|a| g.mean[i][a] + mean[a]), rotation: unit(sum), log_scale: g.log_scale[i] }
}

/// Poses of all Gaussians at some times.
struct Table {
    times: Vec<f64>,
    placed: Vec<Vec<Placed>>,
}

/// Adds the motion to a scene at rest: at `times`, or at as many times from 0 to 1 as it takes.
pub(super) fn apply(
    scene: &mut Scene,
    deformation: &dyn Deformation,
    times: Option<&[f32]>,
    path: &Path,
    warnings: &mut Vec<String>,
) -> Result<()> {
    let g = &scene.gaussians;
    let n = g.len();
    if n == 0 {
        return Ok(());
    }
    let extent = extent(&g.mean);
    let most = MAX_TABLE / (24 * n);
    let limit = |need: usize| Error::Limit {
        what: format!("{}: key times of {n} Gaussians in a table of {MAX_TABLE} bytes", path.display()),
        need: need as u128,
        have: most as u128,
    };
    let table = match times {
        Some(times) if times.len() > most => return Err(limit(times.len())),
        Some(times) => {
            let times: Vec<f64> = times.iter().map(|&t| f64::from(t)).collect();
            Table { placed: times.iter().map(|&t| deformation.place(g, t)).collect(), times }
        }
        None => {
            let (table, error) = refine(g, deformation, extent, most).ok_or_else(|| limit(3))?;
            warnings.push(format!(
                "{}: its network is evaluated at {} times; with half as many, centres are off by {:.2e} of the scene's extent at most",
                path.display(),
                table.times.len(),
                error
            ));
            table
        }
    };
    if let Some(i) =
        (0..n).find(|&i| table.placed.iter().any(|p| !p[i].mean.iter().chain(&p[i].log_scale).all(|v| v.is_finite())))
    {
        return Err(Error::corrupt(
            path,
            "weights",
            format!("Gaussian {i} is moved to no finite place"),
            "finite numbers",
        ));
    }
    let change = fix_scales(&mut scene.gaussians, &table);
    if change > 1.0e-3 {
        warnings.push(format!(
            "{}: sizes change over time by up to {:.1} %: each Gaussian keeps its mean size",
            path.display(),
            100.0 * change.exp_m1()
        ));
    }
    let (motion, superpoints) = poses(&scene.gaussians, &table, extent);
    scene.motion = Some(motion);
    scene.superpoints = Some(superpoints);
    Ok(())
}

/// Radius about the median that holds 90 % of the centres.
fn extent(means: &[[f32; 3]]) -> f64 {
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
fn refine(g: &Gaussians, deformation: &dyn Deformation, extent: f64, most: usize) -> Option<(Table, f64)> {
    let at = |t: f64| deformation.place(g, f64::from(t as f32));
    let mut table = Table { times: vec![0.0, 1.0], placed: vec![at(0.0), at(1.0)] };
    loop {
        if 2 * table.times.len() - 1 > most {
            return None;
        }
        let (mut times, mut placed) = (Vec::new(), Vec::new());
        let mut error: f64 = 0.0;
        let intervals = table.times.len() - 1;
        let mut old = table.placed.into_iter();
        for i in 0..intervals {
            let (start, end) = (table.times[i], table.times[i + 1]);
            times.extend([start, 0.5 * (start + end)]);
            placed.extend(old.next());
            placed.push(at(0.5 * (start + end)));
        }
        times.extend(table.times.last());
        placed.extend(old.next());
        for w in placed.windows(3).step_by(2) {
            error = error.max(off_the_line(w) / extent);
        }
        table = Table { times, placed };
        let fits_again = 4 * intervals < most && 4 * intervals <= MAX_INTERVALS;
        if (error <= ERROR && intervals >= 2) || !fits_again {
            return Some((table, error));
        }
    }
}

/// Largest distance of a centre in the middle from the middle of the line.
fn off_the_line(w: &[Vec<Placed>]) -> f64 {
    let distance = |i: usize| {
        let middle = 0.5 * (promote(w[0][i].mean) + promote(w[2][i].mean));
        middle.distance(promote(w[1][i].mean))
    };
    (0..w[1].len()).map(distance).filter(|d| d.is_finite()).fold(0.0, f64::max)
}

/// Gives every Gaussian its mean log scale; returns the largest difference from it.
fn fix_scales(g: &mut Gaussians, table: &Table) -> f64 {
    let mut largest: f64 = 0.0;
    for (i, log_scale) in g.log_scale.iter_mut().enumerate() {
        for (axis, value) in log_scale.iter_mut().enumerate() {
            let all = table.placed.iter().map(|p| f64::from(p[i].log_scale[axis]));
            let mean = all.clone().sum::<f64>() / table.placed.len() as f64;
            largest = all.fold(largest, |l, v| l.max((v - mean).abs()));
            *value = mean as f32;
        }
    }
    largest
}

/// One superpoint for each Gaussian that moves, and one for all others.
fn poses(g: &Gaussians, table: &Table, extent: f64) -> (Motion, Superpoints) {
    let pose = |i: usize, placed: &Placed| {
        let [w, x, y, z] = unit(g.rotation[i]);
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
