//! The teacher's motion at as many times as it takes: intervals are halved until the middle of each is on the chord.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::tracks::{Point, Tracks};
use super::{MOST_TIMES, Place, Tick};
use crate::error::{Error, Result};
use crate::reference::rotation_of_quaternion;
use crate::scene::{Camera, Gaussians, Scene};
use crate::train::bake::Views;

/// Times that are always looked at, evenly spread: a quick spin must not look like a slow one.
const FIRST_TIMES: usize = 17;
/// Key times of a teacher's table that are looked at besides, if they are not more.
const MOST_KEYS: usize = 65;
/// Bytes that the samples may take, twice.
const MOST_BYTES: usize = 2 << 30;

/// The order of a Gaussian's axes, the longest first.
pub(super) type Order = [u8; 3];

/// All Gaussians at a time.
#[derive(Debug, Clone)]
pub(super) struct Moment {
    pub(super) time: f64,
    center: Vec<Vec3>,
    /// Unit vectors along the two longest axes at rest.
    axes: Vec<[Vec3; 2]>,
    /// Pixels per world unit at most.
    reach: Vec<f32>,
}

impl Moment {
    /// Gaussian `i`, with axes of these lengths.
    pub(super) fn point(&self, i: usize, lengths: [f32; 2]) -> Point {
        let [a, b] = self.axes[i];
        Point { center: self.center[i], axes: [a * lengths[0], b * lengths[1]], reach: self.reach[i] }
    }
}

/// Sizes over time.
#[derive(Debug, Default)]
pub(super) struct Sizes {
    count: f64,
    sum: Vec<[f64; 3]>,
    low: Vec<[f32; 3]>,
    high: Vec<[f32; 3]>,
}

impl Sizes {
    fn add(&mut self, g: &Gaussians) {
        if self.count == 0.0 {
            (self.low, self.high) = (g.log_scale.clone(), g.log_scale.clone());
            self.sum = vec![[0.0; 3]; g.len()];
        }
        self.count += 1.0;
        for (i, now) in g.log_scale.iter().enumerate() {
            for a in 0..3 {
                self.sum[i][a] += f64::from(now[a]).exp();
                self.low[i][a] = self.low[i][a].min(now[a]);
                self.high[i][a] = self.high[i][a].max(now[a]);
            }
        }
    }

    /// The mean size of a Gaussian, as logarithms; what never changes keeps its bits.
    pub(super) fn mean(&self, i: usize) -> [f32; 3] {
        let of = |a: usize| {
            let is_constant = self.low[i][a].to_bits() == self.high[i][a].to_bits();
            if is_constant { self.low[i][a] } else { (self.sum[i][a] / self.count).ln() as f32 }
        };
        [0, 1, 2].map(of)
    }

    /// How far two standard deviations are from those of the mean at most, world units, and as a share of them.
    pub(super) fn change(&self, i: usize) -> [f64; 2] {
        let mean = self.mean(i).map(|v| f64::from(v).exp());
        let of = |a: usize| {
            let [low, high] = [self.low[i][a], self.high[i][a]].map(|v| f64::from(v).exp());
            (high - mean[a]).max(mean[a] - low)
        };
        let ratio = |a: usize| if mean[a] > 0.0 { of(a) / mean[a] } else { 0.0 };
        [2.0 * (0..3).map(of).fold(0.0, f64::max), (0..3).map(ratio).fold(0.0, f64::max)]
    }
}

/// What is known of a teacher's motion.
#[derive(Debug)]
pub(super) struct Samples {
    /// In order of time.
    pub(super) moments: Vec<Moment>,
    pub(super) sizes: Sizes,
    /// `[N]`
    pub(super) order: Vec<Order>,
    /// How far probes are from the chords between neighbouring times at most, pixels: a quarter of what was measured over
    /// intervals twice as long.
    pub(super) chord_px: f64,
}

/// Evaluates the teacher.
pub(super) struct Sampler<'a, 'b> {
    place: &'a mut Place<'b>,
    views: &'a Views<Camera>,
    /// The Gaussians that are looked at.
    kept: &'a [usize],
    order: Vec<Order>,
    lengths: Vec<[f32; 2]>,
    sizes: Sizes,
}

impl<'a, 'b> Sampler<'a, 'b> {
    pub(super) fn new(teacher: &Scene, place: &'a mut Place<'b>, views: &'a Views<Camera>, kept: &'a [usize]) -> Self {
        let scales = || kept.iter().map(|&i| teacher.gaussians.log_scale[i]);
        let order: Vec<Order> = scales().map(order_of).collect();
        let lengths = scales().zip(&order).map(|(s, order)| lengths(s, *order)).collect();
        Self { place, views, kept, order, lengths, sizes: Sizes::default() }
    }

    /// All Gaussians at a time.
    pub(super) fn at(&mut self, time: f64) -> Result<Moment> {
        let g = (self.place)(time)?;
        let selected = if g.len() == self.kept.len() { g } else { g.selected(self.kept) };
        let finite = |i: &usize| {
            let numbers = selected.mean[*i].iter().chain(&selected.rotation[*i]).chain(&selected.log_scale[*i]);
            numbers.copied().all(f32::is_finite) && selected.rotation[*i] != [0.0; 4]
        };
        if let Some(i) = (0..selected.len()).find(|i| !finite(i)) {
            let found = format!("Gaussian {} is moved to no finite place at time {time}", self.kept[i]);
            return Err(Error::usage("teacher", found, "finite numbers"));
        }
        self.sizes.add(&selected);
        let center: Vec<Vec3> = selected.mean.iter().map(|m| Vec3::from_array(*m)).collect();
        let axes = |(q, order): (&[f32; 4], &Order)| {
            let turn = rotation_of_quaternion(q.map(f64::from));
            [0, 1].map(|k| turn.col(order[k].into()).as_vec3())
        };
        Ok(Moment {
            time,
            axes: selected.rotation.par_iter().zip(&self.order).map(axes).collect(),
            reach: center.par_iter().map(|c| self.views.reach(c.as_dvec3()) as f32).collect(),
            center,
        })
    }

    /// Halves intervals until chords are within `bound` pixels, or there are too many times.
    pub(super) fn sample(mut self, teacher: &Scene, bound: f64, tick: &mut Tick<'_>) -> Result<Samples> {
        let per_time = self.kept.len().max(1) * 2 * size_of::<Point>();
        let most = (MOST_BYTES / per_time).clamp(FIRST_TIMES, MOST_TIMES);
        let mut moments = Vec::new();
        for time in first_times(teacher) {
            tick("times of the teacher", moments.len(), None);
            moments.push(self.at(time)?);
        }
        // By what is known of an interval: how far it may be off the chord.
        let mut open: Vec<(f64, [usize; 2])> = (1..moments.len()).map(|k| (f64::INFINITY, [k - 1, k])).collect();
        let mut chord_px: f64 = 0.0;
        while moments.len() < most {
            let widest = (0..open.len()).max_by(|&a, &b| open[a].0.total_cmp(&open[b].0));
            let Some((_, [a, b])) = widest.map(|k| open.swap_remove(k)) else { break };
            let middle = f64::from((0.5 * (moments[a].time + moments[b].time)) as f32);
            if middle <= moments[a].time || middle >= moments[b].time {
                continue;
            }
            tick("times of the teacher", moments.len(), None);
            let moment = self.at(middle)?;
            let off = off_the_chord([&moments[a], &moment, &moments[b]], &self.lengths);
            moments.push(moment);
            let m = moments.len() - 1;
            if off > bound {
                open.extend([(0.25 * off, [a, m]), (0.25 * off, [m, b])]);
            } else {
                chord_px = chord_px.max(0.25 * off);
            }
        }
        // What was not looked at again.
        chord_px = open.iter().map(|(off, _)| *off).filter(|off| off.is_finite()).fold(chord_px, f64::max);
        moments.sort_by(|a, b| a.time.total_cmp(&b.time));
        Ok(Samples { moments, sizes: self.sizes, order: self.order, chord_px })
    }
}

impl Samples {
    /// The probes by Gaussian, with mean sizes.
    pub(super) fn tracks(&self, opacity: Vec<f32>) -> Tracks {
        let times = self.moments.len();
        let of = |i: usize| {
            let lengths = lengths(self.sizes.mean(i), self.order[i]);
            self.moments.iter().map(move |moment| moment.point(i, lengths))
        };
        let points = (0..opacity.len()).into_par_iter().flat_map_iter(of).collect();
        Tracks { times, middle: times / 2, points, opacity }
    }
}

/// How far probes are from the middle between two moments at most, pixels.
fn off_the_chord([a, middle, b]: [&Moment; 3], lengths: &[[f32; 2]]) -> f64 {
    let of = |i: usize| {
        let [p, m, q] = [a, middle, b].map(|moment| moment.point(i, lengths[i]));
        let off = m.center - 0.5 * (p.center + q.center);
        let end = |k: usize| (off + m.axes[k] - 0.5 * (p.axes[k] + q.axes[k])).length();
        f64::from(off.length().max(end(0)).max(end(1)) * m.reach)
    };
    (0..lengths.len()).into_par_iter().map(of).reduce(|| 0.0, f64::max)
}

fn order_of(log_scale: [f32; 3]) -> Order {
    let mut order: Order = [0, 1, 2];
    order.sort_by(|&a, &b| log_scale[usize::from(b)].total_cmp(&log_scale[usize::from(a)]));
    order
}

/// Two standard deviations along the two longest axes. The second is not much shorter than the first: else a fit to one Gaussian
/// would leave its turn around the first open.
pub(super) fn lengths(log_scale: [f32; 3], order: Order) -> [f32; 2] {
    const LEAST: f32 = 1.0e-3;
    let [a, b] = [0, 1].map(|k| 2.0 * log_scale[usize::from(order[k])].exp().max(1.0e-12));
    [a, b.max(LEAST * a)]
}

/// Times spread evenly, and the key times of a table.
fn first_times(teacher: &Scene) -> Vec<f64> {
    let [start, end] = teacher.time_range();
    let even = (0..FIRST_TIMES).map(|k| start + (end - start) * k as f64 / (FIRST_TIMES - 1) as f64);
    let keys = teacher.deformation.key_times();
    let keys = if keys.len() <= MOST_KEYS { keys } else { &[] };
    let mut times: Vec<f64> = even.map(|t| f64::from(t as f32)).chain(keys.iter().map(|&t| f64::from(t))).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    times
}

/// A point's ends: centre, and two standard deviations along two axes.
pub(super) fn probes(center: DVec3, axes: [DVec3; 2]) -> [DVec3; 3] {
    [center, center + axes[0], center + axes[1]]
}
