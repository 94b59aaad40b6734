//! Separable filters, row by row: what a row of the result needs is summed vertically into a padded row, then
//! horizontally. No picture-sized temporaries.

/// Normalised Gaussian of `2·radius + 1` taps.
pub(super) fn gaussian(radius: usize, sigma: f64) -> Vec<f64> {
    let weight = |i: usize| (-(i as f64 - radius as f64).powi(2) / (2.0 * sigma * sigma)).exp();
    let sum: f64 = (0..=2 * radius).map(weight).sum();
    (0..=2 * radius).map(|i| weight(i) / sum).collect()
}

/// A number that filters work in.
pub(super) trait Real: Copy + Default + Send + Sync {
    /// `self · factor + sum`; with `FMA`, which needs the instruction to be fast, rounded once.
    fn times_plus<const FMA: bool>(self, factor: Self, sum: Self) -> Self;
}
impl Real for f32 {
    #[inline(always)]
    fn times_plus<const FMA: bool>(self, factor: Self, sum: Self) -> Self {
        if FMA { self.mul_add(factor, sum) } else { self * factor + sum }
    }
}
impl Real for f64 {
    #[inline(always)]
    fn times_plus<const FMA: bool>(self, factor: Self, sum: Self) -> Self {
        if FMA { self.mul_add(factor, sum) } else { self * factor + sum }
    }
}

/// Values of a row that are summed side by side: their sums stay in registers while the taps pass.
const LANES: usize = 16;

/// `out[x] = Σ_k taps[k]·padded[x + k]`.
#[inline(always)]
pub(super) fn horizontal<const FMA: bool, T: Real>(padded: &[T], taps: &[T], out: &mut [T]) {
    let width = out.len();
    for first in (0..width).step_by(LANES) {
        let lanes = LANES.min(width - first);
        let terms = taps.iter().enumerate().map(|(k, &tap)| (tap, &padded[first + k..first + k + lanes]));
        sum_terms::<FMA, T>(terms, &mut out[first..first + lanes]);
    }
}

/// `out = Σ_k taps[k]·row(y + k − radius)` of a plane, edges repeated.
#[inline(always)]
pub(super) fn vertical<const FMA: bool, T: Real>(plane: &[T], width: usize, y: usize, taps: &[T], out: &mut [T]) {
    for first in (0..width).step_by(LANES) {
        let lanes = LANES.min(width - first);
        let terms = replicated_rows(plane.len() / width, y, taps.len()).zip(taps).map(|(row, &tap)| {
            let at = row * width + first;
            (tap, &plane[at..at + lanes])
        });
        sum_terms::<FMA, T>(terms, &mut out[first..first + lanes]);
    }
}

/// `out = Σ tap·values` over the terms, whose values are as many as `out` has, at most [`LANES`].
#[inline(always)]
fn sum_terms<'a, const FMA: bool, T: Real + 'a>(terms: impl Iterator<Item = (T, &'a [T])>, out: &mut [T]) {
    let mut sum = [T::default(); LANES];
    for (tap, values) in terms {
        // A known length makes vector code; the last values of a row go the slow way.
        if let Some(values) = values.first_chunk::<LANES>() {
            for (s, &v) in sum.iter_mut().zip(values) {
                *s = tap.times_plus::<FMA>(v, *s);
            }
        } else {
            for (s, &v) in sum.iter_mut().zip(values) {
                *s = tap.times_plus::<FMA>(v, *s);
            }
        }
    }
    out.copy_from_slice(&sum[..out.len()]);
}

/// Rows `y − radius ..= y + radius`; those outside are the edge again.
#[inline(always)]
pub(super) fn replicated_rows(height: usize, y: usize, taps: usize) -> impl Iterator<Item = usize> {
    (0..taps).map(move |k| (y + k).saturating_sub(taps / 2).min(height - 1))
}

/// Fills the padding of a row: `radius` values left and right of its middle repeat its ends.
pub(super) fn replicate_ends<T: Copy>(padded: &mut [T], radius: usize) {
    let end = padded.len() - radius;
    let (first, last) = (padded[radius], padded[end - 1]);
    padded[..radius].fill(first);
    padded[end..].fill(last);
}

/// Row `y` of a plane under the product of two filters of equal length, edges repeated.
#[inline(always)]
pub(super) fn filtered_row<const FMA: bool, T: Real>(
    plane: &[T],
    width: usize,
    y: usize,
    down: &[T],
    across: &[T],
) -> Vec<T> {
    let radius = down.len() / 2;
    let mut padded = vec![T::default(); width + 2 * radius];
    vertical::<FMA, T>(plane, width, y, down, &mut padded[radius..radius + width]);
    replicate_ends(&mut padded, radius);
    let mut row = vec![T::default(); width];
    horizontal::<FMA, T>(&padded, across, &mut row);
    row
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn taps_sum_to_one_and_are_even() {
        let taps = gaussian(5, 1.5);
        assert!((taps.iter().sum::<f64>() - 1.0).abs() < 1e-15 && taps[0] == taps[10] && taps.len() == 11);
    }

    #[test]
    fn edges_repeat() {
        assert_eq!(replicated_rows(2, 0, 5).collect::<Vec<_>>(), [0, 0, 0, 1, 1]);
        assert_eq!(replicated_rows(9, 8, 3).collect::<Vec<_>>(), [7, 8, 8]);
        let mut padded = [0.0, 0.0, 7.0, 8.0, 0.0, 0.0];
        replicate_ends(&mut padded, 2);
        assert_eq!(padded, [7.0, 7.0, 7.0, 8.0, 8.0, 8.0]);
        let mut out = [0.0; 2];
        horizontal::<false, _>(&padded, &[1.0, 0.0, 10.0, 0.0, 0.0], &mut out);
        assert_eq!(out, [77.0, 87.0]);
    }

    #[test]
    fn filters_are_their_definition_at_any_width() {
        let (height, taps) = (7, [0.5, -1.0, 2.0, 0.25, 3.0]);
        for width in [1, 15, 16, 17, 40] {
            let plane: Vec<f64> = (0..width * height).map(|i| f64::from(i as u32 * 37 % 101)).collect();
            for y in 0..height {
                let row = filtered_row::<false, _>(&plane, width, y, &taps, &taps);
                let fused = filtered_row::<true, _>(&plane, width, y, &taps, &taps);
                for (x, (value, fused)) in row.iter().zip(&fused).enumerate() {
                    let at = |i: usize, k: usize, side: usize| (i + k).saturating_sub(2).min(side - 1);
                    let term =
                        |k: usize, l: usize| taps[k] * taps[l] * plane[at(y, k, height) * width + at(x, l, width)];
                    let truth: f64 = (0..5).flat_map(|k| (0..5).map(move |l| term(k, l))).sum();
                    assert!((value - truth).abs() < 1e-9 && (fused - truth).abs() < 1e-9, "{width} ({x}, {y})");
                }
            }
        }
    }
}
