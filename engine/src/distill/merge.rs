//! Neighbouring parts that one rigid motion follows become one.

use rayon::prelude::*;

use super::parts::{Part, Parts};
use super::tracks::Tracks;

/// Members of each of two parts that are looked at first.
const SAMPLE: usize = 24;
/// A sample's fit is better than that of all, and its members' distances are nearly the largest.
const SAMPLE_SLACK: f64 = 1.5;
/// Rounds of merging pairs.
const ROUNDS: usize = 24;

/// Merges pairs whose joint distance stays within `bound` pixels, the closest first, until there is none. Each part looks at the
/// `count` nearest.
pub(super) fn merge(tracks: &Tracks, parts: &mut Parts, bound: f64, count: usize) {
    // Pairs that were looked at and do not fit: of parts by their first member and size, which tell them apart.
    let mut rejected = std::collections::HashSet::new();
    for _ in 0..ROUNDS {
        let name = |j: usize| parts.0[j].members.first().map(|&i| (i, parts.0[j].members.len()));
        let mut pairs: Vec<[usize; 2]> = Vec::new();
        for (j, near) in parts.neighbors(count).iter().enumerate() {
            pairs.extend(near.iter().map(|&k| [j.min(k), j.max(k)]));
        }
        pairs.sort_unstable();
        pairs.dedup();
        pairs.retain(|pair| !rejected.contains(&pair.map(name)));
        let tried: Vec<Option<Part>> =
            pairs.par_iter().map(|&[a, b]| joint(tracks, &parts.0[a], &parts.0[b], bound)).collect();
        let mut fitting: Vec<(f64, [usize; 2], Part)> = Vec::new();
        for (pair, part) in pairs.into_iter().zip(tried) {
            match part {
                Some(part) => fitting.push((part.worst(), pair, part)),
                None => {
                    rejected.insert(pair.map(name));
                }
            }
        }
        if fitting.is_empty() {
            break;
        }
        fitting.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut used = vec![false; parts.0.len()];
        for (_, [a, b], part) in fitting {
            if used[a] || used[b] {
                continue;
            }
            (used[a], used[b]) = (true, true);
            parts.0[a] = part;
            parts.0[b] = Part::default();
        }
        parts.0.retain(|part| !part.members.is_empty());
    }
}

/// Both in one, if that stays within the bound.
fn joint(tracks: &Tracks, a: &Part, b: &Part, bound: f64) -> Option<Part> {
    if a.members.len().min(b.members.len()) > SAMPLE {
        let some = members(a, SAMPLE, b);
        if Part::of(tracks, some).worst() > SAMPLE_SLACK * bound {
            return None;
        }
    }
    let all = members(a, usize::MAX, b);
    Some(Part::of(tracks, all)).filter(|part| part.worst() <= bound)
}

/// Members of both, at most `most` of each, in order.
fn members(a: &Part, most: usize, b: &Part) -> Vec<usize> {
    let some = |part: &Part| {
        let step = part.members.len().div_ceil(most).max(1);
        part.members.iter().copied().step_by(step).collect::<Vec<_>>()
    };
    let mut all = some(a);
    all.extend(some(b));
    all.sort_unstable();
    all
}
