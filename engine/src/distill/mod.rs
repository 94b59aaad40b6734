//! Any motion as superpoints that move rigidly, with a stated error: no photos, no training. [`tune`](tune()) then trains the student
//! on images, where they matter more than places.
//!
//! A teacher (a deformation field, networks F and G, a table, soft superpoints) is evaluated at as many times as it takes. Probes of
//! each Gaussian (its centre, and two standard deviations along its two longest axes) give paths. Gaussians whose probes stay in
//! place rest; the others are divided into parts that move rigidly:
//!
//! ```text
//! sample   intervals of time are halved until probes are within a quarter of the bound of the chords
//! seeds    farthest points in position and path
//! divide   a Gaussian goes to the part, among the nearest, whose motion leaves the smallest largest distance; parts above the bound
//!          are split; neighbours that stay within the bound together merge
//! table    rotation vectors that go on beyond π, the fewest key times
//! measure  student against teacher at the times sampled, and at others between them
//! ```
//!
//! A part's frames are the weighted least squares fit at each time (Procrustes). A Gaussian's rest position is free: it is the middle of
//! the range that the Gaussian has in the part's frame. All distances are pixels on cameras, as [`crate::train::bake`] measures them.
//! Rigid parts cannot follow changes of size: each Gaussian gets its mean size, and the report says how far off that is.

mod attached;
mod build;
mod divide;
mod measure;
mod merge;
mod parts;
mod refit;
mod report;
mod rigid;
mod sample;
mod seeds;
mod soft;
mod split;
mod table;
#[cfg(test)]
mod tests;
mod tracks;
mod tune;
mod yardstick;

use std::time::Instant;

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::file::codec::sigmoid;
use crate::scene::{Blend, Camera, Gaussians, Scene};
use crate::train::bake::Views;

use divide::{adopt, at_rest, divide};
pub use measure::{Spread, adjusted_rand};
use parts::Parts;
pub use refit::{CAMERAS, OfPhotos, Refitted, refit, spread};
pub use report::{Report, SizeChange};
use rigid::Frame;
use sample::{Moment, Sampler, Samples};
use soft::soften;
use table::Table;
use tracks::Tracks;
pub use tune::{Draw, Lessons, TuneOptions, Tuned, tune};
pub use yardstick::{Displacement, Yardstick};

/// Most times at which a teacher is evaluated to fit its motion.
pub const MOST_TIMES: usize = 129;
/// Times between those at which the result is measured besides.
const CHECKED_TIMES: usize = 16;
/// Where between two times.
const CHECKED_AT: f64 = 0.37;
/// Share of the bound that rigid motion may be off at the times sampled.
const FIT_SHARE: f64 = 0.7;
/// The same with interpolation between key times.
const KEY_SHARE: f64 = 0.88;
/// Share of the bound by which probes may be off the chords between the times sampled.
const CHORD_SHARE: f64 = 0.25;
/// How often key times are chosen closer.
const MOST_ATTEMPTS: usize = 5;
/// Smallest α that is drawn: a Gaussian whose opacity is below it shows nowhere.
const MIN_ALPHA: f64 = 1.0 / 255.0;

/// Where all Gaussians of the teacher are at a time: centres, rotations, sizes.
pub type Place<'a> = dyn FnMut(f64) -> Result<Gaussians> + 'a;
/// Hears what is being done, how much of it is done, and, where that is known, of how much.
pub type Tick<'a> = dyn FnMut(&'static str, usize, Option<usize>) + 'a;

/// What is asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Largest displacement of a probe, pixels.
    pub error_px: f64,
    /// Most superpoints, the one that rests included.
    pub max_superpoints: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self { error_px: 0.25, max_superpoints: 2048 }
    }
}

/// A student.
#[derive(Debug)]
pub struct Distilled {
    /// Gaussians with superpoints and a key-time table.
    pub scene: Scene,
    /// What it cost.
    pub report: Report,
    /// What measures it again when it has changed.
    pub yardstick: Yardstick,
}

/// Superpoints that move as `place` says that the teacher does, as seen by `views`.
///
/// # Errors
/// [`Error::Usage`] for a teacher that does not move or is moved to no finite place, without cameras, and for a bound that is not
/// above 0; those of `place`.
pub fn distill(
    teacher: &Scene,
    place: &mut Place<'_>,
    views: &Views<Camera>,
    options: &Options,
    tick: &mut Tick<'_>,
) -> Result<Distilled> {
    check(teacher, views, options)?;
    let begin = Instant::now();
    let kept = visible(&teacher.gaussians);
    let opacity = kept.iter().map(|&i| sigmoid(teacher.gaussians.opacity_logit[i]) as f32).collect();
    let samples =
        Sampler::new(teacher, &mut *place, views, &kept).sample(teacher, CHORD_SHARE * options.error_px, tick)?;
    let checked = check_times(&samples);
    let mut fresh = Vec::with_capacity(checked.len());
    for &time in &checked {
        tick("times between", fresh.len(), Some(checked.len()));
        fresh.push(Sampler::new(teacher, &mut *place, views, &kept).at(time)?);
    }
    let sampled = begin.elapsed().as_secs_f64();
    let tracks = samples.tracks(opacity);
    let (parts, rests) = motion(&tracks, options, tick);
    let most = parts.0.len() + usize::from(!rests.is_empty());
    // Only where there can be no more parts.
    let soft = if most < options.max_superpoints { Vec::new() } else { soften(&tracks, &parts, options.error_px) };
    let fitted = begin.elapsed().as_secs_f64();
    let student = build::Student::new(teacher, &kept, &samples, &tracks, &parts, &rests, &soft);
    let times = samples.moments.iter().map(|m| m.time).collect();
    let table = Table::new(times, tracks.middle, &parts);
    let yardstick = Yardstick { bound_px: options.error_px, tracks, samples, fresh };
    let found = keyed(&student, &table, &yardstick, &parts, views, options, tick)?;
    let mut report = report::of(teacher, &yardstick, &parts, &found, options);
    report.seconds = [sampled, fitted - sampled, begin.elapsed().as_secs_f64() - fitted];
    report.checked_times = checked.len();
    report.soft = found.scene.deformation.blend().map_or(0, Blend::soft_count);
    Ok(Distilled { scene: found.scene, report, yardstick })
}

fn check(teacher: &Scene, views: &Views<Camera>, options: &Options) -> Result<()> {
    let px = options.error_px;
    if !(px.is_finite() && px > 0.0) {
        return Err(Error::usage("bound", px.to_string(), "pixels above 0"));
    }
    if options.max_superpoints == 0 {
        return Err(Error::usage("superpoints", "0", "one or more"));
    }
    if views.cameras.is_empty() {
        return Err(Error::usage("teacher's cameras", "none", "one or more: without, nothing seems to move"));
    }
    if !teacher.deformation.moves() || teacher.gaussians.is_empty() {
        return Err(Error::usage("teacher", "a model that does not move", "one that moves"));
    }
    Ok(())
}

/// The Gaussians that are drawn.
fn visible(g: &Gaussians) -> Vec<usize> {
    (0..g.len()).filter(|&i| sigmoid(g.opacity_logit[i]) >= MIN_ALPHA).collect()
}

/// Times between neighbours of those sampled, spread over all.
fn check_times(samples: &Samples) -> Vec<f64> {
    let pairs: Vec<&[Moment]> = samples.moments.windows(2).collect();
    let step = pairs.len().div_ceil(CHECKED_TIMES).max(1);
    let between = |w: &&[Moment]| f64::from((w[0].time + CHECKED_AT * (w[1].time - w[0].time)) as f32);
    pairs.iter().step_by(step).map(between).collect()
}

/// Parts, and Gaussians that rest.
fn motion(tracks: &Tracks, options: &Options, tick: &mut Tick<'_>) -> (Parts, Vec<usize>) {
    let bound = FIT_SHARE * options.error_px;
    let standing = vec![Frame::IDENTITY; tracks.times];
    let count = tracks.opacity.len();
    let moves: Vec<f64> = (0..count).into_par_iter().map(|i| at_rest(tracks, i, &standing, bound)).collect();
    let mut still: Vec<(usize, f64)> = moves.iter().copied().enumerate().filter(|(_, r)| *r <= bound).collect();
    let mut movers: Vec<usize> = (0..count).filter(|&i| moves[i] > bound).collect();
    if movers.is_empty() {
        return (Parts::default(), still.into_iter().map(|(i, _)| i).collect());
    }
    if options.max_superpoints == 1 {
        // There is none for what rests.
        still.clear();
        movers = (0..count).collect();
    }
    let most = options.max_superpoints.saturating_sub(usize::from(!still.is_empty())).max(1);
    let mut parts = divide(tracks, &movers, most, bound, tick);
    let rests = adopt(tracks, &mut parts, &still, bound);
    (parts, rests)
}

/// A student with key times, and how far off it is.
struct Keyed {
    scene: Scene,
    displacement: Displacement,
}

/// Chooses key times, closer ones where the student is off by too much between them.
fn keyed(
    student: &build::Student,
    table: &Table,
    yardstick: &Yardstick,
    parts: &Parts,
    views: &Views<Camera>,
    options: &Options,
    tick: &mut Tick<'_>,
) -> Result<Keyed> {
    let mut share = KEY_SHARE;
    let mut attempt = 0;
    loop {
        attempt += 1;
        tick("key times", attempt, None);
        let bound = share * options.error_px;
        let keys = table.keys(&yardstick.tracks, parts, bound, (share - FIT_SHARE).max(0.0) * options.error_px);
        let scene = student.scene(table, &keys);
        let displacement = yardstick.measure(&scene, views)?;
        let keyed = Keyed { scene, displacement };
        let all_are_kept = keys.len() == yardstick.samples.moments.len();
        let Displacement { between_px, at_keys_px, .. } = keyed.displacement;
        if between_px <= options.error_px.max(at_keys_px) || all_are_kept || attempt == MOST_ATTEMPTS {
            return Ok(keyed);
        }
        // The last attempt takes all times.
        share = if attempt + 1 == MOST_ATTEMPTS { 0.0 } else { 0.8 * share };
    }
}
