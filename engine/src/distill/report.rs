//! What distilling cost.

use serde::Serialize;

use super::measure::Spread;
use super::parts::Parts;
use super::sample::Samples;
use super::tracks::Tracks;
use super::yardstick::Yardstick;
use super::{Keyed, Options};
use crate::scene::Scene;

/// How much of a teacher's motion a student keeps.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Report {
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
    /// Whether there are as many superpoints as were allowed, so that more would bring the error down.
    pub capped: bool,
    /// Angle between the rotations of Gaussians, over the Gaussians, degrees.
    pub rotation_degrees: Spread,
    /// Gaussians of the teacher and of the student: those with an opacity below 1/255 are left out.
    pub gaussians: [usize; 2],
    /// Gaussians that rest.
    pub still: usize,
    /// Superpoints of the teacher (0 where it has none) and of the student.
    pub superpoints: [usize; 2],
    /// Superpoints that move one Gaussian.
    pub singletons: usize,
    /// Gaussians that move with several superpoints: those that rigid motion does not follow where there may be no more.
    pub soft: usize,
    /// Key times.
    pub key_times: usize,
    /// Times at which the teacher was evaluated to fit its motion.
    pub sampled_times: usize,
    /// Times between them at which the student was measured.
    pub checked_times: usize,
    /// How far probes of the teacher are from the chords between the times sampled, pixels, as far as is known.
    pub chord_px: f64,
    /// Changes of size that the student does not have.
    pub size_change: Option<SizeChange>,
    /// What else the student lacks, in words.
    pub dropped: Vec<String>,
    /// Seconds of evaluating the teacher, fitting its motion, choosing and measuring key times.
    pub seconds: [f64; 3],
}

/// How much sizes of a teacher change over time, while those of the student are their means.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct SizeChange {
    /// Of two standard deviations, over the Gaussians, pixels.
    pub px: Spread,
    /// As a share of the mean, over the Gaussians.
    pub share: Spread,
}

impl Report {
    /// Whether the error is within the bound.
    pub fn is_within(&self) -> bool {
        self.error_px.largest <= self.bound_px
    }
}

pub(super) fn of(
    teacher: &Scene,
    Yardstick { samples, tracks, .. }: &Yardstick,
    parts: &Parts,
    found: &Keyed,
    options: &Options,
) -> Report {
    let before = teacher.gaussians.len();
    let after = tracks.opacity.len();
    let superpoints = found.scene.deformation.superpoint_count();
    let d = &found.displacement;
    let moving: usize = parts.0.iter().map(|p| p.members.len()).sum();
    let mut dropped = Vec::new();
    if after < before {
        dropped.push(format!("{} Gaussians with an opacity below 1/255", before - after));
    }
    let size_change = teacher.deformation.changes_scales().then(|| size_change(samples, tracks));
    if let Some(change) = &size_change {
        dropped.push(format!(
            "changes of size: two standard deviations are off by up to {:.3} px ({:.1} %), for 99.9 % of the Gaussians by {:.3} px \
             ({:.1} %)",
            change.px.largest,
            100.0 * change.share.largest,
            change.px.q999,
            100.0 * change.share.q999
        ));
    }
    let stays = ["superpoints", "motion"];
    let parts_gone = teacher.deformation.parts().into_iter().filter(|part| !stays.contains(part));
    dropped.extend(parts_gone.map(|part| format!("{part}: play-back needs it no more")));
    Report {
        bound_px: options.error_px,
        capped: d.above > 0 && superpoints >= options.max_superpoints,
        above: d.above,
        error_px: d.error_px,
        at_keys_px: d.at_keys_px,
        between_px: d.between_px,
        rotation_degrees: d.rotation_degrees,
        gaussians: [before, after],
        still: after - moving,
        superpoints: [teacher.deformation.superpoint_count(), superpoints],
        singletons: parts.0.iter().filter(|p| p.members.len() == 1).count(),
        key_times: found.scene.deformation.key_times().len(),
        sampled_times: tracks.times,
        chord_px: samples.chord_px,
        size_change,
        dropped,
        ..Report::default()
    }
}

fn size_change(samples: &Samples, tracks: &Tracks) -> SizeChange {
    let of = |i: usize| {
        let [world, share] = samples.sizes.change(i);
        let reach = tracks.of(i).iter().map(|p| f64::from(p.reach)).fold(0.0, f64::max);
        (world * reach, share)
    };
    let (px, share) = (0..tracks.opacity.len()).map(of).unzip();
    SizeChange { px: Spread::of(px), share: Spread::of(share) }
}
