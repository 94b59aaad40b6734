//! Peak signal-to-noise ratio: −10 log₁₀ MSE, MSE over all pixels and R, G, B, peak 1.

use rayon::prelude::*;

use super::planes::{Planes, Weights, same_size, weights_fit};
use crate::error::Result;
use crate::image::{Image, PSNR_CAP};

/// PSNR in dB, at most [`PSNR_CAP`] (equal pictures). With weights, MSE is Σ w·d² / (3 Σ w).
///
/// # Errors
/// [`crate::Error::Usage`] for pictures of different sizes or weights of another size.
pub fn psnr(reference: &Planes, test: &Planes, weights: Option<&Weights>) -> Result<f64> {
    same_size(reference, test)?;
    weights_fit(reference, weights)?;
    let rows: Vec<f64> = (0..reference.height)
        .into_par_iter()
        .map(|y| row_error(reference, test, weights, y * reference.width..(y + 1) * reference.width))
        .collect();
    let count = weights.map_or(reference.pixels() as f64, Weights::total);
    let mse = rows.iter().sum::<f64>() / (3.0 * count);
    Ok((-10.0 * mse.log10()).clamp(-PSNR_CAP, PSNR_CAP))
}

/// PSNR of the 8-bit pictures that the two images are written as.
///
/// # Errors
/// Those of [`Planes::quantised`] and [`psnr`].
pub fn psnr_8bit(reference: &Image, test: &Image) -> Result<f64> {
    psnr(&Planes::quantised(reference)?, &Planes::quantised(test)?, None)
}

fn row_error(reference: &Planes, test: &Planes, weights: Option<&Weights>, row: std::ops::Range<usize>) -> f64 {
    let mut sum = 0.0;
    for (a, b) in reference.rgb.iter().zip(&test.rgb) {
        let squares = a[row.clone()].iter().zip(&b[row.clone()]).map(|(a, b)| (a - b) * (a - b));
        sum += match weights {
            None => squares.sum::<f64>(),
            Some(w) => squares.zip(&w.values()[row.clone()]).map(|(e, w)| e * w).sum(),
        };
    }
    sum
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    fn grey(values: &[f64]) -> Planes {
        Planes { width: values.len(), height: 1, rgb: std::array::from_fn(|_| values.to_vec()) }
    }

    #[test]
    fn known_values() {
        let (a, b) = (grey(&[0.0, 0.5]), grey(&[0.1, 0.5]));
        assert!((psnr(&a, &b, None).unwrap() - 10.0 * 200.0_f64.log10()).abs() < 1e-9);
        assert_eq!(psnr(&a, &a, None).unwrap(), PSNR_CAP);
        let mask = Weights::new(vec![1.0, 0.0], [2, 1]).unwrap();
        assert!((psnr(&a, &b, Some(&mask)).unwrap() - 20.0).abs() < 1e-9);
        assert!(psnr(&a, &grey(&[0.0]), None).is_err());
    }

    #[test]
    fn eight_bits_round_first() {
        let image = |v: f32| Image { width: 1, height: 1, rgba: vec![v, v, v, 1.0], depth: vec![] };
        assert_eq!(psnr_8bit(&image(0.5), &image(0.5004)).unwrap(), PSNR_CAP);
        let one_step = psnr_8bit(&image(0.0), &image(1.2 / 255.0)).unwrap();
        assert!((one_step - 20.0 * 255.0_f64.log10()).abs() < 1e-9);
    }
}
