//! Symmetric positive definite equations whose matrix is a band.

/// The lower half of a symmetric band matrix.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Band {
    width: usize,
    /// `[n][width + 1]`: of row i the columns i − width to i.
    rows: Vec<f64>,
}

impl Band {
    /// Zeros, `width` columns beside the diagonal.
    pub(super) fn new(n: usize, width: usize) -> Self {
        Self { width, rows: vec![0.0; n * (width + 1)] }
    }

    fn place(&self, i: usize, j: usize) -> usize {
        i * (self.width + 1) + self.width + j - i
    }

    /// Adds to the elements (i, j) and (j, i), which lie within the band; the upper half says nothing new.
    pub(super) fn add(&mut self, i: usize, j: usize, value: f64) {
        if j <= i {
            let place = self.place(i, j);
            self.rows[place] += value;
        }
    }

    /// Makes the diagonal larger, by a share and by an amount.
    pub(super) fn damp(&mut self, share: f64, amount: f64) {
        for row in self.rows.chunks_exact_mut(self.width + 1) {
            row[self.width] = row[self.width] * (1.0 + share) + amount;
        }
    }

    /// Solves for `b`, by Cholesky; `None` where the matrix is not positive definite.
    pub(super) fn solve(mut self, mut b: Vec<f64>) -> Option<Vec<f64>> {
        let (n, w) = (b.len(), self.width);
        for i in 0..n {
            for j in i.saturating_sub(w)..=i {
                let from = i.saturating_sub(w).max(j.saturating_sub(w));
                let sum: f64 = (from..j).map(|k| self.rows[self.place(i, k)] * self.rows[self.place(j, k)]).sum();
                let (at, diagonal) = (self.place(i, j), self.place(j, j));
                let rest = self.rows[at] - sum;
                if i == j && !(rest > 0.0 && rest.is_finite()) {
                    return None;
                }
                self.rows[at] = if i == j { rest.sqrt() } else { rest / self.rows[diagonal] };
            }
        }
        for i in 0..n {
            let sum: f64 = (i.saturating_sub(w)..i).map(|k| self.rows[self.place(i, k)] * b[k]).sum();
            b[i] = (b[i] - sum) / self.rows[self.place(i, i)];
        }
        for i in (0..n).rev() {
            let sum: f64 = (i + 1..n.min(i + w + 1)).map(|k| self.rows[self.place(k, i)] * b[k]).sum();
            b[i] = (b[i] - sum) / self.rows[self.place(i, i)];
        }
        Some(b)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn what_is_solved_fits() {
        let (n, width) = (40, 5);
        let value = |i: usize, j: usize| if i == j { 9.0 } else { ((i * 7 + j * 7) as f64).sin() };
        let inside = |i: usize, j: usize| i.abs_diff(j) <= width;
        let mut band = Band::new(n, width);
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))).filter(|(i, j)| inside(*i, *j)) {
            band.add(i, j, value(i, j));
        }
        let b: Vec<f64> = (0..n).map(|i| (i as f64).cos()).collect();
        let x = band.clone().solve(b.clone()).unwrap();
        for i in 0..n {
            let product: f64 = (0..n).filter(|&j| inside(i, j)).map(|j| value(i, j) * x[j]).sum();
            assert!((product - b[i]).abs() < 1e-12, "{i}");
        }
        band.add(3, 3, -20.0);
        assert!(band.solve(b).is_none());
    }
}
