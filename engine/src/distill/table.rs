//! Frames as a key-time table: rotation vectors that go on beyond π, and the fewest key times.

use glam::{DQuat, DVec3};
use rayon::prelude::*;

use super::parts::{Part, Parts};
use super::rigid::Frame;
use super::tracks::Tracks;
use crate::edit::unwrapped;
use crate::reference::exp;
use crate::scene::Motion;
use crate::train::bake::fewest_keys;

/// Rotation vectors longer than this begin anew where they no longer follow the turn: near 2π, where no turn at all has every
/// axis, a path of rotations that passes by has no continuous vectors. Two keys one f32 apart take over.
const LONGEST: f64 = 4.0;
/// How much longer than the turn between two times a step of the vector is there.
const STRETCHED: f64 = 2.5;

/// Poses at all sampled times.
#[derive(Debug)]
pub(super) struct Table {
    times: Vec<f64>,
    /// `[T]` whether a superpoint's vector begins anew.
    jumps: Vec<bool>,
    poses: Vec<Poses>,
}

/// Poses of a superpoint `[T]`, rounded as they are stored.
#[derive(Debug)]
struct Poses {
    /// The vector at the end of the interval before, and at the beginning of the one after.
    before: Vec<DVec3>,
    after: Vec<DVec3>,
    shift: Vec<DVec3>,
}

impl Table {
    pub(super) fn new(times: Vec<f64>, middle: usize, parts: &Parts) -> Self {
        let poses: Vec<Poses> = parts.0.par_iter().map(|part| Poses::of(&part.frames, middle)).collect();
        let jumps = (0..times.len()).map(|k| poses.iter().any(|p| p.before[k] != p.after[k])).collect();
        Self { times, jumps, poses }
    }

    /// The fewest times between which no probe of a Gaussian is off by more than `bound` pixels at the others; or by `more` than
    /// at best, where that is above the bound.
    pub(super) fn keys(&self, tracks: &Tracks, parts: &Parts, bound: f64, more: f64) -> Vec<usize> {
        let fits = |a: usize, b: usize| {
            let is_off = |(part, poses): (&Part, &Poses)| self.is_off(tracks, part, poses, [a, b], [bound, more]);
            !self.jumps[a + 1..b].contains(&true) && !parts.0.par_iter().zip(&self.poses).any(is_off)
        };
        fewest_keys(self.times.len() - 1, fits)
    }

    fn is_off(&self, tracks: &Tracks, part: &Part, poses: &Poses, [a, b]: [usize; 2], [bound, more]: [f64; 2]) -> bool {
        (a + 1..b).any(|k| {
            let frame = poses.between([a, b], (self.times[k] - self.times[a]) / (self.times[b] - self.times[a]));
            part.members.iter().zip(&part.rest).zip(&part.residual).any(|((&i, rest), residual)| {
                let p = tracks.of(i)[k];
                let off = frame.apply(rest.center) - p.center.as_dvec3();
                let end = |axis: usize| off + frame.turn * rest.axes[axis] - p.axes[axis].as_dvec3();
                let largest = off.length_squared().max(end(0).length_squared()).max(end(1).length_squared());
                largest.sqrt() * f64::from(p.reach) > bound.max(residual + more)
            })
        })
    }

    /// The table at these times; with `still` there is one superpoint more, which rests.
    pub(super) fn motion(&self, keys: &[usize], still: bool) -> Motion {
        let mut motion = Motion::default();
        let mut row = |time: f32, rotation: &dyn Fn(&Poses) -> DVec3, k: usize| {
            let rest = still.then_some([0.0; 3]);
            motion.times.push(time);
            motion.rotation.extend(self.poses.iter().map(|p| rotation(p).as_vec3().to_array()).chain(rest));
            motion.translation.extend(self.poses.iter().map(|p| p.shift[k].as_vec3().to_array()).chain(rest));
        };
        for &k in keys {
            let time = self.times[k] as f32;
            row(time, &|p| p.before[k], k);
            if self.jumps[k] {
                row(time.next_up(), &|p| p.after[k], k);
            }
        }
        motion
    }
}

impl Poses {
    fn of(frames: &[Frame], middle: usize) -> Self {
        let turns: Vec<DQuat> = frames.iter().map(|f| DQuat::from_mat3(&f.turn).normalize()).collect();
        let mut poses = Self {
            before: vec![DVec3::ZERO; frames.len()],
            after: vec![DVec3::ZERO; frames.len()],
            shift: frames.iter().map(|f| f.shift.as_vec3().as_dvec3()).collect(),
        };
        let mut last = DVec3::ZERO;
        for k in middle + 1..frames.len() {
            let (from, to) = step(&turns, [k - 1, k], last);
            poses.after[k - 1] = from;
            (poses.before[k], poses.after[k], last) = (to, to, to);
        }
        last = DVec3::ZERO;
        for k in (0..middle).rev() {
            let (from, to) = step(&turns, [k + 1, k], last);
            poses.before[k + 1] = from;
            (poses.before[k], poses.after[k], last) = (to, to, to);
        }
        let round = |r: &mut DVec3| *r = r.as_vec3().as_dvec3();
        poses.before.iter_mut().chain(&mut poses.after).for_each(round);
        poses
    }

    fn between(&self, [a, b]: [usize; 2], weight: f64) -> Frame {
        let lerp = |p: DVec3, q: DVec3| p * (1.0 - weight) + q * weight;
        Frame { turn: exp(lerp(self.after[a], self.before[b])), shift: lerp(self.shift[a], self.shift[b]) }
    }
}

/// The vectors with which a step from one time to another begins and ends, after `last` at the first.
fn step(turns: &[DQuat], [from, to]: [usize; 2], last: DVec3) -> (DVec3, DVec3) {
    let next = unwrapped(turns[to], last);
    let angle = (turns[to] * turns[from].conjugate()).to_scaled_axis().length();
    let angle = angle.min(std::f64::consts::TAU - angle);
    if last.length() <= LONGEST || next.distance(last) <= STRETCHED * angle + 1.0e-6 {
        return (last, next);
    }
    let anew = unwrapped(turns[from], DVec3::ZERO);
    (anew, unwrapped(turns[to], anew))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;

    fn frames(turn: impl Fn(f64) -> DQuat) -> Vec<Frame> {
        let at = |k: usize| Frame { turn: DMat3::from_quat(turn(k as f64 / 128.0)), shift: DVec3::ZERO };
        let all: Vec<Frame> = (0..=128).map(at).collect();
        all.iter().map(|f| f.after_inverse_of(&all[64])).collect()
    }

    /// Largest angle between poses interpolated halfway and the exact ones, and how often vectors begin anew.
    fn halfway(turn: impl Fn(f64) -> DQuat) -> (f64, usize) {
        let poses = Poses::of(&frames(&turn), 64);
        let middle = turn(0.5).conjugate();
        let off = |k: usize| {
            let exact = DMat3::from_quat(turn((k as f64 + 0.5) / 128.0) * middle);
            let d = poses.between([k, k + 1], 0.5).turn.transpose() * exact;
            DQuat::from_mat3(&d).to_scaled_axis().length()
        };
        let jumps = (0..=128).filter(|&k| poses.before[k] != poses.after[k]).count();
        ((0..128).map(off).fold(0.0, f64::max), jumps)
    }

    #[test]
    fn spins_of_many_turns_have_one_vector() {
        let axis = DVec3::new(1.0, 2.0, -0.5).normalize();
        let (off, jumps) = halfway(|t| DQuat::from_axis_angle(axis, 7.0 * std::f64::consts::TAU * t));
        assert!(off < 1e-5 && jumps == 0, "{off}, {jumps}");
    }

    #[test]
    fn tumbling_past_whole_turns_begins_anew() {
        let tumble = |t: f64| {
            let wobble = DQuat::from_axis_angle(DVec3::X, 0.9 * (9.0 * t).sin());
            wobble * DQuat::from_axis_angle(DVec3::Z, 15.0 * t)
        };
        let (off, jumps) = halfway(tumble);
        assert!(off < 0.02 && (1..8).contains(&jumps), "{off}, {jumps}");
    }
}
