//! Of all places where photos may show an object, those of one smooth motion: a shortest path from photo to photo.
//!
//! It costs what the speed changes by, and a little what it is. Photos that show something else, or nothing, are passed over at a cost. A
//! speed needs two photos, so that several chains are kept for each place, with the speeds that they have there (Viterbi's algorithm of the
//! second order, cut to the best chains).

use glam::DVec3;
use rayon::prelude::*;

/// Change of speed and speed that cost 1, in lengths of the object per time; a photo that is passed over.
const CHANGE: f64 = 0.15;
const SPEED: f64 = 0.5;
const PASSED: f64 = 6.0;
/// Photos that are passed over in a row, at most.
const MOST_PASSED: usize = 5;
/// Chains that are kept of a place and of a photo.
const OF_PLACE: usize = 6;
const OF_PHOTO: usize = 200;
/// Depths that are tried of what a photo shows: their distance, lengths, and most of them.
const DEPTH: f64 = 0.08;
const DEPTHS: usize = 64;

/// Where a photo may show an object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pose {
    /// World units.
    pub(super) ends: [DVec3; 2],
    /// Which of them the photo shows.
    pub(super) shown: [bool; 2],
    pub(super) cost: f64,
}

/// The cheapest motion.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Chosen {
    pub(super) cost: f64,
    /// Photos that it is seen in, ascending, and which of their poses.
    pub(super) poses: Vec<(usize, usize)>,
}

/// A motion up to a photo.
#[derive(Debug, Clone, Copy)]
struct Chain {
    place: usize,
    cost: f64,
    speed: Option<[DVec3; 2]>,
    /// Photo and chain before.
    before: Option<(usize, usize)>,
}

/// Depths of what a camera sees of a scene with this middle and radius.
pub(super) fn depths(eye: DVec3, (middle, radius): (DVec3, f64), length: f64) -> impl Iterator<Item = f64> + Clone {
    let far = eye.distance(middle) + radius;
    let near = (far - 2.0 * radius).max(DEPTH * length);
    let count = (((far - near) / (DEPTH * length)).ceil() as usize).clamp(2, DEPTHS);
    (0..count).map(move |k| near + (far - near) * k as f64 / (count - 1) as f64)
}

/// The cheapest motion through one place of each photo that is not passed over, of an object of this length. Photos are in order of their times
/// `at`, which differ.
pub(super) fn smoothest(places: &[Vec<Pose>], at: &[f64], length: f64) -> Option<Chosen> {
    let mut chains: Vec<Vec<Chain>> = Vec::with_capacity(places.len());
    for (i, here) in places.iter().enumerate() {
        let first = i.saturating_sub(MOST_PASSED + 1);
        let of_place = |(place, to): (usize, &Pose)| {
            let begin = Chain { place, cost: PASSED * i as f64 + to.cost, speed: None, before: None };
            let mut best = vec![begin];
            for before in first..i {
                let passed = PASSED * (i - before - 1) as f64 + to.cost;
                for (k, chain) in chains[before].iter().enumerate() {
                    let from = &places[before][chain.place];
                    let (step, speed) = step(from, chain.speed, to, at[i] - at[before], length);
                    let cost = chain.cost + passed + step;
                    keep(&mut best, Chain { place, cost, speed: Some(speed), before: Some((before, k)) });
                }
            }
            best
        };
        let mut all: Vec<Chain> = here.par_iter().enumerate().flat_map_iter(of_place).collect();
        all.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        all.truncate(OF_PHOTO);
        chains.push(all);
    }
    let passed_after = |i: usize| PASSED * (places.len() - 1 - i) as f64;
    let ends = chains.iter().enumerate().filter_map(|(i, c)| Some((c.first()?.cost + passed_after(i), i)));
    let (cost, last) = ends.min_by(|a, b| a.0.total_cmp(&b.0))?;
    let mut chosen = Vec::new();
    let mut next = Some((last, 0));
    while let Some((photo, k)) = next {
        let chain = &chains[photo][k];
        chosen.push((photo, chain.place));
        next = chain.before;
    }
    chosen.reverse();
    Some(Chosen { cost, poses: chosen })
}

/// Adds a chain to the best ones of its place.
fn keep(best: &mut Vec<Chain>, chain: Chain) {
    if best.len() < OF_PLACE || best.last().is_some_and(|worst| chain.cost < worst.cost) {
        best.insert(best.partition_point(|c| c.cost <= chain.cost), chain);
        best.truncate(OF_PLACE);
    }
}

/// What it costs to go on to another place after some time, and the speed there.
fn step(from: &Pose, speed: Option<[DVec3; 2]>, to: &Pose, time: f64, length: f64) -> (f64, [DVec3; 2]) {
    let now: [DVec3; 2] = std::array::from_fn(|k| (to.ends[k] - from.ends[k]) / time);
    let squares = |v: &[DVec3; 2]| v.iter().map(|v| v.length_squared()).sum::<f64>() / (length * length);
    let change = speed.map_or(0.0, |before| squares(&std::array::from_fn(|k| now[k] - before[k])) / time);
    (change / (CHANGE * CHANGE) + squares(&now) / (SPEED * SPEED), now)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::train::rng;

    /// A ball, both ends of it at once, that bounces between other things, each third time hidden.
    #[test]
    fn a_motion_is_found_among_others_and_past_what_hides_it() {
        let ball = |i: usize| DVec3::new(0.05 * i as f64, (0.3 * i as f64).sin().abs(), 0.0);
        let pose = |at: DVec3| Pose { ends: [at; 2], shown: [true; 2], cost: 0.0 };
        let random = |k: u64| 2.0 * rng::uniform(3, 9, k) - 1.0;
        let other = |i: usize, k: usize| {
            let at = 30 * i as u64 + 3 * k as u64;
            pose(DVec3::new(random(at), random(at + 1), random(at + 2)))
        };
        let places = |i: usize| {
            let mut all: Vec<Pose> = (0..8).map(|k| other(i, k)).collect();
            if !i.is_multiple_of(3) {
                all.push(pose(ball(i)));
            }
            all
        };
        let at: Vec<f64> = (0..40).map(f64::from).collect();
        let found = smoothest(&(0..40).map(places).collect::<Vec<_>>(), &at, f64::sqrt(2.0)).unwrap();
        let right = found.poses.iter().filter(|(i, k)| !i.is_multiple_of(3) && *k == 8).count();
        assert!(right >= 24 && found.poses.len() - right <= 3, "{found:?}");
        assert!(smoothest(&[], &[], 1.0).is_none() && smoothest(&[vec![]], &[0.0], 1.0).is_none());
    }
}
