//! Pictures as metrics read them: one plane per channel, values in [0, 1].

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::file::picture::to_u8;
use crate::image::Image;

/// R, G, B planes of a picture, each `[height, width]`, values in [0, 1].
#[derive(Debug, Clone, PartialEq)]
pub struct Planes {
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// R, G, B.
    pub rgb: [Vec<f64>; 3],
}

impl Planes {
    /// Float values clamped to [0, 1]; A is left out.
    ///
    /// # Errors
    /// [`Error::NonFinite`] for a value that is NaN or infinite, with its index in `[height, width, 4]`;
    /// [`Error::Usage`] for an image without pixels or with the wrong number of values.
    pub fn clamped(image: &Image) -> Result<Self> {
        // An f32 that is the nearest to k / 255 came from an 8-bit picture: it is taken as k / 255 itself.
        let exact = |v: f32| {
            let k = f32::from((v * 255.0 + 0.5) as u8);
            if k / 255.0 == v { f64::from(k) / 255.0 } else { f64::from(v) }
        };
        Self::convert(image, |v| exact(v.clamp(0.0, 1.0)))
    }

    /// The values of the 8-bit picture: clamped, rounded to the nearest k, then k / 255 in f64.
    ///
    /// # Errors
    /// As [`Planes::clamped`].
    pub fn quantised(image: &Image) -> Result<Self> {
        Self::convert(image, |v| f64::from(to_u8(v)) / 255.0)
    }

    fn convert(image: &Image, value: impl Fn(f32) -> f64 + Sync) -> Result<Self> {
        let (width, height) = (image.width as usize, image.height as usize);
        if width * height == 0 || image.rgba.len() != 4 * width * height {
            let found = format!("{width} x {height} pixels with {} values", image.rgba.len());
            return Err(Error::usage("image to measure", found, "at least one pixel, four values for each"));
        }
        if let Some(index) = first_bad(image) {
            let value = image.rgba[index].to_string();
            return Err(Error::NonFinite { what: "image value".into(), index, value });
        }
        let mut rgb: [Vec<f64>; 3] = std::array::from_fn(|_| vec![0.0; width * height]);
        let [r, g, b] = rgb.each_mut().map(|plane| plane.par_chunks_mut(width));
        let rows = image.rgba.par_chunks_exact(4 * width);
        rows.zip(r.zip(g).zip(b)).for_each(|(row, ((r, g), b))| {
            for (i, pixel) in row.as_chunks::<4>().0.iter().enumerate() {
                (r[i], g[i], b[i]) = (value(pixel[0]), value(pixel[1]), value(pixel[2]));
            }
        });
        Ok(Self { width, height, rgb })
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.width * self.height
    }
}

/// Index in `[height, width, 4]` of the first R, G or B that is NaN or infinite.
fn first_bad(image: &Image) -> Option<usize> {
    let bad = |pixel: &[f32; 4]| pixel[..3].iter().any(|v| !v.is_finite());
    let first = image.rgba.as_chunks().0.par_iter().with_min_len(4096).position_first(bad)?;
    image.rgba[4 * first..].iter().position(|v| !v.is_finite()).map(|i| 4 * first + i)
}

/// Weight of each pixel, `[height, width]`, in [0, 1]: a mask. A metric with weights is Σ w·m / Σ w of its per-pixel map
/// m (for PSNR, of the squared error), so that a mask of ones gives the metric itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Weights {
    values: Vec<f64>,
    total: f64,
}

impl Weights {
    /// From a mask of 8-bit values: 255 counts, 0 does not, values between in proportion.
    ///
    /// # Errors
    /// [`Error::Usage`] when it has not one value per pixel or none that counts.
    pub fn from_mask(mask: &[u8], size: [usize; 2]) -> Result<Self> {
        Self::new(mask.iter().map(|m| f64::from(*m) / 255.0).collect(), size)
    }

    /// From weights in [0, 1].
    ///
    /// # Errors
    /// As [`Weights::from_mask`].
    pub fn new(values: Vec<f64>, [width, height]: [usize; 2]) -> Result<Self> {
        let total = values.iter().sum::<f64>();
        if values.len() == width * height && total > 0.0 && values.iter().all(|w| (0.0..=1.0).contains(w)) {
            return Ok(Self { values, total });
        }
        let found = format!("{} values with a sum of {total}", values.len());
        Err(Error::usage("mask", found, format!("{} values from 0 to 1, not all 0", width * height)))
    }

    /// `[height, width]`.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Σ w.
    pub fn total(&self) -> f64 {
        self.total
    }
}

/// The two pictures have the same size.
pub(super) fn same_size(reference: &Planes, test: &Planes) -> Result<()> {
    if [reference.width, reference.height] == [test.width, test.height] {
        return Ok(());
    }
    let size = |p: &Planes| format!("{} x {} pixels", p.width, p.height);
    Err(Error::usage("image to compare", size(test), format!("{} of the reference", size(reference))))
}

/// Weights fit the picture.
pub(super) fn weights_fit(planes: &Planes, weights: Option<&Weights>) -> Result<()> {
    match weights {
        Some(w) if w.values.len() != planes.pixels() => {
            Err(Error::usage("mask", format!("{} values", w.values.len()), format!("{} pixels", planes.pixels())))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    fn image(rgba: Vec<f32>) -> Image {
        Image { width: rgba.len() as u32 / 4, height: 1, rgba, depth: Vec::new() }
    }

    #[test]
    fn values_are_clamped_and_rounded_like_a_png() {
        let i = image(vec![-1.0, 0.5, 2.0, f32::NAN]);
        assert_eq!(Planes::clamped(&i).unwrap().rgb, [vec![0.0], vec![0.5], vec![1.0]]);
        assert_eq!(Planes::quantised(&i).unwrap().rgb, [vec![0.0], vec![128.0 / 255.0], vec![1.0]]);
    }

    #[test]
    fn bad_values_and_sizes_are_refused() {
        for (channel, value) in [(0, f32::NAN), (2, f32::INFINITY)] {
            let mut rgba = vec![0.5; 8];
            rgba[4 + channel] = value;
            let error = Planes::clamped(&image(rgba)).unwrap_err();
            assert!(matches!(error, Error::NonFinite { index, .. } if index == 4 + channel));
        }
        assert!(Planes::clamped(&Image { width: 2, height: 2, rgba: vec![0.0; 4], depth: vec![] }).is_err());
        assert!(Planes::clamped(&Image::default()).is_err());
    }

    #[test]
    fn masks_must_fit_and_count_something() {
        assert_eq!(Weights::from_mask(&[0, 255, 51], [3, 1]).unwrap().total(), 1.2);
        assert!(Weights::from_mask(&[0, 0], [2, 1]).is_err());
        assert!(Weights::from_mask(&[255], [2, 1]).is_err());
        assert!(Weights::new(vec![1.5], [1, 1]).is_err());
    }
}
