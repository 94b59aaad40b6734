//! Float images as the renderer and the f64 reference produce them, and their comparison.

/// A rendered image in scene-referred float values (no gamma), row-major, top row first.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Image {
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// `[height, width, 4]`: R, G, B = Σ + T·background; A = 1 − T.
    pub rgba: Vec<f32>,
    /// `[height, width]`: Σ z·α·T, camera-space depth weighted like colour (not normalised); empty when not asked for.
    pub depth: Vec<f32>,
}

/// How far a test image is from the reference.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Difference {
    /// Peak signal-to-noise ratio over R, G, B with peak 1, dB; infinite for equal images.
    pub psnr: f64,
    /// Largest absolute difference.
    pub max: f64,
    /// 99.9 % quantile of the absolute differences.
    pub q999: f64,
    /// Fraction of values within 1e-3.
    pub within_1e3: f64,
}

/// Compares two equally long lists of values; a NaN on either side counts as an infinite difference.
pub fn difference(reference: impl IntoIterator<Item = f64>, test: impl IntoIterator<Item = f64>) -> Difference {
    let mut errors: Vec<f64> = reference
        .into_iter()
        .zip(test)
        .map(|(a, b)| {
            let e = (a - b).abs();
            if e.is_nan() { f64::INFINITY } else { e }
        })
        .collect();
    if errors.is_empty() {
        return Difference { psnr: f64::INFINITY, max: 0.0, q999: 0.0, within_1e3: 1.0 };
    }
    let count = errors.len() as f64;
    let mse = errors.iter().map(|e| e * e).sum::<f64>() / count;
    let within = errors.iter().filter(|&&e| e <= 1.0e-3).count() as f64 / count;
    errors.sort_unstable_by(f64::total_cmp);
    let rank = ((0.999 * count).ceil() as usize).clamp(1, errors.len());
    Difference { psnr: -10.0 * mse.log10(), max: errors[errors.len() - 1], q999: errors[rank - 1], within_1e3: within }
}
