//! Comparison of gradients: relative L2 distance, cosine, and nothing that was silently left out.

use std::ops::Range;

/// Largest ‖gpu − twin‖ / ‖twin‖.
pub const MAX_RELATIVE_L2: f64 = 1e-4;
/// Smallest cosine of the angle between them.
pub const MIN_COSINE: f64 = 0.9999;
/// A value of the twin above this share of its root mean square must not be exactly 0 on the device.
const ZEROED_SHARE: f64 = 1e-3;

/// ‖a − b‖ / ‖b‖; 0 when both are zero, infinite when only `b` is.
pub fn relative_l2(a: &[f32], b: &[f32]) -> f64 {
    let distance = norm(a.iter().zip(b).map(|(a, b)| f64::from(*a) - f64::from(*b)));
    let length = norm(b.iter().map(|b| f64::from(*b)));
    if distance == 0.0 { 0.0 } else { distance / length }
}

/// a·b / (‖a‖‖b‖); 1 when both are zero.
pub fn cosine(a: &[f32], b: &[f32]) -> f64 {
    let length = |v: &[f32]| norm(v.iter().map(|x| f64::from(*x)));
    let dot: f64 = a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
    let (a, b) = (length(a), length(b));
    if a == 0.0 && b == 0.0 { 1.0 } else { dot / (a * b).max(f64::MIN_POSITIVE) }
}

fn norm(values: impl Iterator<Item = f64>) -> f64 {
    values.map(|v| v * v).sum::<f64>().sqrt()
}

/// Some columns of rows of `stride` values, for comparing one kind of gradient at a time.
pub fn columns(values: &[f32], stride: usize, range: Range<usize>) -> Vec<f32> {
    values.chunks_exact(stride).flat_map(|row| row[range.clone()].iter().copied()).collect()
}

/// Asserts that a gradient from the device agrees with its twin or truth.
///
/// # Panics
/// When lengths differ, a value from the device is not finite, the relative L2 distance exceeds [`MAX_RELATIVE_L2`], the
/// cosine is below [`MIN_COSINE`], or a value that matters is exactly 0 on the device.
pub fn assert_gradients_close(gpu: &[f32], twin: &[f32], context: &str) {
    assert_eq!(gpu.len(), twin.len(), "{context}: lengths");
    if let Some(i) = gpu.iter().position(|v| !v.is_finite()) {
        panic!("{context}: [{i}] is {} on the device, {} in the twin", gpu[i], twin[i]);
    }
    let (distance, angle) = (relative_l2(gpu, twin), cosine(gpu, twin));
    if distance > MAX_RELATIVE_L2 || angle < MIN_COSINE {
        let error = |i: &usize| (gpu[*i] - twin[*i]).abs();
        let worst = (0..gpu.len()).max_by(|a, b| error(a).total_cmp(&error(b))).unwrap_or(0);
        panic!(
            "{context}: relative L2 {distance:.2e} (at most {MAX_RELATIVE_L2:e}), cosine {angle:.7} (at least \
             {MIN_COSINE}); worst [{worst}]: gpu {}, twin {}",
            gpu[worst], twin[worst]
        );
    }
    let rms = norm(twin.iter().map(|t| f64::from(*t))) / (twin.len().max(1) as f64).sqrt();
    let zeroed = (0..gpu.len()).find(|&i| gpu[i] == 0.0 && f64::from(twin[i].abs()) > ZEROED_SHARE * rms);
    assert!(zeroed.is_none(), "{context}: [{zeroed:?}] is 0 on the device, {} in the twin", twin[zeroed.unwrap_or(0)]);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_gradients_are_close() {
        assert_gradients_close(&[], &[], "empty");
        assert_gradients_close(&[0.0, 0.0], &[0.0, 0.0], "zero");
        assert_gradients_close(&[1.0, -2.0, 3.00001], &[1.0, -2.0, 3.0], "rounded");
        assert_eq!(columns(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], 3, 1..3), [2.0, 3.0, 5.0, 6.0]);
    }

    #[test]
    fn differences_are_noticed() {
        let refused = |gpu: &[f32], twin: &[f32]| {
            let (gpu, twin) = (gpu.to_vec(), twin.to_vec());
            assert!(std::panic::catch_unwind(move || assert_gradients_close(&gpu, &twin, "wrong")).is_err());
        };
        refused(&[1.0, 2.0], &[1.0, 2.001]);
        refused(&[1.0, f32::NAN], &[1.0, 2.0]);
        refused(&[1.0], &[0.0]);
        refused(&[0.0], &[1.0]);
        refused(&[1.0], &[1.0, 2.0]);
        // Small against the whole, but dropped.
        let mut large = vec![1.0; 100_000];
        large[7] = 1.2e-3;
        let mut dropped = large.clone();
        dropped[7] = 0.0;
        refused(&dropped, &large);
    }
}
