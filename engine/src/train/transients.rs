//! Transients: what a photo shows and the scene does not hold, like somebody who walks by, a hand before the lens, a reflection.
//!
//! Whether a pixel is one is said by the other photos: its error is compared with the error that the Gaussians which show there
//! leave in all photos ([`Evidence`]). Where something is hard to draw, or moves and is not learnt yet, both are large; where one
//! photo alone disagrees, its error is many times what is expected (`transient_pixels`). Such pixels take no part, as if a mask
//! left them out, until photos are looked at again: then all is compared anew, and what was found last is left out of the
//! evidence. (That residuals say who is an outlier: Sabour et al. 2023, RobustNeRF, by their quantile in a photo.)

use super::contribution::Contributions;
use super::evidence::{Evidence, errors};
use super::exposure::{EXPOSURE_WORDS, exposed_image};
use super::trainer::Trainer;
use crate::data::pixels::{LEFT_OUT, Pixels};
use crate::error::{Error, Result};
use crate::image::Image;
use crate::render::{RenderOptions, Renderer};
use crate::scene::Scene;

/// Errors are means over a square that reaches so far from its pixel, as a share of the photo's shorter side; at least a pixel.
const REACH: f64 = 0.01;
/// An error that is no transient, whatever was expected.
const FLOOR: f32 = 0.05;
/// What is joined to a transient is one too from this share of the bound on.
const JOINED: f32 = 0.75;
/// Photos that the evidence is of; of more, so many at equal distances.
const MOST_PHOTOS: usize = 100;
/// Words before a photo's bits in what checkpoints hold: its width and height.
const HEAD: usize = 2;

/// Which pixels of each photo are left out.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Transients {
    masks: Vec<Mask>,
}

/// Pixels of a photo as they were when it was looked at; of another size they are taken from the nearest.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
struct Mask {
    size: [u32; 2],
    left_out: Vec<bool>,
}

/// What was found when photos were looked at.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize)]
pub struct TransientsFound {
    /// Photos with pixels that are left out now.
    pub photos: usize,
    /// Share of all photos' pixels that is left out.
    pub share: f64,
}

impl Transients {
    /// Nothing of this many photos is left out.
    pub fn none(photos: usize) -> Self {
        Self { masks: vec![Mask::default(); photos] }
    }

    /// The pixels of a photo that are left out, `[H,W]` with its width and height; `None` where there are none.
    pub fn of_photo(&self, photo: usize) -> Option<([u32; 2], &[bool])> {
        let mask = self.masks.get(photo).filter(|m| m.left_out.contains(&true))?;
        Some((mask.size, &mask.left_out))
    }

    /// What is left out of them all.
    pub fn found(&self) -> TransientsFound {
        let share = |m: &Mask| m.left_out.iter().filter(|l| **l).count() as f64 / m.left_out.len().max(1) as f64;
        let shares: Vec<f64> = self.masks.iter().map(share).collect();
        let photos = shares.iter().filter(|s| **s > 0.0).count();
        TransientsFound { photos, share: shares.iter().sum::<f64>() / shares.len().max(1) as f64 }
    }

    /// Leaves the pixels of `photo` out.
    pub(super) fn apply(&self, photo: usize, pixels: &mut Pixels) {
        let [width, height] = [pixels.width, pixels.height];
        for i in self.pixels_of(photo, [width, height]) {
            pixels.rgba[i] = LEFT_OUT;
        }
    }

    /// Places `y·W + x` of the pixels of `photo` that are left out where it has this width and height.
    fn pixels_of(&self, photo: usize, [width, height]: [u32; 2]) -> impl Iterator<Item = usize> {
        let mask = self.of_photo(photo);
        let at = |k: u32, own: u32, length: u32| (u64::from(k) * u64::from(own) / u64::from(length.max(1))) as usize;
        (0..height).flat_map(move |y| (0..width).map(move |x| (x, y))).filter_map(move |(x, y)| {
            let (size, left_out) = mask?;
            let own = at(y, size[1], height) * size[0] as usize + at(x, size[0], width);
            left_out[own].then_some(y as usize * width as usize + x as usize)
        })
    }

    /// Width, height and bits, photo by photo.
    pub fn words(&self) -> Vec<u32> {
        let bits = |chunk: &[bool]| chunk.iter().enumerate().fold(0, |word, (k, bit)| word | u32::from(*bit) << k);
        let of = |m: &Mask| m.size.into_iter().chain(m.left_out.chunks(32).map(bits)).collect::<Vec<u32>>();
        self.masks.iter().flat_map(of).collect()
    }

    /// What [`Transients::words`] gave, of so many photos.
    ///
    /// # Errors
    /// `Usage` for words of other photos.
    pub fn from_words(words: &[u32], photos: usize) -> Result<Self> {
        let wrong =
            || Error::usage("transients", format!("{} words", words.len()), format!("those of {photos} photos"));
        let mut rest = words;
        let mut masks = Vec::with_capacity(photos);
        for _ in 0..photos {
            let size: [u32; HEAD] = rest.first_chunk().copied().ok_or_else(wrong)?;
            let pixels = size[0] as usize * size[1] as usize;
            let bits = rest.get(HEAD..HEAD + pixels.div_ceil(32)).ok_or_else(wrong)?;
            let left_out = (0..pixels).map(|i| bits[i / 32] >> (i % 32) & 1 == 1).collect();
            masks.push(Mask { size, left_out });
            rest = &rest[HEAD + pixels.div_ceil(32)..];
        }
        if rest.is_empty() { Ok(Self { masks }) } else { Err(wrong()) }
    }
}

impl Trainer {
    /// Looks at all photos and says anew which of their pixels are transients.
    pub(super) fn mark_transients(&mut self, iteration: u64) -> Result<()> {
        // What a step needs besides is made again: its memory is wanted here.
        self.targets.clear();
        let before = self.transients.take().unwrap_or_default();
        let marked = self.transients_of(iteration, &before);
        self.transients = Some(match marked {
            // They stay as they are where there is no room to look.
            Err(Error::OutOfMemory { .. } | Error::Limit { .. }) => before,
            other => {
                let marked = other?;
                self.transients_found = Some(marked.found());
                marked
            }
        });
        self.photos.forget();
        Ok(())
    }

    fn transients_of(&self, iteration: u64, before: &Transients) -> Result<Transients> {
        let places = self.pyramid.places(iteration);
        let scene = self.scene_of_photos(places.clone().map(|place| self.pyramid.views[place].time))?;
        let (background, near) = (self.config.background, self.config.near);
        let options = RenderOptions { background, near, ..RenderOptions::default() };
        let exposures = self.exposures()?;
        let mut renderer = Renderer::new(&self.gpu, &scene, &options)?;
        let mut look = |place: usize| self.errors_of(&mut renderer, place, exposures.as_deref());
        let evidence = self.evidence(&scene, &options, places.clone(), before, &mut look)?;
        let (scene, options) = evidence.scene(&scene, &options)?;
        let mut expected = Renderer::new(&self.gpu, &scene, &options)?;
        let mut masks = Vec::with_capacity(places.len());
        for place in places {
            let camera = &self.pyramid.views[place].camera;
            let (_, errors) = look(place)?;
            let image = expected.render(camera, self.pyramid.views[place].time)?;
            let expected: Vec<f32> = image.rgba.chunks_exact(4).map(|p| p[0].clamp(0.0, 1.0)).collect();
            let size = [camera.width, camera.height];
            let left_out = transient_pixels(&errors, &expected, size, self.config.loss.transients);
            masks.push(Mask { size, left_out });
        }
        Ok(Transients { masks })
    }

    /// What photos say of each Gaussian, without the pixels that were left out before.
    fn evidence(
        &self,
        scene: &Scene,
        options: &RenderOptions,
        places: std::ops::Range<usize>,
        before: &Transients,
        look: &mut impl FnMut(usize) -> Result<(Image, Vec<f32>)>,
    ) -> Result<Evidence> {
        let mut evidence = Evidence::new(scene.gaussians.len());
        let mut of = Contributions::new(&self.gpu, scene, options)?;
        let step = places.len().div_ceil(MOST_PHOTOS).max(1);
        for place in places.step_by(step) {
            let view = &self.pyramid.views[place];
            let (rendered, errors) = look(place)?;
            let mut errors: Vec<Option<f32>> = errors.into_iter().map(Some).collect();
            for i in before.pixels_of(self.pyramid.photo(place), [rendered.width, rendered.height]) {
                errors[i] = None;
            }
            evidence.add_errors(&mut of, &view.camera, view.time, &rendered, &errors)?;
        }
        Ok(evidence)
    }

    /// What is rendered at a place, exposed as its photo was, and its errors; 0 where a mask of the data set leaves pixels out.
    pub(super) fn errors_of(
        &self,
        renderer: &mut Renderer,
        place: usize,
        exposures: Option<&[f32]>,
    ) -> Result<(Image, Vec<f32>)> {
        let view = &self.pyramid.views[place];
        let photo = self.loader.get(place)?;
        let mut rendered = renderer.render(&view.camera, view.time)?;
        let row =
            |rows: &'_ [f32]| rows.chunks_exact(EXPOSURE_WORDS).nth(self.pyramid.photo(place)).map(<[f32]>::to_vec);
        if let Some(row) = exposures.and_then(row) {
            exposed_image(&row, &mut rendered);
        }
        let mut errors = errors(&rendered, &photo.over(self.config.background));
        for (error, pixel) in errors.iter_mut().zip(&photo.rgba) {
            *error = if *pixel == LEFT_OUT { 0.0 } else { *error };
        }
        Ok((rendered, errors))
    }
}

/// Which pixels are transients: around them the mean error is more than `factor` times the mean of what is expected there, and
/// a little more; with all that is joined to them and beyond three quarters of that. What they reach takes no part either, for edges of
/// transients are blurred. All of `[H,W]`.
fn transient_pixels(errors: &[f32], expected: &[f32], size: [u32; 2], factor: f32) -> Vec<bool> {
    let reach = (REACH * f64::from(size[0].min(size[1]))).round().max(1.0) as usize;
    let [error, expected] = [errors, expected].map(|values| means(values, size, reach));
    let excess: Vec<f32> = error.iter().zip(&expected).map(|(e, x)| e / (factor * x + FLOOR)).collect();
    let outliers: Vec<f32> = joined(&excess, size).into_iter().map(|o| f32::from(u8::from(o))).collect();
    means(&outliers, size, reach).iter().map(|m| *m > 0.0).collect()
}

/// Pixels above 1, and those above [`JOINED`] that a chain of such pixels joins to them.
fn joined(excess: &[f32], [width, height]: [u32; 2]) -> Vec<bool> {
    let (width, height) = (width as usize, height as usize);
    let mut found: Vec<bool> = excess.iter().map(|e| *e > 1.0).collect();
    let mut open: Vec<usize> = (0..found.len()).filter(|&i| found[i]).collect();
    while let Some(i) = open.pop() {
        let (x, y) = (i % width, i / width);
        let beside = [(x > 0).then(|| i - 1), (x + 1 < width).then_some(i + 1)];
        let above = [(y > 0).then(|| i - width), (y + 1 < height).then_some(i + width)];
        for near in beside.into_iter().chain(above).flatten() {
            if !found[near] && excess[near] > JOINED {
                found[near] = true;
                open.push(near);
            }
        }
    }
    found
}

/// Means over squares of `2·reach + 1` pixels, of which those inside the image count.
fn means(values: &[f32], [width, height]: [u32; 2], reach: usize) -> Vec<f32> {
    let (width, height) = (width as usize, height as usize);
    let line = |at: &dyn Fn(usize) -> f32, length: usize| -> Vec<f32> {
        let window = |k: usize| k.saturating_sub(reach)..(k + reach + 1).min(length);
        (0..length).map(|k| window(k).map(at).sum::<f32>() / window(k).len() as f32).collect()
    };
    let rows: Vec<f32> = values.chunks(width.max(1)).flat_map(|row| line(&|k| row[k], width)).collect();
    let mut out = vec![0.0; rows.len()];
    for x in 0..width {
        for (y, mean) in line(&|k| rows[k * width + x], height).into_iter().enumerate() {
            out[y * width + x] = mean;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    const SIZE: [u32; 2] = [40, 30];

    /// Errors of 0.02 with a noisy square that is expected, and one of 6×6 pixels at (20, 10) that is not.
    fn image() -> [Vec<f32>; 2] {
        let value = |square: bool, i: u32| {
            let (x, y) = (i % SIZE[0], i / SIZE[0]);
            let hard = x < 10 && y < 10;
            let found = square && (20..26).contains(&x) && (10..16).contains(&y);
            if hard || found { 0.3 } else { 0.02 }
        };
        [true, false].map(|square| (0..SIZE[0] * SIZE[1]).map(|i| value(square, i)).collect())
    }

    #[test]
    fn what_is_not_expected_is_left_out_with_what_it_reaches() {
        let [errors, expected] = image();
        let found = transient_pixels(&errors, &expected, SIZE, 3.0);
        let at = |x: usize, y: usize| found[y * SIZE[0] as usize + x];
        assert!(at(20, 10) && at(25, 15) && at(22, 12) && at(19, 12));
        assert!(!at(5, 5) && !at(16, 12) && !at(30, 12) && !at(9, 9) && !at(39, 29));
        let none = transient_pixels(&expected, &expected, SIZE, 3.0);
        assert!(!none.contains(&true));
        // Small errors are none, however small the expected ones.
        assert!(!transient_pixels(&vec![0.04; 1200], &vec![0.0; 1200], SIZE, 3.0).contains(&true));
    }

    #[test]
    fn a_single_pixel_is_no_transient() {
        let [_, expected] = image();
        let mut errors = expected.clone();
        errors[15 * 40 + 30] = 0.8;
        let found = transient_pixels(&errors, &expected, SIZE, 3.0);
        assert_eq!(found.iter().filter(|f| **f).count(), 0);
    }

    #[test]
    fn means_count_what_is_inside() {
        let values = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        assert_eq!(means(&values, [3, 2], 1), [3.0, 3.5, 4.0, 3.0, 3.5, 4.0]);
        assert_eq!(means(&values, [3, 2], 0), values);
    }

    #[test]
    fn masks_are_kept_in_words() {
        let [errors, expected] = image();
        let left_out = transient_pixels(&errors, &expected, SIZE, 3.0);
        let all = Transients { masks: vec![Mask::default(), Mask { size: SIZE, left_out }] };
        let words = all.words();
        assert_eq!(Transients::from_words(&words, 2).unwrap(), all);
        for (cut, photos) in [(words.len() - 1, 2), (words.len(), 1), (words.len(), 3), (1, 2)] {
            assert!(Transients::from_words(&words[..cut], photos).is_err());
        }
        let found = all.found();
        assert!(found.photos == 1 && found.share > 0.01 && found.share < 0.05, "{found:?}");
        assert!(all.of_photo(0).is_none() && all.of_photo(2).is_none() && all.of_photo(1).is_some());
    }

    #[test]
    fn pixels_of_other_sizes_are_left_out_alike() {
        let [errors, expected] = image();
        let left_out = transient_pixels(&errors, &expected, SIZE, 3.0);
        let all = Transients { masks: vec![Mask { size: SIZE, left_out: left_out.clone() }] };
        let mut own = Pixels { width: 40, height: 30, rgba: vec![u32::MAX; 1200] };
        let mut large = Pixels { width: 80, height: 60, rgba: vec![u32::MAX; 4800] };
        all.apply(0, &mut own);
        all.apply(0, &mut large);
        for (i, pixel) in large.rgba.iter().enumerate() {
            let of = left_out[i / 160 * 40 + i % 80 / 2];
            assert_eq!(*pixel == LEFT_OUT, of);
        }
        assert_eq!(own.rgba.iter().map(|p| *p == LEFT_OUT).collect::<Vec<_>>(), left_out);
    }
}
