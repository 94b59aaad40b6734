//! Separable filters, row by row: what a row of the result needs is summed vertically into a padded row, then
//! horizontally. No picture-sized temporaries.

/// Normalised Gaussian of `2·radius + 1` taps.
pub(super) fn gaussian(radius: usize, sigma: f64) -> Vec<f64> {
    let weight = |i: usize| (-(i as f64 - radius as f64).powi(2) / (2.0 * sigma * sigma)).exp();
    let sum: f64 = (0..=2 * radius).map(weight).sum();
    (0..=2 * radius).map(|i| weight(i) / sum).collect()
}

/// A number that filters work in.
pub(super) trait Real:
    Copy + Default + Send + Sync + std::ops::Mul<Output = Self> + std::ops::AddAssign
{
}
impl Real for f32 {}
impl Real for f64 {}

/// `out[x] = Σ_k taps[k]·padded[x + k]`.
pub(super) fn horizontal<T: Real>(padded: &[T], taps: &[T], out: &mut [T]) {
    out.fill(T::default());
    let width = out.len();
    for (k, &tap) in taps.iter().enumerate() {
        add_scaled(out, &padded[k..k + width], tap);
    }
}

/// `sum += scale·row`.
pub(super) fn add_scaled<T: Real>(sum: &mut [T], row: &[T], scale: T) {
    for (s, &v) in sum.iter_mut().zip(row) {
        *s += scale * v;
    }
}

/// Rows `y − radius ..= y + radius` of a plane with the tap of each; rows outside repeat the edge.
fn replicated_rows<'a, T>(
    plane: &'a [T],
    width: usize,
    y: usize,
    taps: usize,
) -> impl Iterator<Item = (usize, &'a [T])> {
    let (height, radius) = (plane.len() / width.max(1), taps / 2);
    (0..taps).map(move |k| {
        let row = (y + k).saturating_sub(radius).min(height.saturating_sub(1));
        (k, &plane[row * width..(row + 1) * width])
    })
}

/// Fills the padding of a row: `radius` values left and right of its middle repeat its ends.
pub(super) fn replicate_ends<T: Copy>(padded: &mut [T], radius: usize) {
    let end = padded.len() - radius;
    let (first, last) = (padded[radius], padded[end - 1]);
    padded[..radius].fill(first);
    padded[end..].fill(last);
}

/// `out = Σ_k taps[k]·row(y + k − radius)`, edges repeated.
pub(super) fn vertical<T: Real>(plane: &[T], width: usize, y: usize, taps: &[T], out: &mut [T]) {
    out.fill(T::default());
    for (k, row) in replicated_rows(plane, width, y, taps.len()) {
        add_scaled(out, row, taps[k]);
    }
}

/// Row `y` of a plane under the product of two filters of equal length, edges repeated.
pub(super) fn filtered_row<T: Real>(plane: &[T], width: usize, y: usize, down: &[T], across: &[T]) -> Vec<T> {
    let radius = down.len() / 2;
    let mut padded = vec![T::default(); width + 2 * radius];
    vertical(plane, width, y, down, &mut padded[radius..radius + width]);
    replicate_ends(&mut padded, radius);
    let mut row = vec![T::default(); width];
    horizontal(&padded, across, &mut row);
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
        let plane = [1.0, 2.0, 3.0, 4.0];
        let rows: Vec<f64> = replicated_rows(&plane, 2, 0, 5).map(|(_, r)| r[0]).collect();
        assert_eq!(rows, [1.0, 1.0, 1.0, 3.0, 3.0]);
        let mut padded = [0.0, 0.0, 7.0, 8.0, 0.0, 0.0];
        replicate_ends(&mut padded, 2);
        assert_eq!(padded, [7.0, 7.0, 7.0, 8.0, 8.0, 8.0]);
        let mut out = [0.0; 2];
        horizontal(&padded, &[1.0, 0.0, 10.0, 0.0, 0.0], &mut out);
        assert_eq!(out, [77.0, 87.0]);
    }
}
