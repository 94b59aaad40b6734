//! What moves alike: from some superpoints to neighbours that move with them as one rigid body.
//!
//! At each key time the body's points are fitted by one rigid motion from where they are at the first (least squares). A neighbour
//! joins when its own points are nowhere farther from where that motion takes them than asked for. With the body larger the fit is made again, until nobody joins.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use crate::edit::measure::Bound;
use crate::edit::similarity::Similarity;
use crate::edit::{nearest_turn, outer};
use crate::error::{Error, Result};
use crate::reference::{Pose, table_poses};
use crate::scene::{Motion, Scene, Superpoints};

/// Points of a superpoint that are looked at.
const POINTS: usize = 8;
/// Neighbours of a superpoint: the nearest by their centres.
const NEIGHBORS: usize = 8;
/// Key times that are looked at, at most.
const TIMES: usize = 64;

/// How far a superpoint may be from moving with the others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Likeness {
    /// Pixels, through the cameras of a bound.
    Pixels(f64),
    /// World units.
    World(f64),
}

/// The Gaussians of the superpoints of `mask`, and of those around that move like these.
///
/// # Errors
/// [`Error::Usage`] for a model without a key-time table.
pub fn similar(scene: &Scene, mask: &[bool], most: Likeness, bound: &Bound) -> Result<Vec<bool>> {
    let (Some(superpoints), Some(table)) = (scene.deformation.superpoints(), scene.deformation.table()) else {
        let expected = "superpoints with a key-time table (`spgs convert --bake` makes one)";
        return Err(Error::usage("similar", "a model without", expected));
    };
    let bodies = Bodies::new(scene, superpoints, table);
    let mut inside = vec![false; superpoints.position.len()];
    superpoints.of_gaussian.iter().zip(mask).filter(|(_, m)| **m).for_each(|(&j, _)| inside[j as usize] = true);
    let seeds = inside.clone();
    let (Likeness::Pixels(limit) | Likeness::World(limit)) = most;
    let fits = |j: usize, fit: &[Similarity]| bodies.residual(j, fit, most, bound) <= limit;
    loop {
        let fit = bodies.fit(&inside);
        let edge: Vec<usize> =
            (0..inside.len()).filter(|&j| !inside[j] && bodies.neighbors[j].iter().any(|&k| inside[k])).collect();
        let joins: Vec<usize> = edge.into_par_iter().filter(|&j| fits(j, &fit)).collect();
        if joins.is_empty() {
            break;
        }
        joins.into_iter().for_each(|j| inside[j] = true);
    }
    // Who joined early may be off by the final fit.
    let fit = bodies.fit(&inside);
    let stays: Vec<bool> =
        (0..inside.len()).into_par_iter().map(|j| seeds[j] || (inside[j] && fits(j, &fit))).collect();
    Ok(superpoints.of_gaussian.iter().map(|&j| stays[j as usize]).collect())
}

/// Superpoints as point sets that move.
struct Bodies {
    /// `[M]` points at each of the times looked at, `[T][points]`; none of superpoints without Gaussians.
    placed: Vec<Vec<Vec<DVec3>>>,
    /// `[M]` nearest others, both ways.
    neighbors: Vec<Vec<usize>>,
    times: usize,
}

impl Bodies {
    fn new(scene: &Scene, superpoints: &Superpoints, table: &Motion) -> Self {
        let m = superpoints.position.len();
        let mut members: Vec<Vec<usize>> = vec![Vec::new(); m];
        superpoints.of_gaussian.iter().enumerate().for_each(|(i, &j)| members[j as usize].push(i));
        let points: Vec<Vec<DVec3>> = members
            .iter()
            .map(|list| {
                let step = list.len().div_ceil(POINTS).max(1);
                let at = |&i: &usize| DVec3::from_array(scene.gaussians.mean[i].map(f64::from));
                spread(list.iter().step_by(step).map(at).collect())
            })
            .collect();
        let step = table.times.len().div_ceil(TIMES).max(1);
        let poses: Vec<Vec<Pose>> =
            table.times.iter().step_by(step).map(|&t| table_poses(table, f64::from(t))).collect();
        let place = |j: usize| {
            let at = |poses: &Vec<Pose>| {
                let pose = Similarity::from(poses[j]);
                points[j].iter().map(|x| pose.apply(*x)).collect()
            };
            poses.iter().map(at).collect()
        };
        let placed: Vec<Vec<Vec<DVec3>>> = (0..m).map(place).collect();
        Self { neighbors: neighbors(&placed), times: poses.len(), placed }
    }

    /// Where rigid motion takes the first time's points of the superpoints of `inside` best, at each time.
    fn fit(&self, inside: &[bool]) -> Vec<Similarity> {
        let all = |time: usize| {
            let chosen = self.placed.iter().zip(inside).filter(|(_, inside)| **inside);
            chosen.flat_map(move |(placed, _)| placed[time].iter().copied())
        };
        (0..self.times).into_par_iter().map(|time| rigid(all(0), all(time))).collect()
    }

    /// Largest distance of a superpoint's points from where `fit` takes them.
    fn residual(&self, j: usize, fit: &[Similarity], unit: Likeness, bound: &Bound) -> f64 {
        let placed = &self.placed[j];
        if placed[0].is_empty() {
            return f64::INFINITY;
        }
        let at = |time: usize| {
            let apart = placed[0].iter().zip(&placed[time]).map(|(first, now)| (fit[time].apply(*first), *now));
            let distance = |(a, b): (DVec3, DVec3)| match unit {
                Likeness::Pixels(_) => bound.views.displacement(a, b),
                Likeness::World(_) => a.distance(b),
            };
            apart.map(distance).fold(0.0, f64::max)
        };
        (1..self.times).map(at).fold(0.0, f64::max)
    }
}

/// The points, and six around their centre: in a row they would leave a turn open.
fn spread(mut points: Vec<DVec3>) -> Vec<DVec3> {
    let count = points.len().max(1) as f64;
    let center = points.iter().sum::<DVec3>() / count;
    let radius = (points.iter().map(|x| x.distance_squared(center)).sum::<f64>() / count).sqrt();
    if !points.is_empty() {
        let axes = [DVec3::X, DVec3::Y, DVec3::Z];
        points.extend(axes.into_iter().flat_map(|e| [center + radius * e, center - radius * e]));
    }
    points
}

/// The nearest of each by centres at the first time, both ways.
fn neighbors(placed: &[Vec<Vec<DVec3>>]) -> Vec<Vec<usize>> {
    let center = |points: &[DVec3]| points.iter().sum::<DVec3>() / points.len().max(1) as f64;
    let used: Vec<(usize, DVec3)> = placed
        .iter()
        .enumerate()
        .filter_map(|(j, times)| times.first().filter(|points| !points.is_empty()).map(|points| (j, center(points))))
        .collect();
    let mut found = vec![Vec::new(); placed.len()];
    for (j, x) in &used {
        let mut near: Vec<(f64, usize)> =
            used.iter().filter(|(k, _)| k != j).map(|(k, y)| (x.distance_squared(*y), *k)).collect();
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for (_, k) in near.into_iter().take(NEIGHBORS) {
            found[*j].push(k);
            found[k].push(*j);
        }
    }
    found
}

/// The rigid motion that takes points to others with the least sum of squares.
fn rigid(from: impl Iterator<Item = DVec3> + Clone, to: impl Iterator<Item = DVec3> + Clone) -> Similarity {
    let count = from.clone().count().max(1) as f64;
    let (a, b) = (from.clone().sum::<DVec3>() / count, to.clone().sum::<DVec3>() / count);
    let covariance = from.zip(to).map(|(x, y)| outer(y - b, x - a)).fold(DMat3::ZERO, |sum, one| sum + one);
    let turn = nearest_turn(covariance);
    Similarity { scale: 1.0, turn, shift: b - turn * a }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_rigid_motion_is_found() {
        let points = [DVec3::X, DVec3::new(0.2, 1.0, 0.3), DVec3::new(-0.4, 0.1, 2.0), DVec3::ZERO];
        for angle in [0.0, 0.3, 2.0, 3.1] {
            let s = Similarity::of_turn(DVec3::new(1.0, -0.4, 0.2), angle, DVec3::new(0.0, 3.0, 1.0));
            let found = rigid(points.into_iter(), points.into_iter().map(|x| s.apply(x)));
            let worst = points.iter().map(|x| found.apply(*x).distance(s.apply(*x))).fold(0.0, f64::max);
            assert!(worst < 1e-7, "{angle}: {worst}");
        }
    }
}
