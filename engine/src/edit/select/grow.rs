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
    let cell = |x: DVec3| (x / distance).floor().as_i64vec3();
    let mut cells: HashMap<I64Vec3, Vec<DVec3>> = HashMap::new();
    for (x, _) in all.iter().zip(mask).filter(|(_, is_selected)| **is_selected) {
        cells.entry(cell(*x)).or_default().push(*x);
    }
    let is_near = |x: DVec3| {
        let home = cell(x);
        let around = (0..27).map(|k| home + I64Vec3::new(k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1));
        around.filter_map(|c| cells.get(&c)).flatten().any(|y| y.distance(x) <= distance)
    };
    Ok(all.into_par_iter().zip(mask).map(|(x, &is_selected)| is_selected || is_near(x)).collect())
}
