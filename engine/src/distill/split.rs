//! Parts that no rigid motion follows are split: into those that one does and the rest, or into two.

use super::parts::Part;
use super::seeds::{distance, paths};
use super::tracks::Tracks;

/// A part with this share of Gaussians that follow one motion keeps them, and loses the others.
const MOST: f64 = 0.75;
/// Members from which on a part is looked at so.
const LEAST: usize = 8;
/// Rounds of reweighting.
const REWEIGHTED: usize = 3;
/// Rounds of giving each Gaussian to the better of two parts.
const ROUNDS: usize = 3;

/// Two parts in place of one that has two members or more.
pub(super) fn split(tracks: &Tracks, part: &Part, bound: f64) -> [Part; 2] {
    outliers(tracks, part, bound).unwrap_or_else(|| halves(tracks, part))
}

/// Those that follow one motion within the bound, where these are most, and the others. Weights of 1/(r + δ)² in the distance r
/// make the fit one of the many (iteratively reweighted least squares).
fn outliers(tracks: &Tracks, part: &Part, bound: f64) -> Option<[Part; 2]> {
    if part.members.len() < LEAST {
        return None;
    }
    let mut robust = part.clone();
    for _ in 0..REWEIGHTED {
        let residual = std::mem::take(&mut robust.residual);
        robust = Part::weighted(tracks, robust.members, |k| (residual[k] + 0.5 * bound).powi(-2));
    }
    let (mut inside, mut outside) = (Vec::new(), Vec::new());
    for (&i, &r) in robust.members.iter().zip(&robust.residual) {
        if r <= bound { &mut inside } else { &mut outside }.push(i);
    }
    let is_most = inside.len() as f64 >= MOST * part.members.len() as f64 && !outside.is_empty();
    is_most.then(|| [Part::of(tracks, inside), Part::of(tracks, outside)])
}

/// Around the worst Gaussian and the one farthest from it; then each goes to the part whose motion suits it better.
fn halves(tracks: &Tracks, part: &Part) -> [Part; 2] {
    let paths = paths(tracks, &part.members);
    let largest = |values: &[f64]| (1..values.len()).fold(0, |best, k| if values[k] > values[best] { k } else { best });
    let one = largest(&part.residual);
    let from = |k: usize| -> Vec<f64> { paths.iter().map(|p| f64::from(distance(p, &paths[k]))).collect() };
    let from_one = from(one);
    let two = largest(&from_one);
    let from_two = from(two);
    let nearer: Vec<bool> = from_one.iter().zip(&from_two).map(|(a, b)| a <= b).collect();
    let mut pair = divided(tracks, part, &nearer).unwrap_or_else(|| {
        // All in one place: any half is as good.
        let half: Vec<bool> = (0..nearer.len()).map(|k| k < nearer.len() / 2).collect();
        divided(tracks, part, &half).unwrap_or_else(|| [part.clone(), Part::default()])
    });
    let mut work = Vec::with_capacity(tracks.times);
    for _ in 0..ROUNDS {
        let mut better = |i: usize| {
            let (_, a) = tracks.in_frame(i, &pair[0].frames, f64::INFINITY, &mut work);
            let (_, b) = tracks.in_frame(i, &pair[1].frames, f64::INFINITY, &mut work);
            a <= b
        };
        let nearer: Vec<bool> = part.members.iter().map(|&i| better(i)).collect();
        match divided(tracks, part, &nearer) {
            Some(next) if next[0].members != pair[0].members => pair = next,
            _ => break,
        }
    }
    pair
}

/// `None` where one of the two would be empty.
fn divided(tracks: &Tracks, part: &Part, first: &[bool]) -> Option<[Part; 2]> {
    let of = |wanted: bool| -> Vec<usize> {
        part.members.iter().zip(first).filter(|(_, f)| **f == wanted).map(|(i, _)| *i).collect()
    };
    let [one, two] = [true, false].map(of);
    (!one.is_empty() && !two.is_empty()).then(|| [Part::of(tracks, one), Part::of(tracks, two)])
}
