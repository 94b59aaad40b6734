//! How a part stands at the times of the photos, corrected by what is fixed to it.

use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;

use super::super::rigid::Frame;
use super::band::Band;
use super::look::Look;
use super::shape::Shape;
use crate::reference::exp_quaternion;
use crate::train::lost::seed::median_colour;

/// Cells of an object that pull at its poses.
const MOST_PULLING: usize = 300;
/// Pixels from where a photo differs at which a cell pulls half as much, by the square, and at which no more: it is hidden there.
const HALF: f64 = 2.0;
const HIDDEN: f64 = 6.0;
/// How much corrections are held to go on evenly over time, in units of a cell that pulls, and to be none, in pixels.
const EVENLY: f64 = 30.0;
const NONE_TURN: f64 = 0.1;
const NONE_SHIFT: f64 = 0.5;
/// An object that has hardly begun turns no more easily than one of so many cells.
const SHORTEST: f64 = 5.0;
/// What is added to the diagonal: a share of it, and a little where nothing is known.
const DAMPING: [f64; 2] = [0.01, 1e-6];
/// Numbers of a pose.
const POSE: usize = 6;

/// A place of a part, and the part's turns, at each time.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Path {
    /// As the part goes: a point of it, from the place on, to the world.
    given: Vec<Frame>,
    /// By how much these are corrected: rotation vector about the place, and shift.
    corrections: Vec<[DVec3; 2]>,
    /// With the corrections.
    frames: Vec<Frame>,
    /// It goes by itself: photos have no vote on what the model hides. A part hides what is behind it, and its outline, where that is
    /// blurred, would seem to be an object that goes with it.
    is_alone: bool,
}

impl Path {
    /// Of a place in the frame of a part; `[times][M]` frames.
    pub(super) fn of_part(frames: &[Vec<Frame>], part: usize, at: DVec3) -> Self {
        let of_part = frames.iter().map(|of_time| of_time[part]);
        let given = of_part.map(|f| Frame { turn: f.turn, shift: f.apply(at) }).collect();
        Self { is_alone: false, ..Self::alone(given) }
    }

    /// Of points from a place on, as they stand at each time, of nothing that the model has.
    pub(super) fn alone(given: Vec<Frame>) -> Self {
        let corrections = vec![[DVec3::ZERO; 2]; given.len()];
        Self { corrections, frames: given.clone(), given, is_alone: true }
    }

    /// Its turn from the part's frame at a time.
    pub(super) fn turn(&self, time: usize) -> DQuat {
        DQuat::from_mat3(&self.frames[time].turn).normalize()
    }

    /// Where a point of the part, from the place on, is at a time.
    pub(super) fn place(&self, time: usize, point: DVec3) -> DVec3 {
        self.frames[time].apply(point)
    }

    /// World units of a pixel, in the middle of the photos; `None` where none shows it.
    pub(super) fn pixel(&self, looks: &[Look]) -> Option<f64> {
        let mut sizes: Vec<f64> = looks.iter().filter_map(|l| l.pixel(self.frames[l.time].shift)).collect();
        sizes.sort_by(f64::total_cmp);
        sizes.get(sizes.len() / 2).copied()
    }

    /// Pixels between a place and what a photo differs in; `None` where the photo does not have it.
    fn distance(&self, look: &Look, place: DVec3) -> Option<f32> {
        look.distance(place).filter(|_| !(self.is_alone && look.is_hidden(place)))
    }

    /// Share of the photos that differ where they have a point of the part; 0 where less than so many of them have it.
    pub(super) fn share<L: std::borrow::Borrow<Look>>(&self, point: DVec3, looks: &[L], within: f32, have: f64) -> f64 {
        let has = |l: &L| self.distance(l.borrow(), self.place(l.borrow().time, point));
        let (count, near) =
            looks.iter().filter_map(has).fold((0, 0), |(n, k), d| (n + 1, k + usize::from(d <= within)));
        if f64::from(count) < have * looks.len() as f64 { 0.0 } else { near as f64 / f64::from(count.max(1)) }
    }

    /// Share of these points that lie where a photo differs, as they stand so many times later; `None` where it has none of them, or hides most.
    pub(super) fn share_of(&self, points: &[DVec3], look: &Look, within: f32, later: usize) -> Option<f64> {
        let time = (look.time + later) % self.frames.len();
        let distances = points.iter().filter_map(|p| self.distance(look, self.place(time, *p)));
        let (count, near) = distances.fold((0, 0), |(n, k), d| (n + 1, k + usize::from(d <= within)));
        let fewest = if self.is_alone { points.len().div_ceil(2) } else { 1 };
        (count as usize >= fewest.max(1)).then(|| near as f64 / f64::from(count))
    }

    /// The same on average over photos.
    pub(super) fn mean_share(&self, points: &[DVec3], looks: &[&Look], within: f32, later: usize) -> f64 {
        let shares: Vec<f64> = looks.iter().filter_map(|l| self.share_of(points, l, within, later)).collect();
        shares.iter().sum::<f64>() / shares.len().max(1) as f64
    }

    /// The median colour of a point of the part, where photos that differ have it; `None` where none does.
    pub(super) fn colour(&self, point: DVec3, looks: &[Look]) -> Option<[u8; 3]> {
        let seen: Vec<[f32; 4]> = looks.iter().filter_map(|l| l.colour(self.place(l.time, point))).collect();
        median_colour(&seen)
    }

    /// One step of Gauss and Newton: the cells of an object come to lie where these photos differ. Times without photos lie between
    /// their neighbours.
    pub(super) fn correct(&mut self, shape: &Shape, looks: &[&Look], times: &[f32]) {
        let mut used: Vec<usize> = looks.iter().map(|l| l.time).collect();
        used.sort_unstable();
        used.dedup();
        let row = |time: usize| used.partition_point(|t| *t < time);
        let points = shape.some(MOST_PULLING);
        let mut a = Band::new(POSE * used.len(), 3 * POSE - 1);
        let mut b = vec![0.0; POSE * used.len()];
        let pulls: Vec<Pull> = looks.par_iter().map(|l| self.pull(&points, l)).collect();
        for (look, pull) in looks.iter().zip(&pulls) {
            pull.add(row(look.time), MOST_PULLING as f64 / points.len().max(1) as f64, &mut a, &mut b);
        }
        self.hold(&used, times, shape, &mut a, &mut b);
        a.damp(DAMPING[0], DAMPING[1]);
        let Some(x) = a.solve(b) else { return };
        for (&time, step) in used.iter().zip(x.as_chunks::<POSE>().0) {
            let [turn, shift] = [0, 3].map(|k| DVec3::from_slice(&step[k..k + 3]));
            let [old_turn, old_shift] = self.corrections[time];
            self.corrections[time] = [old_turn + turn, old_shift + shift];
        }
        self.fill(&used, times);
        for ((frame, given), [turn, shift]) in self.frames.iter_mut().zip(&self.given).zip(&self.corrections) {
            let turn = DMat3::from_quat(exp_quaternion(*turn)) * given.turn;
            *frame = Frame { turn, shift: given.shift + *shift };
        }
    }

    /// What a photo wants of a pose.
    fn pull(&self, points: &[DVec3], look: &Look) -> Pull {
        let centre = self.place(look.time, DVec3::ZERO);
        let mut pull = Pull::default();
        for point in points {
            let at = self.place(look.time, *point);
            let is_seen = self.distance(look, at).is_some();
            let Some((distance, by)) = look.slope(at).filter(|(d, _)| is_seen && *d < HIDDEN) else { continue };
            let weight = 1.0 / (1.0 + (distance / HALF).powi(2));
            pull.take((at - centre).cross(by), by, weight, distance);
        }
        pull
    }

    /// Adds that corrections go on evenly over time, and are small.
    fn hold(&self, used: &[usize], times: &[f32], shape: &Shape, a: &mut Band, b: &mut [f64]) {
        let px = 1.0 / shape.cell;
        let reach = shape.reach().max(SHORTEST);
        let component = |time: usize, k: usize| self.corrections[time][k / 3][k % 3];
        for (i, w) in used.windows(3).enumerate() {
            let [before, at, after] = [w[0], w[1], w[2]].map(|t| f64::from(times[t]));
            let first = (after - at) / (after - before);
            let row = [-first, 1.0, first - 1.0];
            for k in 0..POSE {
                let scale = if k < 3 { reach } else { px }.powi(2) * EVENLY;
                let bend: f64 = (0..3).map(|j| row[j] * component(w[j], k)).sum();
                for (j, share) in row.iter().enumerate() {
                    b[POSE * (i + j) + k] -= scale * share * bend;
                    (0..3).for_each(|l| a.add(POSE * (i + j) + k, POSE * (i + l) + k, scale * share * row[l]));
                }
            }
        }
        for (i, &time) in used.iter().enumerate() {
            for k in 0..POSE {
                let scale = if k < 3 { NONE_TURN * reach } else { NONE_SHIFT * px }.powi(2);
                a.add(POSE * i + k, POSE * i + k, scale);
                b[POSE * i + k] -= scale * component(time, k);
            }
        }
    }

    /// Corrections of times that were not used.
    fn fill(&mut self, used: &[usize], times: &[f32]) {
        for time in 0..times.len() {
            let next = used.partition_point(|t| *t < time);
            if used.get(next) == Some(&time) {
                continue;
            }
            let [a, b] = [next.saturating_sub(1), next.min(used.len() - 1)].map(|k| used[k]);
            let share = if a == b { 0.0 } else { f64::from(times[time] - times[a]) / f64::from(times[b] - times[a]) };
            let [from, to] = [self.corrections[a], self.corrections[b]];
            self.corrections[time] = std::array::from_fn(|k| from[k].lerp(to[k], share));
        }
    }
}

/// Normal equations of one pose.
#[derive(Debug, Clone, Copy, Default)]
struct Pull {
    /// JᵀJ by turn and turn, shift and turn, shift and shift.
    blocks: [DMat3; 3],
    right: [DVec3; 2],
}

impl Pull {
    fn take(&mut self, turn: DVec3, shift: DVec3, weight: f64, distance: f64) {
        let outer = |a: DVec3, b: DVec3| DMat3::from_cols(a * b.x, a * b.y, a * b.z) * weight;
        self.blocks[0] += outer(turn, turn);
        self.blocks[1] += outer(shift, turn);
        self.blocks[2] += outer(shift, shift);
        self.right[0] -= turn * (weight * distance);
        self.right[1] -= shift * (weight * distance);
    }

    /// To the rows of the `pose`th one, so many times.
    fn add(&self, pose: usize, times: f64, a: &mut Band, b: &mut [f64]) {
        let at = POSE * pose;
        for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
            a.add(at + i, at + j, times * self.blocks[0].col(j)[i]);
            a.add(at + 3 + i, at + j, times * self.blocks[1].col(j)[i]);
            a.add(at + 3 + i, at + 3 + j, times * self.blocks[2].col(j)[i]);
        }
        for k in 0..POSE {
            b[at + k] += times * self.right[k / 3][k % 3];
        }
    }
}
