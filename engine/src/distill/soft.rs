//! Blend weights for Gaussians that no rigid part follows within the bound, where there are as many parts as may be.
//!
//! A Gaussian at x moves with its own part and some neighbours: μ(t) = Σ w_k T_k(t) x. The weights, at least 0 with a sum of 1, are the
//! least squares fit to its path; with at most four parts every choice of those that take part is tried (an active set small enough to
//! enumerate). They are kept where they bring the largest distance down by enough.

use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;

use super::parts::Parts;
use super::rigid::Frame;
use super::tracks::{Rest, Tracks};
use crate::reference::aligned_sum;
use crate::scene::Blend;

/// Neighbours whose motion is tried beside a Gaussian's own part.
const TRIED: usize = Blend::MOST_NEIGHBORS - 1;
/// A blend has to bring the largest distance below this share of what it is.
const GAIN: f64 = 0.8;
/// Weights below this are none.
const LEAST: f64 = 1.0e-3;

/// A Gaussian that moves with several parts.
#[derive(Debug, Clone)]
pub(super) struct Soft {
    /// Which.
    pub(super) track: usize,
    /// Where it rests.
    pub(super) rest: Rest,
    /// Parts and weights, which sum to 1; the first is heaviest.
    pub(super) slots: Vec<(usize, f64)>,
}

/// The Gaussians of `parts` that are farther than `bound` pixels off, and that a blend suits better.
pub(super) fn soften(tracks: &Tracks, parts: &Parts, bound: f64) -> Vec<Soft> {
    let neighbors = parts.neighbors(TRIED);
    let of_part = |j: usize| {
        let part = &parts.0[j];
        let over = part.members.iter().zip(&part.residual).filter(|(_, r)| **r > bound);
        let tried: Vec<usize> = [j].into_iter().chain(neighbors[j].iter().copied()).collect();
        over.filter_map(|(&i, &residual)| blended(tracks, parts, i, &tried, GAIN * residual)).collect::<Vec<_>>()
    };
    (0..parts.0.len()).into_par_iter().flat_map_iter(of_part).collect()
}

/// A blend of some of the parts `tried` that stays below `most` pixels.
fn blended(tracks: &Tracks, parts: &Parts, i: usize, tried: &[usize], most: f64) -> Option<Soft> {
    let rest = tracks.first_rest(i);
    // Sums of squares and products of where each part takes the point, from where it is.
    let mut gram = [[0.0; Blend::MOST_NEIGHBORS]; Blend::MOST_NEIGHBORS];
    for (t, p) in tracks.of(i).iter().enumerate() {
        let reach = f64::from(p.reach);
        let off = |j: &usize| reach * (parts.0[*j].frames[t].apply(rest.center) - p.center.as_dvec3());
        let off: Vec<DVec3> = tried.iter().map(off).collect();
        for (a, x) in off.iter().enumerate() {
            off.iter().enumerate().for_each(|(b, y)| gram[a][b] += x.dot(*y));
        }
    }
    let weights = simplex_least_squares(&gram, tried.len());
    let mut slots: Vec<(usize, f64)> = tried.iter().copied().zip(weights).filter(|(_, w)| *w >= LEAST).collect();
    slots.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    let sum: f64 = slots.iter().map(|(_, w)| w).sum();
    slots.iter_mut().for_each(|(_, w)| *w /= sum);
    let soft = Soft { track: i, rest, slots };
    (soft.slots.len() > 1 && soft.worst(tracks, parts) < most).then_some(soft)
}

impl Soft {
    /// The largest distance of a probe from where the blend takes it, pixels.
    fn worst(&self, tracks: &Tracks, parts: &Parts) -> f64 {
        let at = |t: usize| {
            let frames: Vec<(f64, Frame)> = self.slots.iter().map(|&(j, w)| (w, parts.0[j].frames[t])).collect();
            let p = tracks.of(self.track)[t];
            let off = frames.iter().map(|(w, f)| *w * f.apply(self.rest.center)).sum::<DVec3>() - p.center.as_dvec3();
            let turns: Vec<(f64, DQuat)> = frames.iter().map(|(w, f)| (*w, DQuat::from_mat3(&f.turn))).collect();
            let turn = DMat3::from_quat(aligned_sum(&turns).normalize());
            let end = |k: usize| (off + turn * self.rest.axes[k] - p.axes[k].as_dvec3()).length();
            off.length().max(end(0)).max(end(1)) * f64::from(p.reach)
        };
        (0..tracks.times).map(at).fold(0.0, f64::max)
    }
}

/// Weights w ≥ 0 with a sum of 1 and the smallest wᵀGw: the best over all sets of weights above 0.
fn simplex_least_squares(gram: &[[f64; Blend::MOST_NEIGHBORS]; Blend::MOST_NEIGHBORS], count: usize) -> Vec<f64> {
    let mut best = (f64::INFINITY, vec![0.0; count]);
    for set in 1_usize..1 << count {
        let used: Vec<usize> = (0..count).filter(|k| set >> k & 1 == 1).collect();
        let Some(w) = on_plane(gram, &used) else { continue };
        if w.iter().any(|w| *w < 0.0) {
            continue;
        }
        let value: f64 = used
            .iter()
            .zip(&w)
            .map(|(&a, wa)| used.iter().zip(&w).map(|(&b, wb)| wa * wb * gram[a][b]).sum::<f64>())
            .sum();
        if value < best.0 {
            let mut all = vec![0.0; count];
            used.iter().zip(&w).for_each(|(&k, w)| all[k] = *w);
            best = (value, all);
        }
    }
    best.1
}

/// The smallest wᵀGw with a sum of 1: G w ∝ 1, by elimination with the largest pivots; a little is added to the diagonal.
fn on_plane(gram: &[[f64; Blend::MOST_NEIGHBORS]; Blend::MOST_NEIGHBORS], used: &[usize]) -> Option<Vec<f64>> {
    let n = used.len();
    let trace: f64 = used.iter().map(|&k| gram[k][k]).sum();
    let mut rows: Vec<Vec<f64>> = used
        .iter()
        .enumerate()
        .map(|(r, &a)| {
            let row = used.iter().enumerate();
            let mut row: Vec<f64> =
                row.map(|(c, &b)| gram[a][b] + if r == c { 1.0e-9 * trace + 1.0e-30 } else { 0.0 }).collect();
            row.push(1.0);
            row
        })
        .collect();
    for k in 0..n {
        let pivot = (k..n).fold(k, |best, r| if rows[r][k].abs() > rows[best][k].abs() { r } else { best });
        rows.swap(k, pivot);
        let lead = rows[k].clone();
        if lead[k] == 0.0 {
            return None;
        }
        for r in (0..n).filter(|&r| r != k) {
            let factor = rows[r][k] / lead[k];
            rows[r].iter_mut().zip(&lead).for_each(|(v, l)| *v -= factor * l);
        }
    }
    let w: Vec<f64> = (0..n).map(|k| rows[k][n] / rows[k][k]).collect();
    let sum: f64 = w.iter().sum();
    (sum.is_finite() && sum.abs() > 0.0).then(|| w.iter().map(|w| w / sum).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_those_that_made_the_point_or_the_nearest() {
        // Offsets at three times of four parts; the point is 0.2, 0.3, 0.5, 0 of them.
        let parts = [DVec3::new(3.0, 0.0, 1.0), DVec3::new(0.0, 2.0, -1.0), DVec3::ZERO, DVec3::new(5.0, 5.0, 5.0)];
        let made = 0.2 * parts[0] + 0.3 * parts[1] + 0.5 * parts[2];
        let gram = |at: DVec3| {
            let mut g = [[0.0; 4]; 4];
            for a in 0..4 {
                (0..4).for_each(|b| g[a][b] = (parts[a] - at).dot(parts[b] - at));
            }
            g
        };
        let w = simplex_least_squares(&gram(made), 4);
        let back: DVec3 = parts.iter().zip(&w).map(|(p, w)| *p * *w).sum();
        assert!(back.distance(made) < 1e-4 && (w.iter().sum::<f64>() - 1.0).abs() < 1e-12, "{w:?}");
        // Outside: one of them alone, and weights stay above 0.
        let w = simplex_least_squares(&gram(DVec3::new(20.0, 20.0, 20.0)), 4);
        assert!((w[3] - 1.0).abs() < 1e-6 && w.iter().all(|w| *w >= 0.0), "{w:?}");
    }
}
