//! Normal equations of all superpoints together, in blocks of 6×6.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::jacobian::Columns;
use crate::pose::information::{Block, backward, cholesky, forward};
use crate::pose::sight::Residual;

/// Least damping of a number, in shares of the mean of the diagonal.
const FLOOR: f64 = 1e-3;
/// Conjugate gradients end after so many steps, or where the residual has fallen so far.
const MOST_STEPS: usize = 400;
const ACCURACY: f64 = 1e-6;

/// A x = b with A symmetric, positive, and b against the gradient.
#[derive(Debug, Clone)]
pub(in crate::pose) struct Normal {
    diagonal: Vec<Block>,
    /// Blocks (j, k) with j < k.
    others: BTreeMap<(usize, usize), Block>,
    right: Vec<[f64; 6]>,
}

impl Normal {
    /// All zero, for `count` superpoints.
    pub(in crate::pose) fn new(count: usize) -> Self {
        Self { diagonal: vec![Block::default(); count], others: BTreeMap::new(), right: vec![[0.0; 6]; count] }
    }

    /// Adds a block of rows j and columns k; its transpose too where they differ.
    pub(in crate::pose) fn add_block(&mut self, j: usize, k: usize, block: &Block) {
        let (place, turned) = match j.cmp(&k) {
            std::cmp::Ordering::Equal => (&mut self.diagonal[j], false),
            std::cmp::Ordering::Less => (self.others.entry((j, k)).or_default(), false),
            std::cmp::Ordering::Greater => (self.others.entry((k, j)).or_default(), true),
        };
        for (a, row) in place.iter_mut().enumerate() {
            for (b, value) in row.iter_mut().enumerate() {
                *value += if turned { block[b][a] } else { block[a][b] };
            }
        }
    }

    /// Adds to the diagonal of a superpoint.
    pub(super) fn add_diagonal(&mut self, j: usize, values: [f64; 6]) {
        values.iter().enumerate().for_each(|(k, value)| self.diagonal[j][k][k] += value);
    }

    /// A gradient of what is to become small.
    pub(super) fn add_gradient(&mut self, j: usize, gradient: [f64; 6]) {
        self.right[j].iter_mut().zip(gradient).for_each(|(right, g)| *right -= g);
    }

    /// Adds what a photo of this width says: its derivatives and what is left of it.
    pub(super) fn add_photo(&mut self, columns: &[Columns], residual: &Residual, width: u32) {
        let of = |(at, a): (usize, &Columns)| {
            let others =
                columns[at..].iter().filter_map(|b| Some((b.superpoint, a.product(b, &residual.weight, width)?)));
            (a.superpoint, others.collect::<Vec<_>>(), a.against(residual, width))
        };
        let found: Vec<_> = columns.par_iter().enumerate().map(of).collect();
        for (j, blocks, gradient) in found {
            blocks.iter().for_each(|(k, block)| self.add_block(j, *k, block));
            self.add_gradient(j, gradient);
        }
    }

    /// x with every number damped by `damping` times its own share of the diagonal: conjugate gradients, with the
    /// diagonal blocks as preconditioner.
    pub(super) fn solve(&self, damping: f64) -> Vec<[f64; 6]> {
        let count = (6 * self.diagonal.len()).max(1) as f64;
        let mean = self.diagonal.iter().flat_map(|b| (0..6).map(move |k| b[k][k])).sum::<f64>() / count;
        let mut damped = self.clone();
        for block in &mut damped.diagonal {
            (0..6).for_each(|k| block[k][k] += damping * (block[k][k] + FLOOR * mean) + 1e-12 * mean);
        }
        let roots: Vec<Option<Block>> = damped.diagonal.iter().map(|block| cholesky(block, 0.0)).collect();
        let precondition = |r: &[[f64; 6]]| -> Vec<[f64; 6]> {
            let solved =
                |(root, r): (&Option<Block>, &[f64; 6])| root.map_or([0.0; 6], |l| backward(&l, forward(&l, *r)));
            roots.iter().zip(r).map(solved).collect()
        };
        let mut x = vec![[0.0; 6]; self.right.len()];
        let mut r = self.right.clone();
        let mut z = precondition(&r);
        let mut p = z.clone();
        let mut rz = dot(&r, &z);
        let first = rz;
        for _ in 0..MOST_STEPS {
            if !(rz > ACCURACY.powi(2) * first && rz.is_finite()) {
                break;
            }
            let ap = damped.times(&p);
            let step = rz / dot(&p, &ap);
            add(&mut x, step, &p);
            add(&mut r, -step, &ap);
            z = precondition(&r);
            let next = dot(&r, &z);
            let again = next / rz;
            rz = next;
            p.iter_mut().flatten().zip(z.iter().flatten()).for_each(|(p, z)| *p = z + again * *p);
        }
        x
    }

    /// A x.
    pub(in crate::pose) fn times(&self, x: &[[f64; 6]]) -> Vec<[f64; 6]> {
        let row = |block: &Block, x: &[f64; 6], a: usize| (0..6).map(|b| block[a][b] * x[b]).sum::<f64>();
        let own = |(block, x): (&Block, &[f64; 6])| std::array::from_fn(|a| row(block, x, a));
        let mut y: Vec<[f64; 6]> = self.diagonal.iter().zip(x).map(own).collect();
        for ((j, k), block) in &self.others {
            for a in 0..6 {
                y[*j][a] += row(block, &x[*k], a);
                y[*k][a] += (0..6).map(|b| block[b][a] * x[*j][b]).sum::<f64>();
            }
        }
        y
    }
}

fn dot(a: &[[f64; 6]], b: &[[f64; 6]]) -> f64 {
    a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| a * b).sum()
}

fn add(x: &mut [[f64; 6]], step: f64, p: &[[f64; 6]]) {
    x.iter_mut().flatten().zip(p.iter().flatten()).for_each(|(x, p)| *x += step * p);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::synthetic::Random;

    /// A is JᵀJ of a random J with 40 rows for 5 superpoints.
    #[test]
    fn conjugate_gradients_solve_it() {
        let mut random = Random::new(3);
        let rows: Vec<Vec<f64>> = (0..40).map(|_| (0..30).map(|_| random.normal()).collect()).collect();
        let wanted: Vec<[f64; 6]> = (0..5).map(|_| std::array::from_fn(|_| random.normal())).collect();
        let mut normal = Normal::new(5);
        for row in &rows {
            let at = |j: usize| &row[6 * j..6 * j + 6];
            let block = |j, k| std::array::from_fn(|a| std::array::from_fn(|b| at(j)[a] * at(k)[b]));
            // Above the diagonal and below it: both are the same block.
            (0..5).for_each(|j| (j..5).for_each(|k| normal.add_block(j, k, &block(j, k))));
            let by: f64 = row.iter().zip(wanted.iter().flatten()).map(|(r, x)| r * x).sum();
            (0..5).for_each(|j| normal.add_gradient(j, std::array::from_fn(|a| -by * at(j)[a])));
        }
        let found = normal.solve(0.0);
        for (found, wanted) in found.iter().flatten().zip(wanted.iter().flatten()) {
            assert!((found - wanted).abs() < 1e-4, "{found} for {wanted}");
        }
        let mut turned = Normal::new(2);
        let block: Block = std::array::from_fn(|a| std::array::from_fn(|b| (6 * a + b) as f64));
        turned.add_block(1, 0, &block);
        assert_eq!(turned.others[&(0, 1)][1][4], block[4][1]);
        let held: f64 = normal.solve(1e9).iter().flatten().map(|x| x.abs()).sum();
        assert!(held < 1e-6, "{held}");
    }
}
