//! Which splats may show in each block of an area's pixels.

use crate::reference::{ALPHA_MIN, Splat};
use glam::DVec2;

/// Pixels along a side of a block.
const SIDE: f64 = 8.0;

/// Splats of an area by the blocks that they reach, in the order in which they were given.
pub(super) struct Blocks<'a> {
    origin: DVec2,
    columns: usize,
    lists: Vec<Vec<&'a Splat>>,
}

impl<'a> Blocks<'a> {
    pub(super) fn new(splats: &'a [Splat], x: [f64; 2], y: [f64; 2]) -> Self {
        let count = |[from, to]: [f64; 2]| ((to - from) / SIDE).ceil() as usize;
        let (columns, rows) = (count(x), count(y));
        let mut lists = vec![Vec::new(); columns * rows];
        for splat in splats {
            // Half the sides of the box around the ellipse where α is 1/255, a little more.
            let level = 2.0 * (splat.opacity / ALPHA_MIN).ln().max(0.0);
            let reach = |k: usize| (level * splat.covariance[k]).sqrt() + 1e-6;
            let span = |mean: f64, reach: f64, from: f64, count: usize| {
                let [low, high] = [mean - reach, mean + reach].map(|v| ((v - from) / SIDE).floor());
                low.max(0.0) as usize..(high + 1.0).clamp(0.0, count as f64) as usize
            };
            for row in span(splat.mean.y, reach(2), y[0], rows) {
                for column in span(splat.mean.x, reach(0), x[0], columns) {
                    lists[row * columns + column].push(splat);
                }
            }
        }
        Self { origin: DVec2::new(x[0], y[0]), columns, lists }
    }

    /// Those that may show at a point of the area.
    pub(super) fn at(&self, point: DVec2) -> &[&'a Splat] {
        let block = ((point - self.origin) / SIDE).floor();
        &self.lists[block.y as usize * self.columns + block.x as usize]
    }
}
