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

impl Image {
    /// R, G, B of every pixel, without A: the values that [`difference`] compares.
    pub fn rgb(&self) -> impl Iterator<Item = f64> {
        self.rgba.chunks_exact(4).flat_map(|pixel| [pixel[0], pixel[1], pixel[2]]).map(f64::from)
    }

    /// The same picture in another size, bilinearly: pixel centres (i + 0.5) keep their place, the outermost pixels are
    /// continued beyond their centres.
    #[must_use]
    pub fn enlarged(&self, size: [u32; 2]) -> Self {
        let [width, height] = size;
        let (columns, rows) = (taps(self.width, width), taps(self.height, height));
        let plane = |from: &[f32], channels: usize| -> Vec<f32> {
            if from.is_empty() {
                return Vec::new();
            }
            let at = |x: usize, y: usize, c: usize| from[(y * self.width as usize + x) * channels + c];
            let mut out = Vec::with_capacity(rows.len() * columns.len() * channels);
            for &(y0, y1, v) in &rows {
                for &(x0, x1, u) in &columns {
                    out.extend((0..channels).map(|c| {
                        let top = at(x0, y0, c) * (1.0 - u) + at(x1, y0, c) * u;
                        let bottom = at(x0, y1, c) * (1.0 - u) + at(x1, y1, c) * u;
                        top * (1.0 - v) + bottom * v
                    }));
                }
            }
            out
        };
        Self { width, height, rgba: plane(&self.rgba, 4), depth: plane(&self.depth, 1) }
    }
}

/// For each of `to` pixels the two of `from` pixels that it lies between, and its weight of the second.
fn taps(from: u32, to: u32) -> Vec<(usize, usize, f32)> {
    let last = f64::from(from.max(1) - 1);
    let place = |i: u32| ((f64::from(i) + 0.5) * f64::from(from) / f64::from(to) - 0.5).clamp(0.0, last);
    (0..to)
        .map(|i| {
            let at = place(i);
            (at.floor() as usize, at.ceil() as usize, at.fract() as f32)
        })
        .collect()
}

/// PSNR reported for equal images, and the bound of every PSNR, dB: JSON has no infinity.
pub const PSNR_CAP: f64 = 300.0;

/// How far a test image is from the reference. All fields are finite.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Difference {
    /// Peak signal-to-noise ratio over R, G, B with peak 1, dB, held within ±[`PSNR_CAP`].
    pub psnr: f64,
    /// Largest absolute difference; `f64::MAX` where a value is NaN, infinite or missing.
    pub max: f64,
    /// 99.9 % quantile of the absolute differences.
    pub q999: f64,
    /// Fraction of values within 1e-3.
    pub within_1e3: f64,
}

/// Compares two lists of values. A value that is NaN or missing (lists of unequal length) on either side counts as the
/// largest difference there is.
pub fn difference(reference: impl IntoIterator<Item = f64>, test: impl IntoIterator<Item = f64>) -> Difference {
    let mut errors = absolute_errors(reference.into_iter(), test.into_iter());
    if errors.is_empty() {
        return Difference { psnr: PSNR_CAP, max: 0.0, q999: 0.0, within_1e3: 1.0 };
    }
    let count = errors.len() as f64;
    let mse = errors.iter().map(|e| e * e).sum::<f64>() / count;
    let within = errors.iter().filter(|&&e| e <= 1.0e-3).count() as f64 / count;
    errors.sort_unstable_by(f64::total_cmp);
    let rank = ((0.999 * count).ceil() as usize).clamp(1, errors.len());
    Difference {
        psnr: (-10.0 * mse.log10()).clamp(-PSNR_CAP, PSNR_CAP),
        max: errors[errors.len() - 1],
        q999: errors[rank - 1],
        within_1e3: within,
    }
}

fn absolute_errors(mut reference: impl Iterator<Item = f64>, mut test: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut errors = Vec::new();
    loop {
        match (reference.next(), test.next()) {
            (None, None) => return errors,
            (Some(a), Some(b)) => {
                let e = (a - b).abs();
                errors.push(if e.is_finite() { e } else { f64::MAX });
            }
            _ => errors.push(f64::MAX),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn difference_of_known_lists() {
        let d = difference([0.0, 0.5, 1.0, 1.0], [0.0, 0.5, 0.9, 1.0]);
        assert!((d.psnr - 10.0 * (4.0f64 / 0.01).log10()).abs() < 1.0e-9);
        assert!((d.max - 0.1).abs() < 1.0e-15 && (d.q999 - 0.1).abs() < 1.0e-15);
        assert_eq!(d.within_1e3, 0.75);
        assert_eq!(difference([1.0], [1.0]).psnr, PSNR_CAP);
    }

    #[test]
    fn bad_or_missing_values_are_the_largest_difference() {
        for d in [difference([f64::NAN, 0.0], [0.0, 0.0]), difference([0.0, 0.0], [0.0]), difference([], [f64::NAN])] {
            assert_eq!((d.psnr, d.max), (-PSNR_CAP, f64::MAX));
            assert!(d.within_1e3 < 1.0);
        }
    }

    #[test]
    fn rgb_leaves_alpha_out() {
        let image = Image { width: 1, height: 2, rgba: vec![1.0, 2.0, 3.0, 9.0, 4.0, 5.0, 6.0, 9.0], depth: vec![] };
        assert_eq!(image.rgb().collect::<Vec<_>>(), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    }

    #[test]
    fn enlarging_keeps_places_and_ramps() {
        let ramp = |n: u32| -> Vec<f32> { (0..n).flat_map(|i| [(i as f32 + 0.5) / n as f32; 4]).collect() };
        let small = Image { width: 4, height: 1, rgba: ramp(4), depth: vec![0.5; 4] };
        let large = small.enlarged([16, 3]);
        assert_eq!((large.width, large.height, large.rgba.len(), large.depth.len()), (16, 3, 192, 48));
        let truth = ramp(16);
        for (i, value) in large.rgba.iter().enumerate() {
            let inside = (2..14).contains(&(i / 4 % 16));
            assert!(!inside || (value - truth[i % 64]).abs() < 1e-6, "{i}: {value}");
        }
        assert!(large.depth.iter().all(|d| *d == 0.5));
        assert_eq!(small.enlarged([4, 1]), small);
    }
}
