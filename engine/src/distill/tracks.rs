//! Where the probes of Gaussians are at the sampled times, and how well one moving frame explains them.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::rigid::Frame;

/// A Gaussian's probes at a time: its centre, and two standard deviations along its two longest axes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Point {
    /// World units.
    pub(super) center: Vec3,
    /// From the centre to the ends, world units.
    pub(super) axes: [Vec3; 2],
    /// Pixels per world unit at most.
    pub(super) reach: f32,
}

/// The same at rest, in the frame of a part.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Rest {
    pub(super) center: DVec3,
    pub(super) axes: [DVec3; 2],
}

/// Probes of all Gaussians at all sampled times.
#[derive(Debug, Default)]
pub(super) struct Tracks {
    /// T.
    pub(super) times: usize,
    /// The time at which Gaussians are taken to rest at first.
    pub(super) middle: usize,
    /// `[N,T]`.
    pub(super) points: Vec<Point>,
    /// `[N]` how much each Gaussian shows, 0 to 1.
    pub(super) opacity: Vec<f32>,
}

impl Tracks {
    /// The same at about `most` of the times, the first, middle and last among them.
    pub(super) fn thinned(&self, most: usize) -> Self {
        let step = self.times.div_ceil(most).max(1);
        let keeps = |k: &usize| k.abs_diff(self.middle).is_multiple_of(step) || *k == 0 || k + 1 == self.times;
        let kept: Vec<usize> = (0..self.times).filter(keeps).collect();
        let middle = kept.iter().position(|k| *k == self.middle).unwrap_or(0);
        let of = |i: usize| kept.iter().map(move |&k| self.of(i)[k]).collect::<Vec<_>>();
        let points = (0..self.opacity.len()).into_par_iter().flat_map_iter(of).collect();
        Self { times: kept.len(), middle, points, opacity: self.opacity.clone() }
    }

    pub(super) fn of(&self, i: usize) -> &[Point] {
        &self.points[i * self.times..(i + 1) * self.times]
    }

    /// A Gaussian as it is at the middle time.
    pub(super) fn first_rest(&self, i: usize) -> Rest {
        let Point { center, axes, .. } = self.of(i)[self.middle];
        Rest { center: center.as_dvec3(), axes: axes.map(Vec3::as_dvec3) }
    }

    /// Weight of a Gaussian in a fit: its pixels per world unit, squared.
    pub(super) fn weight(&self, i: usize) -> f64 {
        let reach = f64::from(self.of(i)[self.middle].reach);
        (reach * reach).max(1.0e-12)
    }

    /// Where Gaussian `i` should rest in a frame that moves like `frames` `[T]`, and how far its probes are from there at most,
    /// pixels; infinite as soon as that is known to be above `enough`.
    pub(super) fn in_frame(&self, i: usize, frames: &[Frame], enough: f64, work: &mut Vec<Rest>) -> (Rest, f64) {
        let points = self.of(i);
        work.clear();
        let (mut low, mut high, mut least) = (DVec3::INFINITY, DVec3::NEG_INFINITY, f64::INFINITY);
        for (p, frame) in points.iter().zip(frames) {
            let center = frame.back(p.center.as_dvec3());
            let back = frame.turn.transpose();
            work.push(Rest { center, axes: p.axes.map(|a| back * a.as_dvec3()) });
            (low, high, least) = (low.min(center), high.max(center), least.min(f64::from(p.reach)));
            if 0.5 * (high - low).max_element() * least > enough {
                return (Rest::default(), f64::INFINITY);
            }
        }
        // The middle of its range is nearly the point with the smallest largest distance.
        let rest = Rest { center: 0.5 * (low + high), axes: mean_axes(work) };
        let mut worst: f64 = 0.0;
        for (now, p) in work.iter().zip(points) {
            let off = now.center - rest.center;
            let ends = now.axes.iter().zip(&rest.axes).map(|(now, rest)| (off + *now - *rest).length_squared());
            let largest = ends.fold(off.length_squared(), f64::max);
            worst = worst.max(largest.sqrt() * f64::from(p.reach));
        }
        (rest, worst)
    }
}

/// The mean directions of the axes, perpendicular, as long as they are at the first time.
fn mean_axes(all: &[Rest]) -> [DVec3; 2] {
    let Some(first) = all.first() else { return [DVec3::ZERO; 2] };
    let [a, b] = [0, 1].map(|k| all.iter().map(|rest| rest.axes[k]).sum::<DVec3>());
    let [length_a, length_b] = first.axes.map(DVec3::length);
    let a = a.normalize_or(first.axes[0].normalize_or(DVec3::X));
    let b = b - a * a.dot(b);
    let b = b.try_normalize().unwrap_or_else(|| a.any_orthonormal_vector());
    [a * length_a, b * length_b]
}
