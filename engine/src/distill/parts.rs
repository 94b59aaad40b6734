//! A division of the moving Gaussians into parts, each with a moving frame.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::rigid::{Frame, Sums};
use super::tracks::{Rest, Tracks};
use crate::edit::outer;

/// Rounds of frames and rest positions in a fit.
const ROUNDS: usize = 2;
/// How much the directions of axes count in a fit, as a share of the mean square distance of the points: of points in a row they
/// decide the turn around it.
const DIRECTIONS: f64 = 1.0e-3;
/// Times at which the distance of parts is taken.
pub(super) const FEATURE_TIMES: usize = 8;

/// Gaussians that move together.
#[derive(Debug, Clone, Default)]
pub(super) struct Part {
    /// Indices into the tracks, ascending.
    pub(super) members: Vec<usize>,
    /// `[T]`; nothing moves at the middle time.
    pub(super) frames: Vec<Frame>,
    /// Of each member, how far it is from where the frames take it at most, pixels.
    pub(super) residual: Vec<f64>,
    /// Of each member, where it rests.
    pub(super) rest: Vec<Rest>,
    /// Mean centre at some times.
    place: [DVec3; FEATURE_TIMES],
}

impl Part {
    /// The part of these Gaussians, with the frames that suit them best.
    pub(super) fn of(tracks: &Tracks, members: Vec<usize>) -> Self {
        Self::weighted(tracks, members, |_| 1.0)
    }

    /// The same where each Gaussian counts as `share` (by its place among the members) says.
    pub(super) fn weighted(tracks: &Tracks, members: Vec<usize>, share: impl Fn(usize) -> f64) -> Self {
        let mut rest: Vec<Rest> = members.iter().map(|&i| tracks.first_rest(i)).collect();
        let mut part = Self { place: place(tracks, &members), members, ..Self::default() };
        for round in 0..ROUNDS {
            part.frames = fit(tracks, &part.members, &rest, &share);
            // One Gaussian has the frames that it says itself.
            if part.members.len() > 1 || round + 1 == ROUNDS {
                (rest, part.residual) = part.rests(tracks);
            }
        }
        part.rest = rest;
        part
    }

    fn rests(&self, tracks: &Tracks) -> (Vec<Rest>, Vec<f64>) {
        let mut work = Vec::with_capacity(tracks.times);
        let of = |i: &usize| tracks.in_frame(*i, &self.frames, f64::INFINITY, &mut work);
        self.members.iter().map(of).unzip()
    }

    /// The largest distance of a member from where it should be, pixels.
    pub(super) fn worst(&self) -> f64 {
        self.residual.iter().copied().fold(0.0, f64::max)
    }

    /// What is above `bound`, weighted by how much it shows.
    pub(super) fn excess(&self, tracks: &Tracks, bound: f64) -> f64 {
        let all = self.members.iter().zip(&self.residual);
        all.map(|(&i, r)| f64::from(tracks.opacity[i]) * (r - bound).clamp(0.0, 100.0)).sum()
    }
}

/// Frames that take the members' rest positions to where they are.
fn fit(tracks: &Tracks, members: &[usize], rest: &[Rest], share: &impl Fn(usize) -> f64) -> Vec<Frame> {
    let Some(&first) = members.first() else { return vec![Frame::IDENTITY; tracks.times] };
    // About the first member: in f64 small parts far from the origin keep their digits.
    let origin = rest[0].center;
    let origins: Vec<DVec3> = tracks.of(first).iter().map(|p| p.center.as_dvec3()).collect();
    let mut sums = vec![Sums::ZERO; tracks.times];
    let count = members.len() as f64;
    let middle = rest.iter().map(|r| r.center - origin).sum::<DVec3>() / count;
    let spread = rest.iter().map(|r| (r.center - origin).distance_squared(middle)).sum::<f64>() / count;
    for (k, (&i, rest)) in members.iter().zip(rest).enumerate() {
        let weight = tracks.weight(i) * share(k);
        let center = rest.center - origin;
        let ends = rest.axes.map(|a| center + a);
        let x = weight * (center + ends[0] + ends[1]);
        // Directions count beside points.
        let beside = |a: DVec3| a * (DIRECTIONS * spread / a.length_squared().max(f64::MIN_POSITIVE));
        let of_axes = [0, 1].map(|k| weight * (ends[k] + beside(rest.axes[k])));
        for ((sum, p), origin) in sums.iter_mut().zip(tracks.of(i)).zip(&origins) {
            let (y, axes) = (p.center.as_dvec3() - *origin, p.axes.map(|a| a.as_dvec3()));
            sum.weight += 3.0 * weight;
            sum.x += x;
            sum.y += weight * (3.0 * y + axes[0] + axes[1]);
            sum.yx += outer(y, x) + outer(axes[0], of_axes[0]) + outer(axes[1], of_axes[1]);
        }
    }
    let mut frames: Vec<Frame> = sums.iter().map(Sums::fit).collect();
    for (frame, at) in frames.iter_mut().zip(&origins) {
        frame.shift += *at - frame.turn * origin;
    }
    // Nothing moves at the middle time.
    let middle = frames[tracks.middle];
    frames.iter_mut().for_each(|frame| *frame = tidy(frame.after_inverse_of(&middle)));
    frames
}

/// The same without the rounding of two rotations.
fn tidy(frame: Frame) -> Frame {
    Frame { turn: DMat3::from_quat(glam::DQuat::from_mat3(&frame.turn).normalize()), ..frame }
}

/// Mean centres at times spread over all.
fn place(tracks: &Tracks, members: &[usize]) -> [DVec3; FEATURE_TIMES] {
    let count = members.len().max(1) as f64;
    feature_times(tracks.times)
        .map(|t| members.iter().map(|&i| tracks.of(i)[t].center.as_dvec3()).sum::<DVec3>() / count)
}

/// Indices of times spread over all `times`.
pub(super) fn feature_times(times: usize) -> [usize; FEATURE_TIMES] {
    std::array::from_fn(|k| k * times.saturating_sub(1) / (FEATURE_TIMES - 1))
}

/// A division.
#[derive(Debug, Clone, Default)]
pub(super) struct Parts(pub(super) Vec<Part>);

impl Parts {
    /// The parts of these lists; empty ones are left out.
    pub(super) fn of(tracks: &Tracks, lists: Vec<Vec<usize>>) -> Self {
        Self(lists.into_par_iter().filter(|l| !l.is_empty()).map(|l| Part::of(tracks, l)).collect())
    }

    /// For each part the `count` nearest others.
    pub(super) fn neighbors(&self, count: usize) -> Vec<Vec<usize>> {
        let of = |j: usize| nearest_of(&self.0, &self.0[j].place, j, count);
        (0..self.0.len()).into_par_iter().map(of).collect()
    }

    /// What is above `bound` in all parts, weighted by how much it shows.
    pub(super) fn excess(&self, tracks: &Tracks, bound: f64) -> f64 {
        self.0.par_iter().map(|part| part.excess(tracks, bound)).sum()
    }

    /// The `count` parts nearest to a Gaussian.
    pub(super) fn nearest(&self, tracks: &Tracks, i: usize, count: usize) -> Vec<usize> {
        let path = feature_times(tracks.times).map(|t| tracks.of(i)[t].center.as_dvec3());
        nearest_of(&self.0, &path, usize::MAX, count)
    }

    /// Gives parts more Gaussians, and fits those parts again.
    pub(super) fn extend(&mut self, tracks: &Tracks, more: Vec<Vec<usize>>) {
        self.0.par_iter_mut().zip(more).filter(|(_, more)| !more.is_empty()).for_each(|(part, more)| {
            let mut members = std::mem::take(&mut part.members);
            members.extend(more);
            members.sort_unstable();
            *part = Part::of(tracks, members);
        });
    }

    /// Every Gaussian that is farther than `content` pixels from where its part takes it goes to that of the `count`
    /// nearest parts that suits it best, if that is better. Returns how many went.
    pub(super) fn reassign(&mut self, tracks: &Tracks, content: f64, count: usize) -> usize {
        let neighbors = self.neighbors(count);
        let parts = &self.0;
        let of_part = |j: usize| -> Vec<(usize, usize)> {
            let mut work = Vec::with_capacity(tracks.times);
            let part = &parts[j];
            let unhappy = part.members.iter().zip(&part.residual).filter(|(_, r)| **r > content);
            let best = |(&i, &residual): (&usize, &f64)| {
                let mut best = (j, 0.99 * residual);
                for &k in &neighbors[j] {
                    let (_, r) = tracks.in_frame(i, &parts[k].frames, best.1, &mut work);
                    if r < best.1 {
                        best = (k, r);
                    }
                }
                (best.0 != j).then_some((i, best.0))
            };
            unhappy.filter_map(best).collect()
        };
        let goes: Vec<Vec<(usize, usize)>> = (0..parts.len()).into_par_iter().map(of_part).collect();
        let count = goes.iter().map(Vec::len).sum();
        self.apply(tracks, &goes);
        count
    }

    /// Moves Gaussians from each part to others, and fits those parts again.
    fn apply(&mut self, tracks: &Tracks, goes: &[Vec<(usize, usize)>]) {
        let mut changed: Vec<Option<Vec<usize>>> = vec![None; self.0.len()];
        for (j, list) in goes.iter().enumerate().filter(|(_, list)| !list.is_empty()) {
            let leaving: Vec<usize> = list.iter().map(|(i, _)| *i).collect();
            let members = changed[j].get_or_insert_with(|| self.0[j].members.clone());
            // Both lists ascend, but for those that came from other parts.
            members.retain(|i| leaving.binary_search(i).is_err());
            for &(i, k) in list {
                changed[k].get_or_insert_with(|| self.0[k].members.clone()).push(i);
            }
        }
        self.0.par_iter_mut().zip(changed).for_each(|(part, members)| {
            if let Some(mut members) = members {
                members.sort_unstable();
                *part = Part::of(tracks, members);
            }
        });
        self.0.retain(|part| !part.members.is_empty());
    }
}

/// The `count` parts whose mean paths are nearest to a path, but for one.
fn nearest_of(parts: &[Part], path: &[DVec3; FEATURE_TIMES], but: usize, count: usize) -> Vec<usize> {
    let distance = |part: &Part| -> f64 { part.place.iter().zip(path).map(|(p, q)| p.distance_squared(*q)).sum() };
    let others = (0..parts.len()).filter(|&k| k != but);
    let mut near: Vec<(f64, usize)> = others.map(|k| (distance(&parts[k]), k)).collect();
    if near.len() > count {
        near.select_nth_unstable_by(count, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        near.truncate(count);
    }
    near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    near.into_iter().map(|(_, k)| k).collect()
}
