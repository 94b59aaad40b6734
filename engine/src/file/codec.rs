//! What the compressed formats share: bounded memory, opacity and colour codes, quaternions by their three smallest parts,
//! codebooks, an order in space.

use std::path::Path;

use crate::error::{Error, Result};
use crate::scene::Gaussians;

/// Basis function of SH degree 0: colour = 0.5 + `SH_C0`·coefficient (3DGS).
pub(crate) const SH_C0: f64 = 0.282_094_791_773_878_14;
/// Opacities of 8-bit formats are kept this far from 0 and 1, so that their logits are finite.
const OPACITY_MARGIN: f64 = 1.0e-6;
/// Memory that reading any file may take, bytes.
const MEMORY: u64 = 1536 << 20;
/// Memory per byte of the file, where that is more: no format packs a Gaussian (at most 300 bytes unpacked) below 3 bytes.
const MEMORY_PER_BYTE: u64 = 100;

/// Refuses to unpack more than a file of this size can hold: a few damaged bytes must not ask for all memory.
pub(crate) fn check_memory(path: &Path, what: &str, need: u128, file_bytes: u64) -> Result<()> {
    let have = u128::from(MEMORY.max(file_bytes.saturating_mul(MEMORY_PER_BYTE)));
    if need <= have {
        return Ok(());
    }
    Err(Error::Limit { what: format!("{}: memory to unpack {what}, bytes", path.display()), need, have })
}

/// Bytes of `n` Gaussians of an SH degree in memory.
pub(crate) fn scene_bytes(n: u64, degree: u32) -> u128 {
    u128::from(n) * (44 + 12 * u128::from((degree + 1) * (degree + 1)))
}

/// `n` Gaussians, all zero.
pub(crate) fn allocate(n: usize, degree: u32) -> Gaussians {
    let k3 = 3 * ((degree + 1) * (degree + 1)) as usize;
    Gaussians {
        mean: vec![[0.0; 3]; n],
        log_scale: vec![[0.0; 3]; n],
        rotation: vec![[0.0; 4]; n],
        opacity_logit: vec![0.0; n],
        sh_degree: degree,
        sh: vec![0.0; n * k3],
        ..Gaussians::default()
    }
}

/// Logit of an opacity that was stored in few bits.
pub(crate) fn logit(opacity: f64) -> f32 {
    let o = opacity.clamp(OPACITY_MARGIN, 1.0 - OPACITY_MARGIN);
    (o / (1.0 - o)).ln() as f32
}

/// Opacity of a logit.
pub(crate) fn sigmoid(logit: f32) -> f64 {
    1.0 / (1.0 + (-f64::from(logit)).exp())
}

/// 0 to 1 in 8 bits.
pub(crate) fn to_byte(unit: f64) -> u8 {
    (unit.clamp(0.0, 1.0) * 255.0).round() as u8
}

/// The unit quaternion; the identity for one that has no length.
pub(crate) fn unit(q: [f32; 4]) -> [f64; 4] {
    let q = q.map(f64::from);
    let length = q.iter().map(|c| c * c).sum::<f64>().sqrt();
    if length > 0.0 && length.is_finite() { q.map(|c| c / length) } else { [1.0, 0.0, 0.0, 0.0] }
}

/// Index of the largest part of a unit quaternion, and the others in order, of the sign that makes the largest positive.
pub(crate) fn smallest_three(q: [f64; 4]) -> (usize, [f64; 3]) {
    let largest = (1..4).fold(0, |best, i| if q[i].abs() > q[best].abs() { i } else { best });
    let sign = if q[largest] < 0.0 { -1.0 } else { 1.0 };
    let mut rest = (0..4).filter(|&i| i != largest).map(|i| sign * q[i]);
    (largest, std::array::from_fn(|_| rest.next().unwrap_or(0.0)))
}

/// Inverse of [`smallest_three`].
pub(crate) fn from_smallest_three(largest: usize, rest: [f64; 3]) -> [f32; 4] {
    let missing = (1.0 - rest.iter().map(|c| c * c).sum::<f64>()).max(0.0).sqrt();
    let mut rest = rest.into_iter();
    std::array::from_fn(|i| (if i == largest { missing } else { rest.next().unwrap_or(0.0) }) as f32)
}

/// The Gaussians' indices in Morton order of their centres: neighbours in space are close in the file.
pub(crate) fn morton_order(means: &[[f32; 3]]) -> Vec<usize> {
    let bounds = bounds(means);
    let cell = |m: &[f32; 3]| {
        let part = |a: usize| {
            let [low, high] = bounds[a];
            let share = if high > low { (f64::from(m[a]) - low) / (high - low) } else { 0.0 };
            (share.clamp(0.0, 1.0) * 2_097_151.0) as u64
        };
        spread(part(0)) | spread(part(1)) << 1 | spread(part(2)) << 2
    };
    let mut keyed: Vec<(u64, usize)> = means.iter().enumerate().map(|(i, m)| (cell(m), i)).collect();
    keyed.sort_unstable();
    keyed.into_iter().map(|(_, i)| i).collect()
}

/// Two zero bits between the bits of a 21-bit number.
fn spread(v: u64) -> u64 {
    let v = (v | v << 32) & 0x001f_0000_0000_ffff;
    let v = (v | v << 16) & 0x001f_0000_ff00_00ff;
    let v = (v | v << 8) & 0x100f_00f0_0f00_f00f;
    let v = (v | v << 4) & 0x10c3_0c30_c30c_30c3;
    (v | v << 2) & 0x1249_2492_4924_9249
}

/// Smallest and largest value on each axis.
pub(crate) fn bounds<const W: usize>(values: &[[f32; W]]) -> [[f64; 2]; W] {
    let mut bounds = [[f64::INFINITY, f64::NEG_INFINITY]; W];
    for value in values {
        for (b, v) in bounds.iter_mut().zip(value) {
            *b = [b[0].min(f64::from(*v)), b[1].max(f64::from(*v))];
        }
    }
    if values.is_empty() { [[0.0; 2]; W] } else { bounds }
}

/// Iterations of [`codebook`]: errors change by less than a percent after that.
const LLOYD: usize = 12;

/// At most 256 ascending values that stand for all `values` with a small squared error: Lloyd's algorithm in one dimension,
/// started from quantiles. Fewer distinct values are kept exactly. The result always has 256 entries (the last is repeated).
pub(crate) fn codebook(values: impl Iterator<Item = f32>) -> Vec<f32> {
    let mut sorted: Vec<f32> = values.filter(|v| v.is_finite()).collect();
    sorted.sort_unstable_by(f32::total_cmp);
    let mut distinct = sorted.clone();
    distinct.dedup();
    let mut book: Vec<f64> = if distinct.len() <= 256 {
        distinct.iter().map(|&v| f64::from(v)).collect()
    } else {
        // Half by share of the values, half by range: outliers get entries too.
        let n = sorted.len() - 1;
        let (low, high) = (f64::from(sorted[0]), f64::from(sorted[n]));
        let quantiles = (0..128).map(|i| f64::from(sorted[n * i / 127]));
        let even = (0..128).map(|i| low + (high - low) * (f64::from(i) + 0.5) / 128.0);
        lloyd(&sorted, quantiles.chain(even).collect())
    };
    let last = book.last().copied().unwrap_or(0.0);
    book.resize(256, last);
    book.into_iter().map(|v| v as f32).collect()
}

fn lloyd(sorted: &[f32], mut book: Vec<f64>) -> Vec<f64> {
    let mut sums = Vec::with_capacity(sorted.len() + 1);
    sums.push(0.0);
    for &v in sorted {
        sums.push(sums[sums.len() - 1] + f64::from(v));
    }
    book.sort_unstable_by(f64::total_cmp);
    for _ in 0..LLOYD {
        let mut first = 0;
        for i in 0..book.len() {
            let edge = book.get(i + 1).map_or(f64::INFINITY, |next| 0.5 * (book[i] + next));
            let end = first + sorted[first..].partition_point(|&v| f64::from(v) < edge);
            if end > first {
                book[i] = (sums[end] - sums[first]) / (end - first) as f64;
            }
            first = end;
        }
        book.sort_unstable_by(f64::total_cmp);
    }
    book
}

/// Index of the nearest entry of an ascending codebook.
pub(crate) fn nearest(book: &[f32], value: f32) -> u8 {
    let after = book.partition_point(|&b| b < value);
    let candidates = [after.saturating_sub(1), after.min(book.len() - 1)];
    let distance = |i: usize| (f64::from(book[i]) - f64::from(value)).abs();
    (if distance(candidates[1]) < distance(candidates[0]) { candidates[1] } else { candidates[0] }) as u8
}

/// Little-endian numbers in order, with the place for errors.
pub(crate) struct Cursor<'a> {
    pub(crate) bytes: &'a [u8],
    pub(crate) at: usize,
    pub(crate) path: &'a Path,
    /// What the bytes are, for errors ("byte", "the unpacked data, byte").
    pub(crate) unit: &'static str,
}

impl<'a> Cursor<'a> {
    /// From the first byte of a file.
    pub(crate) fn new(bytes: &'a [u8], path: &'a Path) -> Self {
        Self { bytes, at: 0, path, unit: "byte" }
    }

    /// The next `n` bytes.
    pub(crate) fn take(&mut self, n: usize, what: &str) -> Result<&'a [u8]> {
        let end = self.at.checked_add(n).filter(|&end| end <= self.bytes.len());
        let Some(end) = end else {
            let found = format!("{} bytes to the end", self.bytes.len() - self.at);
            let at = format!("{} {} ({what})", self.unit, self.at);
            return Err(Error::corrupt(self.path, at, found, format!("{n} bytes")));
        };
        let part = &self.bytes[self.at..end];
        self.at = end;
        Ok(part)
    }

    pub(crate) fn u8(&mut self, what: &str) -> Result<u8> {
        Ok(self.take(1, what)?[0])
    }

    pub(crate) fn u32(&mut self, what: &str) -> Result<u32> {
        Ok(u32_at(self.take(4, what)?, 0))
    }

    pub(crate) fn u64(&mut self, what: &str) -> Result<u64> {
        Ok(self.take(8, what)?.first_chunk().map_or(0, |b| u64::from_le_bytes(*b)))
    }

    /// An error at the place `back` bytes before the next one.
    pub(crate) fn corrupt(
        &self,
        back: usize,
        what: &str,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Error {
        let at = format!("{} {} ({what})", self.unit, self.at.saturating_sub(back));
        Error::corrupt(self.path, at, found, expected)
    }
}

/// The u32 at element `i`; missing bytes read as 0 (callers have checked the length).
#[inline]
pub(crate) fn u32_at(bytes: &[u8], i: usize) -> u32 {
    bytes.get(4 * i..).and_then(<[u8]>::first_chunk).map_or(0, |b| u32::from_le_bytes(*b))
}

/// The f32 at element `i`, as [`u32_at`].
#[inline]
pub(crate) fn f32_at(bytes: &[u8], i: usize) -> f32 {
    f32::from_bits(u32_at(bytes, i))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    #[test]
    fn quaternions_survive_losing_their_largest_part() {
        for q in [[0.5, -0.5, 0.5, 0.5], [-0.8, 0.0, 0.6, 0.0], [0.1, 0.2, -0.3, (1.0f64 - 0.14).sqrt()]] {
            let (largest, rest) = smallest_three(q);
            let back = from_smallest_three(largest, rest).map(f64::from);
            let dot: f64 = q.iter().zip(back).map(|(a, b)| a * b).sum();
            assert!((dot.abs() - 1.0).abs() < 1e-6, "{q:?} {back:?}");
        }
        assert_eq!(unit([0.0; 4]), [1.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn codebooks_are_exact_for_few_values_and_close_for_many() {
        let few: Vec<f32> = (0..1000).map(|i| (i % 200) as f32 * 0.25).collect();
        let book = codebook(few.iter().copied());
        assert!(few.iter().all(|&v| book[usize::from(nearest(&book, v))] == v));
        let many: Vec<f32> = (0..20_000).map(|i| ((i as f32) * 0.37).sin().powi(3)).chain([50.0]).collect();
        let book = codebook(many.iter().copied());
        let worst = many.iter().map(|&v| (book[usize::from(nearest(&book, v))] - v).abs()).fold(0.0, f32::max);
        assert!(book.len() == 256 && book.windows(2).all(|w| w[0] <= w[1]) && worst < 0.25, "{worst}");
        assert_eq!(codebook(std::iter::empty()).len(), 256);
    }

    #[test]
    fn morton_order_is_a_permutation_that_keeps_neighbours() {
        let means: Vec<[f32; 3]> = (0..64).map(|i| [(i % 4) as f32, (i / 4 % 4) as f32, (i / 16) as f32]).collect();
        let order = morton_order(&means);
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..64).collect::<Vec<_>>());
        assert!(order[..8].iter().all(|&i| means[i].iter().all(|&c| c < 2.0)));
    }
}
