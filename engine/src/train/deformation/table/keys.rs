//! Key poses that learn, on the host in f64: Adam of the two keys around each step's time, and terms that hold them to where they
//! began.
//!
//! A key is a vector r and the place x = Exp(r)p + τ of its superpoint's centre p: so a turn does not swing what lies far from the
//! world's origin. With the gradients ω (by a left tangent, τ held) and g (by τ) at a time between keys a and b, where r and τ are
//! linear, key k of weight w gets w·g by x and w·(J(r)ᵀω + J(r_k)ᵀ(g × Exp(r_k)p)) by r; J is the left Jacobian of Exp.

use glam::DVec3;

use crate::error::{Error, Result};
use crate::reference::gradient::motion::left_jacobian;
use crate::reference::{Pose, exp};
use crate::scene::Motion;
use crate::train::photo_loss::Twist;

/// Adam's decays: a key is seen in few of the steps, so its second moment follows quickly.
const BETA: [f64; 2] = [0.9, 0.98];
const EPSILON: f64 = 1e-12;
/// Largest turn in one step, radians.
const LARGEST_TURN: f64 = 0.05;

/// How key poses learn.
#[derive(Debug, Clone, PartialEq)]
pub struct KeyOptions {
    /// `[M]` canonical centres that superpoints turn about.
    pub center: Vec<DVec3>,
    /// `[M]` root mean square distance of what they move from there, world units, above 0.
    pub reach: Vec<f64>,
    /// `[M]` world units of a pixel; 0: the superpoint stays as it is.
    pub unit: Vec<f64>,
    /// Pixels of a step, at the start and at the end.
    pub rate_px: [f64; 2],
    /// λ of ½d², d the way of a key from where it began, pixels; fades to 0.
    pub hold: f64,
    /// λ of ½‖d − d'‖² for keys that follow each other; fades to 0.
    pub smooth: f64,
    /// Steps until the rate has fallen and those terms have faded.
    pub iterations: u64,
}

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
pub(in crate::train) struct Keys {
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
    /// `Usage` for another number of superpoints, or no key.
    pub(in crate::train) fn new(table: &Motion, options: KeyOptions) -> Result<Self> {
        let (m, count) = (options.center.len(), table.rotation.len());
        let lengths = [options.reach.len(), options.unit.len(), table.superpoint_count()];
        if m == 0 || table.times.is_empty() || lengths != [m; 3] || count != table.times.len() * m {
            let found = format!("{count} poses of {} key times, {lengths:?} and {m} superpoints", table.times.len());
            return Err(Error::usage("key poses to train", found, "as many of each, at least one"));
        }
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
    pub(in crate::train) fn poses(&self, time: f64) -> Vec<Pose> {
        let between = self.between(time);
        (0..self.superpoints()).map(|j| self.at(j, between)).collect()
    }

    /// The table as it is.
    pub(in crate::train) fn table(&self) -> Motion {
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
    pub(in crate::train) fn learn(&mut self, iteration: u64, time: f64, gradient: &[Twist]) {
        let (m, between) = (self.superpoints(), self.between(time));
        let share = (iteration as f64 / self.options.iterations.max(1) as f64).min(1.0);
        let [from, to] = self.options.rate_px;
        let rate = from * (to / from).powf(share);
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
                .map(|(key, g)| (key, self.with_terms(j, key, 1.0 - share, g)))
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
        let [by_turn, by_shift] = self.scale(j);
        [turn * (weight * by_turn), twist.translation * (weight * by_shift)]
    }

    /// Radians and world units of a pixel.
    fn scale(&self, j: usize) -> [f64; 2] {
        let unit = self.options.unit[j];
        [unit / self.options.reach[j].max(1e-12), unit]
    }

    /// How far a key has gone, pixels.
    fn way(&self, j: usize, key: usize) -> Six {
        let Key { rotation, place, first, .. } = self.keys[key * self.superpoints() + j];
        let [by_turn, by_shift] = self.scale(j);
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
        let (scale, m) = (self.scale(j), self.superpoints());
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
        if let Some(twin) = self.twin(key) {
            self.keys[twin * m + j] = moved;
        }
    }

    /// The other one of two keys that are one f32 apart.
    fn twin(&self, key: usize) -> Option<usize> {
        let t = &self.times.times;
        let next = |k: usize| k + 1 < t.len() && t[k + 1] <= t[k].next_up();
        if next(key) { Some(key + 1) } else { key.checked_sub(1).filter(|k| next(*k)) }
    }

    /// Whether a superpoint's vector begins anew at this key: then it stays, so that both say the same turn.
    fn begins_anew(&self, j: usize, key: usize) -> bool {
        let m = self.superpoints();
        self.twin(key).is_some_and(|twin| self.keys[twin * m + j].rotation != self.keys[key * m + j].rotation)
    }
}
