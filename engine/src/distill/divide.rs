//! The division into parts: seeds, then rounds of giving Gaussians to better parts and splitting those that stay above the bound;
//! then neighbours that move alike merge.

use rayon::prelude::*;

use super::Tick;
use super::merge::merge;
use super::parts::{Part, Parts};
use super::rigid::Frame;
use super::seeds::farthest_points;
use super::split::split;
use super::tracks::{Rest, Tracks};

/// Parts to begin with.
const SEEDS: usize = 32;
/// Rounds of splitting.
const ROUNDS: usize = 48;
/// How often Gaussians look for a better part between splits.
const REASSIGNED: usize = 2;
/// Gaussians within this share of the bound stay where they are while parts are still split.
const CONTENT: f64 = 0.5;
/// The same at the end.
const CONTENT_AT_LAST: f64 = 0.02;
/// Times that are looked at first.
const FIRST_TIMES: usize = 33;
/// Nearest parts that are looked at, and at the end, where few Gaussians look.
const FEW: usize = 8;
const MANY: usize = 32;
/// How often merging may make room for more splits.
const AGAIN: usize = 8;
/// Neighbours merge for that if they stay within this share of what parts above the bound are off by in the middle.
const CHEAP: f64 = 0.5;
/// It goes on as long as it takes away this share of the excess.
const GAIN: f64 = 0.02;
/// A Gaussian that hardly moves goes with a part that suits it so much better than rest.
const BETTER_THAN_REST: f64 = 0.5;
/// What is within this share of the bound at rest stays at rest.
const RESTS: f64 = 1.0e-3;

/// Parts of `movers` whose Gaussians stay within `bound` pixels of rigid motion, or `most` parts.
pub(super) fn divide(tracks: &Tracks, movers: &[usize], most: usize, bound: f64, tick: &mut Tick<'_>) -> Parts {
    // At some of the times first: most of what is to be told apart shows there.
    let some = tracks.thinned(FIRST_TIMES);
    let mut parts = Parts::of(&some, farthest_points(&some, movers, SEEDS.min(most)));
    grow(&some, &mut parts, most, bound, true, tick);
    merge(&some, &mut parts, bound, FEW);
    parts = balance(&some, parts, most, bound, tick);
    let mut parts = Parts::of(tracks, parts.0.into_iter().map(|part| part.members).collect());
    for _ in 0..REASSIGNED {
        tick("superpoints", parts.0.len(), None);
        parts.reassign(tracks, CONTENT_AT_LAST * bound, MANY);
        merge(tracks, &mut parts, bound, MANY);
    }
    grow(tracks, &mut parts, most, bound, false, tick);
    parts
}

/// Where there are as many parts as may be, and some above the bound: neighbours that would be off by little together merge, which
/// makes room to split those that are off by much.
fn balance(tracks: &Tracks, mut parts: Parts, most: usize, bound: f64, tick: &mut Tick<'_>) -> Parts {
    for _ in 0..AGAIN {
        let mut over: Vec<f64> = parts.0.iter().map(Part::worst).filter(|worst| *worst > bound).collect();
        if over.is_empty() {
            break;
        }
        over.sort_unstable_by(f64::total_cmp);
        let mut next = parts.clone();
        merge(tracks, &mut next, bound.max(CHEAP * over[over.len() / 2]), FEW);
        grow(tracks, &mut next, most, bound, true, tick);
        if next.excess(tracks, bound) > (1.0 - GAIN) * parts.excess(tracks, bound) {
            break;
        }
        parts = next;
    }
    parts
}

/// Splits parts above the bound, those first that show most, as long as there is room.
fn grow(tracks: &Tracks, parts: &mut Parts, most: usize, bound: f64, reassigned: bool, tick: &mut Tick<'_>) {
    for _ in 0..ROUNDS {
        tick("superpoints", parts.0.len(), None);
        for _ in 0..if reassigned { REASSIGNED } else { 0 } {
            if parts.reassign(tracks, CONTENT * bound, FEW) == 0 {
                break;
            }
        }
        let is_over = |part: &Part| part.members.len() > 1 && part.worst() > bound;
        let mut over: Vec<(f64, usize)> = parts
            .0
            .iter()
            .enumerate()
            .filter(|(_, part)| is_over(part))
            .map(|(j, part)| (part.excess(tracks, bound), j))
            .collect();
        let room = most.saturating_sub(parts.0.len());
        if over.is_empty() || room == 0 {
            break;
        }
        over.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        over.truncate(room);
        let made: Vec<(usize, [Part; 2])> =
            over.par_iter().map(|&(_, j)| (j, split(tracks, &parts.0[j], bound))).collect();
        for (j, [one, two]) in made {
            parts.0[j] = one;
            parts.0.push(two);
        }
        parts.0.retain(|part| !part.members.is_empty());
    }
}

/// Those of `still` that a part suits much better than rest go with it; the others are returned.
pub(super) fn adopt(tracks: &Tracks, parts: &mut Parts, still: &[(usize, f64)], bound: f64) -> Vec<usize> {
    let of = |&(i, at_rest): &(usize, f64)| {
        if at_rest <= RESTS * bound || parts.0.is_empty() {
            return None;
        }
        let mut work = Vec::with_capacity(tracks.times);
        let mut best = (None, BETTER_THAN_REST * at_rest);
        for j in parts.nearest(tracks, i, FEW) {
            let (_, r) = tracks.in_frame(i, &parts.0[j].frames, best.1, &mut work);
            if r < best.1 {
                best = (Some(j), r);
            }
        }
        best.0
    };
    let goes: Vec<Option<usize>> = still.par_iter().map(of).collect();
    let mut more: Vec<Vec<usize>> = vec![Vec::new(); parts.0.len()];
    let mut rests = Vec::new();
    for (&(i, _), to) in still.iter().zip(goes) {
        match to {
            Some(j) => more[j].push(i),
            None => rests.push(i),
        }
    }
    parts.extend(tracks, more);
    rests
}

/// How far a Gaussian is from resting in one place at most, pixels; infinite above `enough`.
pub(super) fn at_rest(tracks: &Tracks, i: usize, standing: &[Frame], enough: f64) -> f64 {
    tracks.in_frame(i, standing, enough, &mut Vec::with_capacity(tracks.times)).1
}

/// Where a Gaussian that rests is.
pub(super) fn at_rest_place(tracks: &Tracks, i: usize) -> Rest {
    let standing = vec![Frame::IDENTITY; tracks.times];
    tracks.in_frame(i, &standing, f64::INFINITY, &mut Vec::with_capacity(tracks.times)).0
}
