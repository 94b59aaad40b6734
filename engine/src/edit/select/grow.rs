//! A selection and what is near to it.

use glam::{DVec3, I64Vec3};
use rayon::prelude::*;

use crate::edit::centers;
use crate::error::{Error, Result};
use crate::scene::Scene;

/// The Gaussians of `mask`, and those whose centre is within `distance` world units of one of theirs at `time`.
///
/// # Errors
/// [`Error::Usage`] for a distance that is not above 0; those of placing Gaussians.
pub fn grow(scene: &Scene, mask: &[bool], distance: f64, time: f64) -> Result<Vec<bool>> {
    if !(distance > 0.0 && distance.is_finite()) {
        return Err(Error::usage("grow", distance.to_string(), "a distance above 0"));
    }
    let all = centers(scene, time)?;
    let near = Near::new(all.iter().zip(mask).filter(|(_, m)| **m).map(|(x, _)| *x).collect(), distance);
    Ok(all.into_par_iter().zip(mask).map(|(x, &is_selected)| is_selected || near.has(x)).collect())
}

/// Points by the cells that they are in, many cells to a bucket. Cells are twice as wide as the distance: what is near to a
/// point is in its own or, on each axis, in one beside it.
struct Near {
    distance: f64,
    points: Vec<DVec3>,
    /// Where the points of a bucket begin; one more at the end. A power of two of buckets.
    starts: Vec<u32>,
}

impl Near {
    fn new(points: Vec<DVec3>, distance: f64) -> Self {
        let count = (2 * points.len()).next_power_of_two();
        let buckets: Vec<usize> = points.par_iter().map(|x| bucket(cell(*x, distance), count)).collect();
        let mut starts = vec![0; count + 1];
        buckets.iter().for_each(|b| starts[b + 1] += 1);
        (0..count).for_each(|b| starts[b + 1] += starts[b]);
        let (mut next, mut sorted) = (starts.clone(), vec![DVec3::ZERO; points.len()]);
        for (x, b) in points.into_iter().zip(buckets) {
            sorted[next[b] as usize] = x;
            next[b] += 1;
        }
        Self { distance, points: sorted, starts }
    }

    fn has(&self, x: DVec3) -> bool {
        let (home, side) = (cell(x, self.distance), scaled(x, self.distance).fract_gl().round() * 2.0 - 1.0);
        let side = side.as_i64vec3();
        (0..8).any(|k| {
            let cell = home.wrapping_add(side * I64Vec3::new(k & 1, k >> 1 & 1, k >> 2));
            let b = bucket(cell, self.starts.len() - 1);
            let points = &self.points[self.starts[b] as usize..self.starts[b + 1] as usize];
            points.iter().any(|y| y.distance(x) <= self.distance)
        })
    }
}

fn scaled(x: DVec3, distance: f64) -> DVec3 {
    x / (2.0 * distance)
}

fn cell(x: DVec3, distance: f64) -> I64Vec3 {
    scaled(x, distance).floor().as_i64vec3()
}

/// One of `count` buckets, a power of two.
fn bucket(cell: I64Vec3, count: usize) -> usize {
    let mix = |hash: u64, v: i64| (hash ^ v as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29);
    mix(mix(mix(0, cell.x), cell.y), cell.z) as usize & (count - 1)
}
