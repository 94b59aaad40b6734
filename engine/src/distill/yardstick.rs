//! A teacher's motion as far as it is known, to measure students against.

use serde::Serialize;

use super::measure::{Spread, Worst};
use super::sample::{Moment, Samples, lengths};
use super::tracks::Tracks;
use crate::error::{Error, Result};
use crate::scene::{Camera, Scene};
use crate::train::bake::Views;

/// How far a student is from its teacher.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Displacement {
    /// The bound, pixels.
    pub bound_px: f64,
    /// Displacement of probes at all times measured, over the Gaussians, pixels.
    pub error_px: Spread,
    /// Largest displacement at key times, pixels.
    pub at_keys_px: f64,
    /// Largest displacement between key times, pixels; 0 where there was nothing to measure.
    pub between_px: f64,
    /// Gaussians that are above the bound at some time.
    pub above: usize,
    /// Angle between the rotations of Gaussians, over the Gaussians, degrees.
    pub rotation_degrees: Spread,
}

impl Displacement {
    /// Whether the error is within the bound.
    pub fn is_within(&self) -> bool {
        self.error_px.largest <= self.bound_px
    }
}

/// Where a teacher's Gaussians are at the times sampled, and at others between them.
#[derive(Debug)]
pub struct Yardstick {
    pub(super) bound_px: f64,
    pub(super) tracks: Tracks,
    pub(super) samples: Samples,
    /// At times between those sampled.
    pub(super) fresh: Vec<Moment>,
}

impl Yardstick {
    /// Measures a student whose Gaussians are the teacher's that are drawn, in their order.
    ///
    /// # Errors
    /// `Usage` for another number of Gaussians; as [`place_scene`](crate::reference::place_scene).
    pub fn measure(&self, student: &Scene, views: &Views<Camera>) -> Result<Displacement> {
        let Self { tracks, samples, fresh, bound_px } = self;
        let (n, found) = (tracks.opacity.len(), student.gaussians.len());
        if found != n {
            return Err(Error::usage("Gaussians of the student", found.to_string(), n.to_string()));
        }
        let keys = student.deformation.key_times();
        let mut worst = Worst::new(n);
        let (mut at_keys_px, mut between_px): (f64, f64) = (0.0, 0.0);
        for (k, moment) in samples.moments.iter().enumerate() {
            let px = worst.add(student, moment.time, &samples.order, &|i| tracks.of(i)[k], views)?;
            let place = if keys.contains(&(moment.time as f32)) { &mut at_keys_px } else { &mut between_px };
            *place = place.max(px);
        }
        for moment in fresh {
            let point = |i: usize| moment.point(i, lengths(samples.sizes.mean(i), samples.order[i]));
            between_px = between_px.max(worst.add(student, moment.time, &samples.order, &point, views)?);
        }
        let above = worst.px.iter().filter(|px| **px > *bound_px).count();
        let (error_px, rotation_degrees) = (Spread::of(worst.px), Spread::of(worst.degrees));
        Ok(Displacement { bound_px: *bound_px, error_px, at_keys_px, between_px, above, rotation_degrees })
    }
}
