//! A selection and what is near to it.

use std::collections::HashMap;

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
    // Cells twice as wide as the distance: what is near to a point is in its own or, on each axis, in one beside it.
    let scaled = |x: DVec3| x / (2.0 * distance);
    let cell = |x: DVec3| scaled(x).floor().as_i64vec3();
    let mut cells: HashMap<I64Vec3, Vec<DVec3>> = HashMap::new();
    for (x, _) in all.iter().zip(mask).filter(|(_, is_selected)| **is_selected) {
        cells.entry(cell(*x)).or_default().push(*x);
    }
    let is_near = |x: DVec3| {
        let (home, side) = (cell(x), scaled(x).fract_gl().round() * 2.0 - 1.0);
        let side = side.as_i64vec3();
        let around = (0..8).map(|k| home + side * I64Vec3::new(k & 1, k >> 1 & 1, k >> 2));
        around.filter_map(|c| cells.get(&c)).flatten().any(|y| y.distance(x) <= distance)
    };
    Ok(all.into_par_iter().zip(mask).map(|(x, &is_selected)| is_selected || is_near(x)).collect())
}
