//! All pixel metrics of one pair of pictures, and their means.

use super::flip::{FlipMap, PIXELS_PER_DEGREE, flip};
use super::planes::{Planes, Weights};
use super::{psnr, ssim, ssim_and_ms_ssim};
use crate::error::Result;

/// The metrics of a pair of pictures that need no weights. `None` (JSON `null`) where a metric is not defined: see
/// [`super::SsimScores::valid`] and [`super::ms_ssim()`].
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize)]
pub struct Scores {
    /// PSNR, dB, at most [`crate::image::PSNR_CAP`].
    pub psnr: f64,
    /// SSIM, zeros outside the picture.
    pub ssim: f64,
    /// SSIM of windows inside the picture.
    pub ssim_valid: Option<f64>,
    /// MS-SSIM of five scales, data range 1; not defined by weights.
    pub ms_ssim: Option<f64>,
    /// LDR-FLIP at 67 pixels per degree.
    pub flip: f64,
}

/// Scores of a pair, with the map of FLIP.
///
/// # Errors
/// [`crate::Error::Usage`] for pictures of different sizes or weights of another size.
pub fn score(reference: &Planes, test: &Planes, weights: Option<&Weights>) -> Result<(Scores, FlipMap)> {
    let (similarity, ms_ssim) = match weights {
        None => ssim_and_ms_ssim(reference, test)?,
        Some(_) => (ssim(reference, test, weights)?, None),
    };
    let map = flip(reference, test, PIXELS_PER_DEGREE)?;
    let scores = Scores {
        psnr: psnr(reference, test, weights)?,
        ssim: similarity.zero_padded,
        ssim_valid: similarity.valid,
        ms_ssim,
        flip: map.mean(weights),
    };
    Ok((scores, map))
}

impl Scores {
    /// Mean of each metric over pictures; `None` where a picture has none. PSNR is the mean of the pictures' PSNR.
    pub fn mean(all: &[Self]) -> Option<Self> {
        Some(Self {
            psnr: mean_of(all.iter().map(|s| Some(s.psnr)))?,
            ssim: mean_of(all.iter().map(|s| Some(s.ssim)))?,
            ssim_valid: mean_of(all.iter().map(|s| s.ssim_valid)),
            ms_ssim: mean_of(all.iter().map(|s| s.ms_ssim)),
            flip: mean_of(all.iter().map(|s| Some(s.flip)))?,
        })
    }
}

/// Mean of values, `None` when one is absent or there is none.
pub fn mean_of(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    let all: Option<Vec<f64>> = values.collect();
    all.filter(|v| !v.is_empty()).map(|v| v.iter().sum::<f64>() / v.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mean_with_an_absent_value_is_absent() {
        assert_eq!(mean_of([Some(1.0), Some(2.0)].into_iter()), Some(1.5));
        assert_eq!(mean_of([Some(1.0), None].into_iter()), None);
        assert_eq!(mean_of(std::iter::empty()), None);
        assert_eq!(Scores::mean(&[]), None);
        let s = Scores { psnr: 30.0, ssim: 0.5, ssim_valid: None, ms_ssim: Some(0.7), flip: 0.1 };
        assert_eq!(Scores::mean(&[s, Scores { psnr: 20.0, ..s }]), Some(Scores { psnr: 25.0, ..s }));
    }
}
