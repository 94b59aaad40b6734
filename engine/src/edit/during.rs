//! Changes a selection in the world for a while: it moves there and back.

use glam::DVec3;

use super::measure::{Bound, Touched};
use super::similarity::Similarity;
use super::split::{Moves, movable, split, with_table};
use super::table::{corners, remake};
use crate::error::{Error, Result};
use crate::reference::table_poses;
use crate::scene::Scene;

/// When a change holds: wholly from `from` to `to`, less and less for `ease` before and after.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    /// Units of time.
    pub from: f64,
    /// At least `from`.
    pub to: f64,
    /// Above 0.
    pub ease: f64,
}

impl Window {
    /// Share of the change at a time, 0 to 1; linear on the way.
    pub fn share(&self, time: f64) -> f64 {
        let outside = (self.from - time).max(time - self.to).max(0.0);
        (1.0 - outside / self.ease).max(0.0)
    }
}

/// Changes the Gaussians of `mask` by a `share` of the rigid `s` at each time: they are turned around `pivot`, which moves on a
/// line. Colours that depend on the view keep their directions in the world.
///
/// # Errors
/// [`Error::Usage`] for a scale, for models whose motion is no key-time table, and for windows that make no sense;
/// [`Error::Limit`] for more key times than a table may have.
pub fn transform_during(
    scene: &mut Scene,
    mask: &[bool],
    s: &Similarity,
    pivot: DVec3,
    window: Window,
    bound: &Bound,
) -> Result<Touched> {
    let gaussians = mask.iter().filter(|m| **m).count();
    if s.scale != 1.0 {
        return Err(Error::usage("scale during a time", s.scale.to_string(), "no scale: poses are rigid"));
    }
    if !(window.from <= window.to && window.ease > 0.0) {
        let found = format!("{}..{} ease {}", window.from, window.to, window.ease);
        return Err(Error::usage("during", found, "times that do not fall, and an ease above 0"));
    }
    if s.is_identity() || gaussians == 0 {
        return Ok(Touched::default());
    }
    if movable(scene, "a change of places")? == Moves::Still {
        let [start, end] = scene.time_range();
        let ends = if start < end { [start, end] } else { [0.0, 1.0] };
        with_table(scene, ends.map(|t| t as f32));
    }
    let own = split(scene, mask);
    let corners = corners(scene, &own);
    let Some(table) = scene.deformation.table_mut() else { return Ok(Touched::default()) };
    let old = table.clone();
    let exact = |time: f64| -> Vec<Similarity> {
        let (now, change) = (table_poses(&old, time), s.share(window.share(time), pivot));
        own.iter().map(|&j| change.after(&Similarity::from(now[j]))).collect()
    };
    let Window { from, to, ease } = window;
    let [first, last] = [old.times.first(), old.times.last()].map(|t| t.copied().map_or(0.0, f64::from));
    if to + ease < first || from - ease > last {
        return Err(Error::usage("during", format!("{from}..{to}"), format!("times of the scene, {first}..{last}")));
    }
    let knots: Vec<f64> =
        [from - ease, from, to, to + ease].into_iter().filter(|t| (first..=last).contains(t)).collect();
    let turning = s.turn.to_scaled_axis().length();
    let error_px = Some(remake(table, &own, &exact, &knots, turning, [from - ease, to + ease], &corners, bound)?);
    let keys_added = table.times.len() as i64 - old.times.len() as i64;
    let notes = vec!["colours that depend on the view are as before, seen from the same directions".into()];
    Ok(Touched { gaussians, superpoints: own.len(), keys_added, error_px, notes })
}
