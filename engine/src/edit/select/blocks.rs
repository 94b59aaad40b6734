//! Which splats may show in each block of an area's pixels.

use crate::reference::{ALPHA_MIN, Splat};
use glam::DVec2;
use rayon::prelude::*;

/// Pixels along a side of a block.
pub(super) const SIDE: usize = 8;
/// Squares of distances this far beyond a level are still asked for their α.
const ROUNDING: f64 = 1e-6;

/// A splat, and the square of the distance in deviations from which on its α is below 1/255.
#[derive(Clone, Copy)]
pub(super) struct Reaching<'a> {
    pub(super) splat: &'a Splat,
    level: f64,
}

impl<'a> Reaching<'a> {
    pub(super) fn new(splat: &'a Splat) -> Self {
        Self { splat, level: 2.0 * (splat.opacity / ALPHA_MIN).ln().max(0.0) }
    }

    /// The corners of the box around the ellipse where α is 1/255, a little wider.
    pub(super) fn bounds(&self) -> [DVec2; 2] {
        let [xx, _, yy] = self.splat.covariance;
        let reach = DVec2::new((self.level * xx).sqrt(), (self.level * yy).sqrt()) + 1e-6;
        [self.splat.mean - reach, self.splat.mean + reach]
    }

    /// α at a point of the image; `None` below 1/255. Most splats of a block are too far off, which takes no exponential to tell.
    pub(super) fn alpha(&self, point: DVec2) -> Option<f64> {
        if self.splat.square(point) > self.level + ROUNDING {
            return None;
        }
        Some(self.splat.alpha(point)).filter(|alpha| *alpha >= ALPHA_MIN)
    }

    /// Whether it may show anywhere at this y.
    fn reaches_row(&self, y: f64) -> bool {
        (self.splat.factor[2] * (y - self.splat.mean.y)).powi(2) <= self.level + ROUNDING
    }
}

/// Splats of an area by the blocks that they reach, in the order in which they were given.
pub(super) struct Blocks<'a> {
    origin: DVec2,
    columns: usize,
    lists: Vec<Vec<Reaching<'a>>>,
}

impl<'a> Blocks<'a> {
    pub(super) fn new(splats: &'a [Splat], x: [f64; 2], y: [f64; 2]) -> Self {
        let side = SIDE as f64;
        let count = |[from, to]: [f64; 2]| ((to - from) / side).ceil() as usize;
        let (columns, rows) = (count(x), count(y));
        let span = |low: f64, high: f64, from: f64, count: usize| {
            let [low, high] = [low, high].map(|v| ((v - from) / side).floor());
            low.max(0.0) as usize..(high + 1.0).clamp(0.0, count as f64) as usize
        };
        let spans = splats.par_iter().map(|splat| {
            let reaching = Reaching::new(splat);
            let [low, high] = reaching.bounds();
            (reaching, span(low.x, high.x, x[0], columns), span(low.y, high.y, y[0], rows))
        });
        let spans: Vec<_> = spans.collect();
        let row = |row: usize| {
            let mut lists = vec![Vec::new(); columns];
            for (reaching, columns, _) in spans.iter().filter(|(_, _, rows)| rows.contains(&row)) {
                lists[columns.start.min(columns.end)..columns.end].iter_mut().for_each(|list| list.push(*reaching));
            }
            lists
        };
        let lists = (0..rows).into_par_iter().flat_map_iter(row).collect();
        Self { origin: DVec2::new(x[0], y[0]), columns, lists }
    }

    /// Those of a block that may show in a row of its pixels: one that goes through a point of the area.
    pub(super) fn in_row(&self, point: DVec2) -> impl Iterator<Item = Reaching<'a>> {
        let block = ((point - self.origin) / SIDE as f64).floor();
        let all = &self.lists[block.y as usize * self.columns + block.x as usize];
        all.iter().filter(move |reaching| reaching.reaches_row(point.y)).copied()
    }
}
