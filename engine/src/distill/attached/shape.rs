//! What is fixed to a part: cells of a grid in the part's frame, each of a pixel's size.

use std::collections::BTreeSet;

use glam::DVec3;
use rayon::prelude::*;

use super::look::Look;
use super::path::Path;

/// Cells around the pivot that growth begins with, and around others that it goes on to.
const FIRST: i32 = 5;
const STEP: i32 = 3;
/// A cell is the object's where so many of the photos differ that have it, and so many of all have it.
const SHARE: f64 = 0.6;
pub(super) const HAVE: f64 = 0.5;
/// Of the cells as far from the pivot, those are that have at least this much of the best one's share: it is thin.
const OF_BEST: f64 = 0.9;
/// Fewest cells.
const FEWEST: usize = 3;
/// Most cells: it is no object that reaches everywhere.
const MOST: usize = 20_000;

/// A cell of a grid around a pivot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Cell([i32; 3]);

impl Cell {
    /// The one that a place, in cells, lies in.
    pub(super) fn of(place: DVec3) -> Self {
        Self(place.to_array().map(|v| v.round() as i32))
    }

    /// In cells.
    pub(super) fn middle(self) -> DVec3 {
        DVec3::from_array(self.0.map(f64::from))
    }

    /// How many whole cells it is from the pivot.
    fn shell(self) -> usize {
        self.middle().length() as usize
    }

    /// Those at most so far along each axis.
    pub(super) fn within(self, far: i32) -> impl Iterator<Item = Self> {
        let all = -far..=far;
        let beside = move |x: i32, y: i32, z: i32| {
            Self([self.0[0].saturating_add(x), self.0[1].saturating_add(y), self.0[2].saturating_add(z)])
        };
        let rows = all.clone().flat_map(move |x| (-far..=far).map(move |y| (x, y)));
        rows.flat_map(move |(x, y)| all.clone().map(move |z| beside(x, y, z)))
    }
}

/// The largest share of the cells in each shell, `least` where none is larger.
fn best_of_shells(cells: &[Cell], shares: &[f64], least: f64) -> Vec<f64> {
    let mut best = vec![least; cells.iter().map(|c| c.shell()).max().unwrap_or(0) + 1];
    cells.iter().zip(shares).for_each(|(c, s)| best[c.shell()] = best[c.shell()].max(*s));
    best
}

/// The cells of an object.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Shape {
    /// Side of a cell, world units.
    pub(super) cell: f64,
    cells: Vec<Cell>,
}

impl Shape {
    /// Nothing yet, around a pivot.
    pub(super) fn at(cell: f64) -> Self {
        Self { cell, cells: Vec::new() }
    }

    /// Chooses its cells anew, among those that it has and those around them; `None` where too few are left, or too many.
    pub(super) fn grow(&mut self, path: &Path, looks: &[&Look], within: f32) -> Option<()> {
        let first = Cell([0; 3]).within(FIRST).filter(|c| c.middle().length() <= f64::from(FIRST));
        let near: BTreeSet<Cell> = first.chain(self.cells.iter().flat_map(|c| c.within(STEP))).collect();
        let near: Vec<Cell> = near.into_iter().collect();
        let share = |c: &Cell| path.share(c.middle() * self.cell, looks, within, HAVE);
        let shares: Vec<f64> = near.par_iter().map(share).collect();
        let best = best_of_shells(&near, &shares, SHARE);
        let is_its = |(c, s): &(&Cell, &f64)| **s >= SHARE && **s >= OF_BEST * best[c.shell()];
        self.cells = near.iter().zip(&shares).filter(is_its).map(|(c, _)| *c).collect();
        (FEWEST..=MOST).contains(&self.cells.len()).then_some(())
    }

    /// Keeps what most photos agree on to the pixel: an object grows as thick as it is looked for.
    pub(super) fn thin(&mut self, path: &Path, looks: &[&Look]) {
        let share = |c: &Cell| path.share(c.middle() * self.cell, looks, 0.0, HAVE);
        let shares: Vec<f64> = self.cells.par_iter().map(share).collect();
        let best = best_of_shells(&self.cells, &shares, 0.0);
        let is_its = |(c, s): &(&Cell, &f64)| **s >= OF_BEST * best[c.shell()];
        self.cells = self.cells.iter().zip(&shares).filter(is_its).map(|(c, _)| *c).collect();
    }

    /// How far it reaches from the pivot, cells.
    pub(super) fn reach(&self) -> f64 {
        self.cells.iter().map(|c| c.middle().length()).fold(0.0, f64::max)
    }

    /// Its cells from the pivot on, world units, in the part's frame.
    pub(super) fn points(&self) -> Vec<DVec3> {
        self.cells.iter().map(|c| c.middle() * self.cell).collect()
    }

    /// So many of them at most.
    pub(super) fn some(&self, most: usize) -> Vec<DVec3> {
        let count = self.cells.len().min(most);
        (0..count).map(|k| self.cells[k * self.cells.len() / count].middle() * self.cell).collect()
    }

    /// Those at its ends.
    pub(super) fn farthest(&self) -> Vec<DVec3> {
        let points = self.points();
        let ways = [DVec3::X, DVec3::Y, DVec3::Z].into_iter().flat_map(|axis| [axis, -axis]);
        ways.filter_map(|way| points.iter().copied().max_by(|a, b| a.dot(way).total_cmp(&b.dot(way)))).collect()
    }
}
