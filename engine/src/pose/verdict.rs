//! Whether a camera was found. A wrong pose that the search cannot leave looks, from inside, like the right one; so the search is
//! made again from the start mirrored at what was found, as far off on the other side. What draws both starts to one place is the
//! photo; where they end apart, the start was out of reach.

use glam::DVec3;
use serde::Serialize;

use super::sight::{Sight, apart_px};
use super::solver::{PhotoFound, Sizes, Solver, State};
use super::{Progress, Watch};
use crate::error::Result;
use crate::scene::Camera;

/// What is to be thought of a camera.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "is")]
pub enum Verdict {
    /// The start and its mirror image led to the same place.
    Found {
        /// How far apart they ended, pixels.
        apart_px: f64,
    },
    /// They did not: the start was out of reach, and the pose may be wrong.
    OutOfReach {
        /// How far apart they ended, pixels; `None` where nothing is seen any more.
        apart_px: Option<f64>,
    },
    /// It was searched for together with superpoints; no second search was made.
    NotChecked,
}

/// Starts agree when they end this close, pixels.
pub(super) const AGREE_PX: f64 = 0.5;

impl Verdict {
    /// From how far apart the two searches ended.
    pub(super) fn of(apart_px: Option<f64>) -> Self {
        match apart_px {
            Some(apart_px) if apart_px <= AGREE_PX => Self::Found { apart_px },
            apart_px => Self::OutOfReach { apart_px },
        }
    }

    /// Whether it is to be relied upon.
    pub fn is_found(&self) -> bool {
        matches!(self, Self::Found { .. })
    }
}

/// Share of the loss by which the second search must be better to take the first one's place.
const BETTER: f64 = 0.02;

/// Searches for the cameras again from the mirrored starts; what fits better stays. `None` when the watcher wants an end.
pub(super) fn check(
    solver: &mut Solver<'_, '_>,
    state: &mut State,
    first: &[Camera],
    outline: &[DVec3],
    found: &mut Vec<PhotoFound>,
    progress: &mut Progress,
    watch: &mut Watch<'_>,
) -> Result<Option<Vec<Verdict>>> {
    let ends: Vec<Camera> = state.sights.iter().map(|s| s.camera.clone()).collect();
    for (sight, (start, end)) in state.sights.iter_mut().zip(first.iter().zip(&ends)) {
        mirror(sight, start, end);
    }
    if !solver.solve(state, Sizes::Again, progress, watch)? {
        return Ok(None);
    }
    let again = solver.measure(state)?;
    let mut verdicts = Vec::with_capacity(ends.len());
    let mut is_better = false;
    for (k, (sight, end)) in state.sights.iter_mut().zip(&ends).enumerate() {
        verdicts.push(Verdict::of(apart_px(&sight.camera, end, outline)));
        if again[k].loss < (1.0 - BETTER) * found[k].loss && !verdicts[k].is_found() {
            is_better = true;
        } else {
            sight.place(end.rotation, end.position);
        }
    }
    if is_better {
        if !solver.solve(state, Sizes::Full, progress, watch)? {
            return Ok(None);
        }
        *found = solver.measure(state)?;
    }
    Ok(Some(verdicts))
}

/// Puts the camera as far beyond the end as the start was before it.
fn mirror(sight: &mut Sight, start: &Camera, end: &Camera) {
    // Axes in the world are the columns of the transposed rotations.
    let turn = end.rotation.transpose() * start.rotation;
    let position = end.position + turn * (end.position - start.position);
    sight.place(end.rotation * turn.transpose(), position);
}
