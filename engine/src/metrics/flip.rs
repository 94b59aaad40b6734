//! LDR-FLIP: the difference that a person sees when two pictures are flipped at the same place.
//!
//! Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström, Fairchild: *FLIP: A Difference Evaluator for Alternating
//! Images*, HPG 2020. sRGB → YCxCz → contrast-sensitivity filters (section 4.1.1) → clamped linear RGB → L*a*b* with
//! Hunt's effect (4.1.2) → HyAB distance, remapped (4.1.3) = ΔE_c; edge and point differences of luminance (4.2) = ΔE_f;
//! ΔE = ΔE_c^(1 − ΔE_f) (4.3). All filters are products or sums of products of one-dimensional ones; edges are repeated.

mod color;
mod feature;
mod sensitivity;

use multiversion::multiversion;
use multiversion::target::target_cfg_f;
use rayon::prelude::*;

use super::planes::{Planes, Weights, same_size, weights_fit};
use crate::error::Result;
use feature::Features;
use sensitivity::Sensitivity;

/// Pixels per degree of the published viewing condition: 0.7 m from a screen of 3840 pixels on 0.7 m, 3840·π/180.
pub const PIXELS_PER_DEGREE: f64 = 3840.0 * std::f64::consts::PI / 180.0;

/// Exponent of the colour distance.
const Q_C: f32 = 0.7;
/// Share of the largest colour distance that is mapped to [`P_T`].
const P_C: f32 = 0.4;
/// Where that share is mapped to.
const P_T: f32 = 0.95;

/// FLIP of every pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct FlipMap {
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// `[height, width]`, 0 (no visible difference) to 1.
    pub error: Vec<f32>,
}

impl FlipMap {
    /// Mean over the pixels, or Σ w·e / Σ w.
    pub fn mean(&self, weights: Option<&Weights>) -> f64 {
        let errors = self.error.iter().map(|e| f64::from(*e));
        match weights {
            None => errors.sum::<f64>() / self.error.len().max(1) as f64,
            Some(w) => errors.zip(w.values()).map(|(e, w)| e * w).sum::<f64>() / w.total(),
        }
    }
}

/// LDR-FLIP at a viewing condition ([`PIXELS_PER_DEGREE`]).
///
/// # Errors
/// [`crate::Error::Usage`] for pictures of different sizes.
pub fn flip(reference: &Planes, test: &Planes, pixels_per_degree: f64) -> Result<FlipMap> {
    same_size(reference, test)?;
    let width = reference.width;
    let [reference, test] = [reference, test].map(color::opponent);
    let sensitivity = Sensitivity::new(pixels_per_degree);
    let features = Features::new(pixels_per_degree);
    let largest = color::largest_distance().powf(Q_C);
    let mut error = vec![0.0; reference[0].len()];
    error.par_chunks_exact_mut(width).enumerate().for_each_init(RowPair::default, |rows, (y, errors)| {
        for (i, planes) in [&reference, &test].into_iter().enumerate() {
            let out = (&mut rows.colour[i], &mut rows.feature[i]);
            row_of_picture(planes, width, y, (&sensitivity, &features), out);
        }
        errors.iter_mut().enumerate().for_each(|(x, e)| *e = rows.error(x, largest));
    });
    let height = error.len() / width;
    Ok(FlipMap { width, height, error })
}

/// [`flip`] of the usual viewing condition, mean over the pixels or by weight.
///
/// # Errors
/// [`crate::Error::Usage`] for pictures of different sizes or weights of another size.
pub fn mean_flip(reference: &Planes, test: &Planes, weights: Option<&Weights>) -> Result<f64> {
    weights_fit(reference, weights)?;
    Ok(flip(reference, test, PIXELS_PER_DEGREE)?.mean(weights))
}

/// One row of both pictures.
#[derive(Debug, Default)]
struct RowPair {
    /// L*a*b* as the eye sees it.
    colour: [Vec<[f32; 3]>; 2],
    /// Edge and point.
    feature: [Vec<[f32; 2]>; 2],
}

/// Row `y` of a picture as the eye sees it, and its features.
#[multiversion(targets("x86_64+avx2+fma"))]
fn row_of_picture(
    planes: &[Vec<f32>; 3],
    width: usize,
    y: usize,
    (sensitivity, features): (&Sensitivity, &Features),
    (colour, feature): (&mut Vec<[f32; 3]>, &mut Vec<[f32; 2]>),
) {
    if target_cfg_f!(target_feature = "fma") {
        sensitivity.row::<true>(planes, width, y, colour);
        features.row::<true>(&planes[0], width, y, feature);
    } else {
        sensitivity.row::<false>(planes, width, y, colour);
        features.row::<false>(&planes[0], width, y, feature);
    }
}

impl RowPair {
    /// ΔE of pixel `x`.
    fn error(&self, x: usize, largest: f32) -> f32 {
        let distance = color::hyab(self.colour[0][x], self.colour[1][x]);
        let colour = redistributed(distance.powf(Q_C), largest);
        let [p, q] = [self.feature[0][x], self.feature[1][x]];
        // q_f = 0.5.
        let feature = ((p[0] - q[0]).abs().max((p[1] - q[1]).abs()) * std::f32::consts::FRAC_1_SQRT_2).sqrt();
        colour.powf(1.0 - feature)
    }
}

/// Small distances get most of the range (section 4.1.3).
fn redistributed(distance: f32, largest: f32) -> f32 {
    let knee = P_C * largest;
    let value =
        if distance < knee { P_T / knee * distance } else { P_T + (distance - knee) / (largest - knee) * (1.0 - P_T) };
    value.clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    fn flat(rgb: [f64; 3]) -> Planes {
        Planes { width: 9, height: 7, rgb: rgb.map(|v| vec![v; 63]) }
    }

    #[test]
    fn equal_is_zero_and_opposite_is_one() {
        let grey = flat([0.3, 0.5, 0.7]);
        assert!(flip(&grey, &grey, PIXELS_PER_DEGREE).unwrap().error.iter().all(|e| *e == 0.0));
        // Green and blue are the farthest colours by definition of the remapping.
        let far = flip(&flat([0.0, 1.0, 0.0]), &flat([0.0, 0.0, 1.0]), PIXELS_PER_DEGREE).unwrap();
        assert!((far.mean(None) - 1.0).abs() < 1e-5, "{}", far.mean(None));
        let black_white = flip(&flat([0.0; 3]), &flat([1.0; 3]), PIXELS_PER_DEGREE).unwrap().mean(None);
        assert!(black_white > 0.9 && black_white < 1.0, "{black_white}");
    }

    #[test]
    fn the_map_is_symmetric_and_weights_choose() {
        let mut a = flat([0.2, 0.4, 0.1]);
        let b = flat([0.2, 0.4, 0.1]);
        a.rgb[1][31] = 1.0;
        let [m, n] = [flip(&a, &b, 20.0).unwrap(), flip(&b, &a, 20.0).unwrap()];
        assert_eq!(m, n);
        let weight = |at: usize| Weights::new((0..63).map(|i| f64::from(u8::from(i == at))).collect(), [9, 7]).unwrap();
        assert_eq!(m.mean(Some(&weight(31))), f64::from(m.error[31]));
        assert!(m.error[31] > m.error[0]);
        assert!(mean_flip(&a, &Planes { width: 7, height: 9, ..b }, None).is_err());
    }
}
