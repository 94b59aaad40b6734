//! Key poses that learn, in f64 on the host, as the kernels are to do it: Adam of the two keys around each step's time, and terms
//! that hold them to where they began.
//!
//! A key is a vector r and the place x = Exp(r)p + τ of its superpoint's centre p: so a turn does not swing what lies far from the
//! world's origin. With the gradients ω (by a left tangent, τ held) and g (by τ) at a time between keys a and b, where r and τ are
//! linear, key k of weight w gets w·g by x and w·(J(r)ᵀω + J(r_k)ᵀ(g × Exp(r_k)p)) by r; J is the left Jacobian of Exp.

use glam::DVec3;

use super::{BETA, EPSILON, KeyOptions, LARGEST_TURN, twin_of};
use crate::error::Result;
use crate::reference::gradient::motion::left_jacobian;
use crate::reference::{Pose, exp};
use crate::scene::Motion;
use crate::train::photo_loss::Twist;

/// Six numbers of a key: turn, shift.
type Six = [DVec3; 2];

/// A key of a superpoint.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Key {
    rotation: DVec3,
    place: DVec3,
    /// Where it began.
    first: Six,
    moment_1: Six,
    /// One of the turn, one of the shift.
    moment_2: [f64; 2],
    updates: i32,
}

/// Which keys a time lies between, and the weight of the second.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Between {
    keys: [usize; 2],
    weight: f64,
}

/// A table that learns.
#[derive(Debug, Clone)]
pub struct Keys {
    options: KeyOptions,
    /// Times alone.
    times: Motion,
    /// `[T,M]`.
    keys: Vec<Key>,
}

impl Keys {
    /// Of a table.
    ///
    /// # Errors
    /// `Usage` for another number of superpoints, no key, or a rate that is not above 0.
    pub fn new(table: &Motion, options: KeyOptions) -> Result<Self> {
        options.check(table)?;
        let m = options.center.len();
        let vector = |v: &[f32; 3]| DVec3::from_array(v.map(f64::from));
        let key = |(at, (r, t)): (usize, (&[f32; 3], &[f32; 3]))| {
            let rotation = vector(r);
            let place = exp(rotation) * options.center[at % m] + vector(t);
            let first = [rotation, place];
            Key { rotation, place, first, moment_1: [DVec3::ZERO; 2], moment_2: [0.0; 2], updates: 0 }
        };
        let keys = table.rotation.iter().zip(&table.translation).enumerate().map(key).collect();
        let times = Motion { times: table.times.clone(), ..Motion::default() };
        Ok(Self { options, times, keys })
    }

    fn superpoints(&self) -> usize {
        self.options.center.len()
    }

    fn between(&self, time: f64) -> Between {
        let i = self.times.interval(time);
        Between { keys: [i.first as usize, i.second as usize], weight: i.weight }
    }

    fn pose(&self, key: usize, j: usize) -> Pose {
        let Key { rotation, place, .. } = self.keys[key * self.superpoints() + j];
        Pose { rotation, translation: place - exp(rotation) * self.options.center[j] }
    }

    /// The pose of a superpoint.
    fn at(&self, j: usize, b: Between) -> Pose {
        let [p, q] = b.keys.map(|key| self.pose(key, j));
        let lerp = |p: DVec3, q: DVec3| p * (1.0 - b.weight) + q * b.weight;
        Pose { rotation: lerp(p.rotation, q.rotation), translation: lerp(p.translation, q.translation) }
    }

    /// `[M]` at a time.
    pub fn poses(&self, time: f64) -> Vec<Pose> {
        let between = self.between(time);
        (0..self.superpoints()).map(|j| self.at(j, between)).collect()
    }

    /// The table as it is.
    pub fn table(&self) -> Motion {
        let m = self.superpoints();
        let poses = || (0..self.keys.len()).map(|at| self.pose(at / m, at % m));
        let rounded = |v: DVec3| v.as_vec3().to_array();
        Motion {
            times: self.times.times.clone(),
            rotation: poses().map(|p| rounded(p.rotation)).collect(),
            translation: poses().map(|p| rounded(p.translation)).collect(),
        }
    }

    /// A step (from 1) at a time, from `[M]` gradients of the loss by left tangents with τ held, and by τ. What an image does not
    /// show stays.
    pub fn learn(&mut self, iteration: u64, time: f64, gradient: &[Twist]) {
        let (m, between) = (self.superpoints(), self.between(time));
        let (rate, fade) = (self.options.rate(iteration), self.options.fade(iteration));
        for (j, twist) in gradient.iter().enumerate().take(m) {
            let unseen = twist.rotation == DVec3::ZERO && twist.translation == DVec3::ZERO;
            let finite = twist.rotation.is_finite() && twist.translation.is_finite();
            if unseen || !finite || self.options.unit[j] <= 0.0 {
                continue;
            }
            let now = self.at(j, between);
            let ends = if between.keys[0] == between.keys[1] { 1 } else { 2 };
            let weights = if ends == 1 { [1.0, 0.0] } else { [1.0 - between.weight, between.weight] };
            let by_key: Vec<(usize, Six)> = (0..ends)
                .map(|end| (between.keys[end], self.gradient(j, between.keys[end], weights[end], &now, twist)))
                .map(|(key, g)| (key, self.with_terms(j, key, fade, g)))
                .collect();
            for (key, g) in by_key {
                self.update(j, key, rate, g);
            }
        }
    }

    /// By turn and shift of a key, in pixels of what the superpoint moves.
    fn gradient(&self, j: usize, key: usize, weight: f64, now: &Pose, twist: &Twist) -> Six {
        let r = self.keys[key * self.superpoints() + j].rotation;
        let arm = exp(r) * self.options.center[j];
        let turn = left_jacobian(now.rotation).transpose() * twist.rotation
            + left_jacobian(r).transpose() * twist.translation.cross(arm);
        let [by_turn, by_shift] = self.options.scale(j);
        [turn * (weight * by_turn), twist.translation * (weight * by_shift)]
    }

    /// How far a key has gone, pixels.
    fn way(&self, j: usize, key: usize) -> Six {
        let Key { rotation, place, first, .. } = self.keys[key * self.superpoints() + j];
        let [by_turn, by_shift] = self.options.scale(j);
        [(rotation - first[0]) / by_turn, (place - first[1]) / by_shift]
    }

    /// With the terms that hold a key.
    fn with_terms(&self, j: usize, key: usize, fade: f64, g: Six) -> Six {
        let own = self.way(j, key);
        let mut sum = [0, 1].map(|k| g[k] + fade * self.options.hold * own[k]);
        let last = self.times.times.len() - 1;
        let neighbours = [key.checked_sub(1), Some(key + 1).filter(|k| *k <= last)];
        for way in neighbours.into_iter().flatten().map(|next| self.way(j, next)) {
            (0..2).for_each(|k| sum[k] += fade * self.options.smooth * (own[k] - way[k]));
        }
        sum
    }

    /// Adam; a turn and a shift move by `rate` pixels while the gradient keeps its direction.
    fn update(&mut self, j: usize, key: usize, rate: f64, g: Six) {
        if self.begins_anew(j, key) {
            return;
        }
        let (scale, m) = (self.options.scale(j), self.superpoints());
        let at = key * m + j;
        let k = &mut self.keys[at];
        k.updates += 1;
        let correct = BETA.map(|beta| 1.0 - beta.powi(k.updates));
        let mut step = [DVec3::ZERO; 2];
        for part in 0..2 {
            k.moment_1[part] = k.moment_1[part] * BETA[0] + g[part] * (1.0 - BETA[0]);
            k.moment_2[part] = k.moment_2[part] * BETA[1] + g[part].length_squared() * (1.0 - BETA[1]);
            let size = (k.moment_2[part] / correct[1]).sqrt() + EPSILON;
            step[part] = k.moment_1[part] * (-rate * scale[part] / (correct[0] * size));
        }
        k.rotation += step[0].clamp_length_max(LARGEST_TURN);
        k.place += step[1];
        let moved = *k;
        // Two keys of one time are one key.
        if let Some(twin) = twin_of(&self.times.times, key) {
            self.keys[twin * m + j] = moved;
        }
    }

    /// Whether a superpoint's vector begins anew at this key: then it stays, so that both say the same turn.
    fn begins_anew(&self, j: usize, key: usize) -> bool {
        let m = self.superpoints();
        twin_of(&self.times.times, key)
            .is_some_and(|twin| self.keys[twin * m + j].rotation != self.keys[key * m + j].rotation)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;
    use crate::scene::synthetic::Random;

    fn table(times: &[f32], m: usize, seed: u64) -> Motion {
        let mut random = Random::new(seed);
        let mut rows = |size: f64| {
            let row = |_| (random.range(0.2, size) * random.direction()).as_vec3().to_array();
            (0..times.len() * m).map(row).collect::<Vec<_>>()
        };
        Motion { times: times.to_vec(), rotation: rows(2.5), translation: rows(1.0) }
    }

    fn options(m: usize) -> KeyOptions {
        let center = (0..m).map(|j| DVec3::new(0.7, -0.4 * j as f64, 1.1)).collect();
        let (reach, unit) = (vec![0.3; m], vec![0.01; m]);
        KeyOptions { center, reach, unit, rate_px: [0.5, 0.05], hold: 0.0, smooth: 0.0, iterations: 200 }
    }

    /// A loss of a pose: where it takes a point, and where its centre is.
    fn loss(p: &Pose) -> f64 {
        DVec3::new(0.3, -1.0, 0.6).dot(exp(p.rotation) * DVec3::new(0.5, 0.2, -0.9))
            + DVec3::new(1.0, 0.4, -0.2).dot(p.translation)
    }

    fn gradient(p: &Pose) -> Twist {
        let arm = exp(p.rotation) * DVec3::new(0.5, 0.2, -0.9);
        Twist { rotation: arm.cross(DVec3::new(0.3, -1.0, 0.6)), translation: DVec3::new(1.0, 0.4, -0.2) }
    }

    #[test]
    fn gradients_of_keys_are_those_of_differences() {
        let times = [0.0, 0.3, 1.0];
        let mut keys = Keys::new(&table(&times, 2, 3), options(2)).unwrap();
        let (j, time) = (1, 0.44);
        let between = keys.between(time);
        let now = keys.at(j, between);
        for (key, weight) in between.keys.into_iter().zip([1.0 - between.weight, between.weight]) {
            let found = keys.gradient(j, key, weight, &now, &gradient(&now));
            let scale = keys.options.scale(j);
            for part in 0..2 {
                for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
                    let h = 1e-5;
                    let mut at = |step: f64| {
                        let (old, k) = (keys.keys[key * 2 + j], &mut keys.keys[key * 2 + j]);
                        if part == 0 {
                            k.rotation += axis * step
                        } else {
                            k.place += axis * step
                        }
                        let value = loss(&keys.at(j, between));
                        keys.keys[key * 2 + j] = old;
                        value
                    };
                    let expected = (at(h) - at(-h)) / (2.0 * h) * scale[part];
                    let difference = (found[part].dot(axis) - expected).abs();
                    assert!(difference < 1e-9, "key {key}, part {part}, {axis}: {found:?} for {expected}");
                }
            }
        }
    }

    /// Where the motion of superpoint 0 is at some times, after learning towards another table; from 0.6 on keys rest.
    fn learnt(over: KeyOptions, times: &[f32]) -> (Keys, f64, f64) {
        let truth = Keys::new(&table(times, 2, 3), options(2)).unwrap();
        let mut disturbed = truth.table();
        disturbed.translation.iter_mut().for_each(|t| t[0] += 0.02);
        let mut keys = Keys::new(&disturbed, over).unwrap();
        let off = |keys: &Keys| {
            let at =
                |k: &Keys, t: f64| k.poses(t)[0].translation + exp(k.poses(t)[0].rotation) * DVec3::new(0.7, 0.0, 1.1);
            (0..20).map(|k| at(keys, k as f64 / 19.0).distance(at(&truth, k as f64 / 19.0))).fold(0.0, f64::max)
        };
        let before = off(&keys);
        for i in 1..=200_u64 {
            let time = (i * 7 % 20) as f64 / 19.0;
            let (now, aim) = (keys.poses(time), truth.poses(time));
            // Half the squared distance of the centres.
            let twist = |j: usize| {
                let arm = exp(now[j].rotation) * keys.options.center[j];
                let to = exp(aim[j].rotation) * keys.options.center[j] + aim[j].translation;
                let g = now[j].translation + arm - to;
                Twist { rotation: arm.cross(g), translation: g }
            };
            let twists = [twist(0), twist(1)];
            keys.learn(i, time, &twists);
        }
        let after = off(&keys);
        (keys, before, after)
    }

    #[test]
    fn keys_learn_are_held_or_rest() {
        let times = [0.0, 0.4, 0.6, 1.0];
        let (keys, before, after) = learnt(options(2), &times);
        assert!(after < 0.2 * before, "{before} to {after}");
        assert!(keys.table().times == times && keys.table() != table(&times, 2, 3));
        let (_, _, held) = learnt(KeyOptions { hold: 1e3, ..options(2) }, &times);
        assert!(held > 2.0 * after, "held keys stay longer: {held}, free {after}");
        let (still, before, after) = learnt(KeyOptions { unit: vec![0.0; 2], ..options(2) }, &times);
        assert!(before == after && still.keys.iter().all(|k| k.updates == 0));
    }

    #[test]
    fn two_keys_of_one_time_stay_one_and_vectors_that_begin_anew_stay() {
        let times = [0.0, 0.5, 0.5_f32.next_up(), 1.0];
        let mut motion = table(&times, 2, 5);
        // Superpoint 0 goes on, superpoint 1 begins anew.
        motion.rotation[2 * 2] = motion.rotation[2];
        motion.translation[2 * 2] = motion.translation[2];
        let mut keys = Keys::new(&motion, options(2)).unwrap();
        for i in 1..40 {
            let twists = [Twist { rotation: DVec3::X, translation: DVec3::Y }; 2];
            keys.learn(i, 0.1 + 0.02 * i as f64, &twists);
        }
        let t = keys.table();
        assert!(t.rotation[2] == t.rotation[4] && t.translation[2] == t.translation[4], "{t:?}");
        assert!(t.translation[2] != motion.translation[2], "superpoint 0 has moved");
        assert!(t.rotation[3] == motion.rotation[3] && t.rotation[5] == motion.rotation[5], "superpoint 1 stays there");
    }

    #[test]
    fn other_lengths_are_rejected() {
        let motion = table(&[0.0, 1.0], 2, 1);
        assert!(Keys::new(&motion, options(3)).is_err());
        assert!(Keys::new(&motion, KeyOptions { unit: vec![1.0], ..options(2) }).is_err());
        assert!(Keys::new(&Motion::default(), options(2)).is_err());
        assert!(Keys::new(&motion, KeyOptions { rate_px: [0.0, 0.1], ..options(2) }).is_err());
    }
}
