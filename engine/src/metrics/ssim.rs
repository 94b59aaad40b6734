//! Structural similarity and its multi-scale form.
//!
//! SSIM(x, y) = l·cs with l = (2μ_xμ_y + C1)/(μ_x² + μ_y² + C1) and cs = (2σ_xy + C2)/(σ_x² + σ_y² + C2), C1 = 0.01²,
//! C2 = 0.03² for a data range of 1 (Wang, Bovik, Sheikh, Simoncelli 2004), moments under an 11×11 Gaussian of σ 1.5 px,
//! not corrected for the sample, each channel by itself.

use multiversion::multiversion;
use multiversion::target::target_cfg_f;
use rayon::prelude::*;

use super::filter::{Real as _, gaussian, horizontal};
use super::planes::{Planes, Weights, same_size, weights_fit};
use crate::error::Result;

/// 0.01².
const C1: f64 = 1.0e-4;
/// 0.03².
const C2: f64 = 9.0e-4;
const RADIUS: usize = 5;
const SIGMA: f64 = 1.5;
/// Exponents of the five scales, finest first (Wang, Simoncelli, Bovik 2003, section 3.2).
pub const SCALE_WEIGHTS: [f64; 5] = [0.0448, 0.2856, 0.3001, 0.2363, 0.1333];
/// Smallest picture side that five scales can be taken of: the window must fit the coarsest.
pub const MS_SSIM_MIN_SIDE: usize = 2 * RADIUS * 16 + 1;

/// SSIM of a pair of pictures.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct SsimScores {
    /// Mean over all pixels and channels, zeros outside the picture: as `loss_utils.py` of 3DGS, SP-GS and their family.
    pub zero_padded: f64,
    /// Mean over windows that lie inside the picture (a margin of 5 pixels is left out), as `scikit-image` and
    /// `pytorch_msssim` have it; `None` for a picture smaller than the window, or where the weights leave no such window.
    pub valid: Option<f64>,
}

/// SSIM with both borders. Weights multiply the map of similarities.
///
/// # Errors
/// [`crate::Error::Usage`] for pictures of different sizes or weights of another size.
pub fn ssim(reference: &Planes, test: &Planes, weights: Option<&Weights>) -> Result<SsimScores> {
    same_size(reference, test)?;
    weights_fit(reference, weights)?;
    Ok(Sums::total(&channels(reference, test, weights)).scores())
}

/// MS-SSIM: Π over the scales of mean(cs)^w, the coarsest by mean(SSIM)^w, windows inside the picture, negative means
/// taken as 0, each channel by itself and their mean (as `pytorch_msssim` and, for a stated data range, `torchmetrics`).
/// A scale is the 2×2 average of the one before; a side of odd length gets a zero at each end first. `None` for pictures
/// with a side below [`MS_SSIM_MIN_SIDE`].
///
/// Note: the SP-GS code calls `torchmetrics` with the data range unset, which then follows the values of each picture; here
/// it is always 1.
///
/// # Errors
/// [`crate::Error::Usage`] for pictures of different sizes.
pub fn ms_ssim(reference: &Planes, test: &Planes) -> Result<Option<f64>> {
    Ok(ssim_and_ms_ssim(reference, test)?.1)
}

/// [`ssim()`] and [`ms_ssim()`] of whole pictures, which share their finest scale.
///
/// # Errors
/// [`crate::Error::Usage`] for pictures of different sizes.
pub fn ssim_and_ms_ssim(reference: &Planes, test: &Planes) -> Result<(SsimScores, Option<f64>)> {
    same_size(reference, test)?;
    let finest = channels(reference, test, None);
    let scores = Sums::total(&finest).scores();
    if reference.width.min(reference.height) < MS_SSIM_MIN_SIDE {
        return Ok((scores, None));
    }
    let size = [reference.width, reference.height];
    let of = |c: usize| channel_ms_ssim(&reference.rgb[c], &test.rgb[c], size, finest[c]);
    Ok((scores, Some((0..3).map(of).sum::<f64>() / 3.0)))
}

fn channels(reference: &Planes, test: &Planes, weights: Option<&Weights>) -> [Sums; 3] {
    let size = [reference.width, reference.height];
    [0, 1, 2].map(|c: usize| channel_sums(&reference.rgb[c], &test.rgb[c], size, weights.map(Weights::values)))
}

fn channel_ms_ssim(x: &[f64], y: &[f64], size: [usize; 2], finest: Sums) -> f64 {
    let (mut x, mut y, mut size) = (halved(x, size), halved(y, size), size.map(|side| side.div_ceil(2)));
    let [first, middle @ .., last] = &SCALE_WEIGHTS;
    let mut product = finest.mean_cs().powf(*first);
    for weight in middle {
        product *= channel_sums(&x, &y, size, None).mean_cs().powf(*weight);
        (x, y) = (halved(&x, size), halved(&y, size));
        size = size.map(|side| side.div_ceil(2));
    }
    product * channel_sums(&x, &y, size, None).mean_valid().powf(*last)
}

/// 2×2 averages; a side of odd length has a zero before its first and after its last value.
fn halved(values: &[f64], [width, height]: [usize; 2]) -> Vec<f64> {
    let (w, h) = (width.div_ceil(2), height.div_ceil(2));
    let (odd_width, odd_height) = (width % 2, height % 2);
    let mut out = vec![0.0; w * h];
    out.par_chunks_exact_mut(w).enumerate().for_each(|(y, row)| {
        // Rows 2y − odd and 2y + 1 − odd where they exist.
        for source in (2 * y).saturating_sub(odd_height)..(2 * y + 2 - odd_height).min(height) {
            let line = &values[source * width..(source + 1) * width];
            if odd_width == 1 {
                row[0] += line[0] / 4.0;
            }
            for (value, [a, b]) in row[odd_width..].iter_mut().zip(line[odd_width..].as_chunks().0) {
                *value += (a + b) / 4.0;
            }
        }
    });
    out
}

/// Weighted sums of the maps of one channel, over all pixels and over the windows inside.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    all: f64,
    all_weight: f64,
    valid: f64,
    valid_cs: f64,
    valid_weight: f64,
}

impl Sums {
    fn total(list: &[Self]) -> Self {
        let mut total = Self::default();
        list.iter().for_each(|s| total.add(s));
        total
    }

    fn scores(&self) -> SsimScores {
        let valid = (self.valid_weight > 0.0).then(|| self.valid / self.valid_weight);
        SsimScores { zero_padded: self.all / self.all_weight, valid }
    }

    /// Mean contrast and structure of the windows inside, not below 0.
    fn mean_cs(&self) -> f64 {
        (self.valid_cs / self.valid_weight).max(0.0)
    }

    /// Mean SSIM of the windows inside, not below 0.
    fn mean_valid(&self) -> f64 {
        (self.valid / self.valid_weight).max(0.0)
    }

    fn add(&mut self, other: &Self) {
        self.all += other.all;
        self.all_weight += other.all_weight;
        self.valid += other.valid;
        self.valid_cs += other.valid_cs;
        self.valid_weight += other.valid_weight;
    }
}

/// Both borders come from one pass: a window inside the picture sees no padding.
fn channel_sums(x: &[f64], y: &[f64], [width, height]: [usize; 2], weights: Option<&[f64]>) -> Sums {
    let taps = gaussian(RADIUS, SIGMA);
    let rows: Vec<Sums> = (0..height)
        .into_par_iter()
        .map_init(
            || RowMoments::new(width),
            |moments, row| row_sums(moments, x, y, [width, height], row, &taps, weights),
        )
        .collect();
    Sums::total(&rows)
}

/// One row of [`channel_sums`].
#[multiversion(targets("x86_64+avx2+fma"))]
fn row_sums(
    moments: &mut RowMoments,
    x: &[f64],
    y: &[f64],
    [width, height]: [usize; 2],
    row: usize,
    taps: &[f64],
    weights: Option<&[f64]>,
) -> Sums {
    if target_cfg_f!(target_feature = "fma") {
        moments.fill::<true>(x, y, [width, height], row, taps);
    } else {
        moments.fill::<false>(x, y, [width, height], row, taps);
    }
    let inside = row >= RADIUS && row + RADIUS < height;
    moments.sums(inside, weights.map(|w| &w[row * width..(row + 1) * width]))
}

/// Columns that are summed side by side: their sums stay in registers while the rows pass.
const LANES: usize = 8;

/// Adds tap·(x, y, x² + y², xy) of [`LANES`] columns.
#[inline(always)]
fn add_products<const FMA: bool>(sums: &mut [[f64; LANES]; 4], x: &[f64; LANES], y: &[f64; LANES], tap: f64) {
    for i in 0..LANES {
        sums[0][i] = tap.times_plus::<FMA>(x[i], sums[0][i]);
        sums[1][i] = tap.times_plus::<FMA>(y[i], sums[1][i]);
        sums[2][i] = tap.times_plus::<FMA>(x[i].times_plus::<FMA>(x[i], y[i] * y[i]), sums[2][i]);
        sums[3][i] = tap.times_plus::<FMA>(x[i] * y[i], sums[3][i]);
    }
}

/// [`LANES`] values of a row from `first` on; `None` past its last whole block.
#[inline(always)]
fn block(row: &[f64], first: usize) -> Option<&[f64; LANES]> {
    row.get(first..)?.first_chunk()
}

/// The values of a row from `first` on; zeros past its end.
fn padded(row: &[f64], first: usize) -> [f64; LANES] {
    let mut out = [0.0; LANES];
    out.iter_mut().zip(&row[first..]).for_each(|(out, value)| *out = *value);
    out
}

/// Sum of a row, in [`LANES`] parts side by side.
#[inline(always)]
fn sum(values: &[f64]) -> f64 {
    let (blocks, rest) = values.as_chunks::<LANES>();
    let mut lanes = [0.0; LANES];
    for block in blocks {
        lanes.iter_mut().zip(block).for_each(|(sum, value)| *sum += value);
    }
    lanes.iter().chain(rest).sum()
}

/// μ_x, μ_y, E[x² + y²] and E\[xy\] of one row of windows.
struct RowMoments {
    padded: [Vec<f64>; 4],
    row: [Vec<f64>; 4],
}

impl RowMoments {
    fn new(width: usize) -> Self {
        let rows = |length: usize| std::array::from_fn(|_| vec![0.0; length]);
        Self { padded: rows(width + 2 * RADIUS), row: rows(width) }
    }

    #[inline(always)]
    fn fill<const FMA: bool>(&mut self, x: &[f64], y: &[f64], [width, height]: [usize; 2], row: usize, taps: &[f64]) {
        let first_tap = RADIUS.saturating_sub(row);
        let last_row = (row + RADIUS).min(height - 1);
        let rows = row.saturating_sub(RADIUS)..=last_row;
        for first in (0..width).step_by(LANES) {
            let mut sums = [[0.0; LANES]; 4];
            for (source, &tap) in rows.clone().zip(&taps[first_tap..]) {
                let line = source * width..(source + 1) * width;
                let (x, y) = (&x[line.clone()], &y[line]);
                if let (Some(x), Some(y)) = (block(x, first), block(y, first)) {
                    add_products::<FMA>(&mut sums, x, y, tap);
                } else {
                    add_products::<FMA>(&mut sums, &padded(x, first), &padded(y, first), tap);
                }
            }
            let count = LANES.min(width - first);
            for (padded, sums) in self.padded.iter_mut().zip(&sums) {
                padded[RADIUS + first..RADIUS + first + count].copy_from_slice(&sums[..count]);
            }
        }
        for (padded, row) in self.padded.iter().zip(&mut self.row) {
            horizontal::<FMA, f64>(padded, taps, row);
        }
    }

    /// Leaves the similarities in the rows of the means.
    #[inline(always)]
    fn sums(&mut self, inside: bool, weights: Option<&[f64]>) -> Sums {
        let [mx, my, squares, product] = &mut self.row;
        for (((mx, my), &mut squares), &mut product) in mx.iter_mut().zip(my.iter_mut()).zip(squares).zip(product) {
            let (both, apart) = (*mx * *my, *mx * *mx + *my * *my);
            let cs = (2.0 * (product - both) + C2) / (squares - apart + C2);
            (*mx, *my) = (cs * (2.0 * both + C1) / (apart + C1), cs);
        }
        let (ssim, cs) = (mx, my);
        if let Some(weights) = weights {
            ssim.iter_mut().zip(weights).for_each(|(ssim, weight)| *ssim *= weight);
            cs.iter_mut().zip(weights).for_each(|(cs, weight)| *cs *= weight);
        }
        let width = ssim.len();
        let weight = |columns: std::ops::Range<usize>| weights.map_or(columns.len() as f64, |w| sum(&w[columns]));
        let valid = if inside && width > 2 * RADIUS { RADIUS..width - RADIUS } else { 0..0 };
        Sums {
            all: sum(ssim),
            all_weight: weight(0..width),
            valid: sum(&ssim[valid.clone()]),
            valid_cs: sum(&cs[valid.clone()]),
            valid_weight: weight(valid),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;
    use crate::reference::gradient::loss::image_loss;
    use crate::scene::synthetic::Random;

    fn noise(size: [usize; 2], seed: u64) -> Planes {
        let mut random = Random::new(seed);
        let mut plane = || (0..size[0] * size[1]).map(|_| random.range(0.0, 1.0)).collect();
        Planes { width: size[0], height: size[1], rgb: [plane(), plane(), plane()] }
    }

    fn interleaved(p: &Planes) -> Vec<f64> {
        (0..p.pixels()).flat_map(|i| [p.rgb[0][i], p.rgb[1][i], p.rgb[2][i]]).collect()
    }

    #[test]
    fn zero_padded_is_what_the_training_loss_has() {
        for size in [[1, 1], [3, 20], [23, 17]] {
            let (a, b) = (noise(size, 1), noise(size, 2));
            let truth = image_loss(&interleaved(&a), &interleaved(&b), size, 1.0).ssim;
            assert!((ssim(&a, &b, None).unwrap().zero_padded - truth).abs() < 1e-12, "{size:?}");
        }
    }

    #[test]
    fn equal_pictures_are_one_and_small_ones_have_no_valid_window() {
        let a = noise([165, 170], 3);
        let s = ssim(&a, &a, None).unwrap();
        assert!((s.zero_padded - 1.0).abs() < 1e-12 && (s.valid.unwrap() - 1.0).abs() < 1e-12);
        assert!((ms_ssim(&a, &a).unwrap().unwrap() - 1.0).abs() < 1e-12);
        let small = noise([10, 40], 4);
        assert_eq!(ssim(&small, &small, None).unwrap().valid, None);
        assert_eq!(ms_ssim(&small, &small).unwrap(), None);
    }

    #[test]
    fn weights_choose_pixels() {
        let (a, b) = (noise([30, 24], 5), noise([30, 24], 6));
        let mut mixed = a.clone();
        // The left half differs; a mask of the far right sees no window that reaches it.
        for c in 0..3 {
            for i in (0..a.pixels()).filter(|i| i % 30 < 10) {
                mixed.rgb[c][i] = b.rgb[c][i];
            }
        }
        let mask = |f: fn(usize) -> bool| {
            Weights::new((0..a.pixels()).map(|i| f64::from(u8::from(f(i % 30)))).collect(), [30, 24]).unwrap()
        };
        let right = ssim(&a, &mixed, Some(&mask(|x| x >= 15))).unwrap();
        assert!((right.zero_padded - 1.0).abs() < 1e-12, "{right:?}");
        assert!(ssim(&a, &mixed, Some(&mask(|x| x < 10))).unwrap().zero_padded < 0.5);
        let ones = ssim(&a, &mixed, Some(&mask(|_| true))).unwrap();
        assert_eq!(ones, ssim(&a, &mixed, None).unwrap());
    }

    #[test]
    fn halving_averages_and_pads_odd_sides() {
        assert_eq!(halved(&[1.0, 2.0, 3.0, 4.0], [2, 2]), [2.5]);
        // A side of 3 becomes 0 1 | 2 3: the first average holds one zero.
        assert_eq!(halved(&[4.0, 8.0, 16.0, 4.0, 8.0, 16.0], [3, 2]), [2.0, 12.0]);
    }
}
