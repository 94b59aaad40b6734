//! Coarse to fine: a run begins on small photos and ends on full ones.
//!
//! A Gaussian feels only the pixels that it covers. In a small photo things have moved by fewer pixels, so that what has moved
//! far is found; and steps cost less.

use std::sync::Arc;

use crate::data::dataset::View;
use crate::data::loader::ImageLoader;

/// Opaque pixels that photos keep on average: of an object that has fewer, limbs cannot be told from each other.
const SMALLEST_AREA: f64 = 64.0;
/// Photos that this is measured on.
const MEASURED: usize = 32;
/// Bytes of photos that wait to be measured.
const BUDGET: u64 = 1 << 20;

/// No photo is made smaller than this on its shorter side, pixels.
const SMALLEST_SIDE: u32 = 24;
/// Halvings of a photo of 16,384 pixels that leave [`SMALLEST_SIDE`].
const MOST_LEVELS: u32 = 9;

/// The photos of a run, at full size and halved again and again.
#[derive(Debug, Clone)]
pub(super) struct Pyramid {
    /// All sizes, the full one first.
    pub(super) views: Arc<[View]>,
    /// Photos of one size.
    photos: usize,
    /// Iterations until photos are full; 0: they always are.
    iterations: u64,
}

impl Pyramid {
    /// Of these photos, which are full after `iterations`. `area`: opaque pixels of such photos, on average.
    pub(super) fn new(views: &Arc<[View]>, iterations: u64, area: impl FnOnce(&[View]) -> f64) -> Self {
        let smallest = views.iter().map(|v| v.camera.width.min(v.camera.height)).min().unwrap_or(0);
        let halvings = (1..=MOST_LEVELS).take_while(|k| smallest >> k >= SMALLEST_SIDE);
        let mut levels: Vec<u32> = halvings.take_while(|_| iterations > 0).collect();
        if let Some(&most) = levels.last() {
            let reduced: Vec<View> = measured(views).map(|v| v.reduced(1 << most)).collect();
            let area = area(&reduced);
            levels.retain(|k| area * 4_f64.powi((most - k) as i32) >= SMALLEST_AREA);
        }
        if levels.is_empty() {
            return Self { views: views.clone(), photos: views.len(), iterations: 0 };
        }
        let smaller = levels.iter().flat_map(|&k| views.iter().map(move |v| v.reduced(1 << k)));
        Self { photos: views.len(), iterations, views: views.iter().cloned().chain(smaller).collect() }
    }

    /// Photos at full size.
    pub(super) fn full(&self) -> &[View] {
        &self.views[..self.photos]
    }

    /// Place in `views` of a photo as it is at `iteration` (from 1).
    pub(super) fn at(&self, photo: usize, iteration: u64) -> usize {
        photo + self.photos * self.halvings(iteration) as usize
    }

    /// How often photos are halved at `iteration` (from 1). Every size has the same number of iterations.
    pub(super) fn halvings(&self, iteration: u64) -> u32 {
        let levels = (self.views.len() / self.photos.max(1)).saturating_sub(1) as u64;
        let left = (self.iterations + 1).saturating_sub(iteration);
        (left * levels).div_ceil(self.iterations.max(1)) as u32
    }

    /// Places of the photos at the smallest size whose shorter side has this many pixels; the full ones where none has.
    pub(super) fn smallest(&self, side: u32) -> std::ops::Range<usize> {
        let sizes = self.views.chunks(self.photos.max(1));
        let large = sizes.take_while(|views| views.iter().all(|v| v.camera.width.min(v.camera.height) >= side));
        let first = self.photos * large.count().saturating_sub(1);
        first..first + self.photos
    }

    /// Which photo a place in `views` is.
    pub(super) fn photo(&self, place: usize) -> usize {
        place % self.photos.max(1)
    }

    /// Places of the photos as they are at `iteration`.
    pub(super) fn places(&self, iteration: u64) -> std::ops::Range<usize> {
        let first = self.at(0, iteration);
        first..first + self.photos
    }
}

fn measured(views: &[View]) -> impl Iterator<Item = &View> {
    views.iter().step_by(views.len().div_ceil(MEASURED).max(1))
}

/// Opaque pixels of these photos, on average. One that cannot be read counts as opaque: the step that needs it says so.
pub(super) fn opaque_area(views: &[View], workers: usize) -> f64 {
    let all: Arc<[View]> = views.to_vec().into();
    let Ok(loader) = ImageLoader::for_training(all, BUDGET, workers) else { return f64::INFINITY };
    loader.prefetch(&(0..views.len()).collect::<Vec<_>>());
    let opaque = |place: usize| {
        let photo = loader.get(place).ok()?;
        Some(photo.rgba.iter().map(|p| f64::from(p.to_le_bytes()[3]) / 255.0).sum::<f64>())
    };
    let sum: f64 = (0..views.len()).map(|place| opaque(place).unwrap_or(f64::INFINITY)).sum();
    sum / views.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::data::pixels::ImageSource;
    use crate::scene::Camera;
    use glam::DVec3;

    fn views(size: [u32; 2]) -> Arc<[View]> {
        let camera = Camera::look_at(DVec3::new(0.0, 0.0, 4.0), DVec3::ZERO, DVec3::Y, 0.8, size);
        let image = ImageSource { path: "a.png".into(), stored: size, size, lens: None, mask: None, used: None };
        vec![View { name: "a".into(), camera, time: 0.0, image }; 3].into()
    }

    #[test]
    fn the_smallest_photos_of_a_size_are_found() {
        let p = Pyramid::new(&views([200, 120]), 100, |_| 1e3);
        let side = |side: u32| p.views[p.smallest(side).start].image.size;
        assert_eq!([side(24), side(31), side(61), side(500)], [[50, 30], [100, 60], [200, 120], [200, 120]]);
        assert_eq!(Pyramid::new(&views([200, 120]), 0, |_| 1e3).smallest(24), 0..3);
    }

    #[test]
    fn photos_double_until_they_are_full() {
        let p = Pyramid::new(&views([200, 120]), 100, |_| 1e3);
        let sides = |i: u64| p.views[p.at(2, i)].image.size;
        assert_eq!(
            [1, 50, 51, 100, 101, 1000].map(sides),
            [[50, 30], [50, 30], [100, 60], [100, 60], [200, 120], [200, 120]]
        );
        assert_eq!(([1, 51, 101].map(|i| p.photo(p.at(2, i))), p.places(51)), ([2; 3], 3..6));
        let small = &p.views[p.at(0, 1)];
        assert_eq!([small.camera.width, small.camera.height], small.image.size);
        assert!((small.camera.fx * 4.0 / p.views[0].camera.fx - 1.0).abs() < 1e-12);
    }

    /// Of 50×30 pixels this many are opaque: four times as many in the next size.
    #[test]
    fn photos_keep_pixels_of_what_they_show() {
        let sizes = |area: f64| {
            let p = Pyramid::new(&views([200, 120]), 100, |small| {
                assert!(small.iter().all(|v| v.image.size == [50, 30]));
                area
            });
            [1, 50, 51, 100, 101].map(|i| p.views[p.at(0, i)].image.size[0])
        };
        assert_eq!(sizes(64.0), [50, 50, 100, 100, 200]);
        assert_eq!(sizes(63.9), [100, 100, 100, 100, 200]);
        assert_eq!(sizes(15.9), [200; 5]);
    }

    #[test]
    fn the_opaque_area_is_that_of_the_files() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let alpha = |x: u32, y: u32| if x < 12 && (8..20).contains(&y) { 255 } else { 0 };
        image::RgbaImage::from_fn(96, 96, |x, y| image::Rgba([90, 80, 70, alpha(x, y)])).save(&path).unwrap();
        let full = views([96, 96]);
        let small: Vec<View> = full.iter().map(|v| v.reduced(4)).collect();
        let at = |path: &std::path::Path| {
            let with = |v: &View| View { image: ImageSource { path: path.into(), ..v.image.clone() }, ..v.clone() };
            opaque_area(&small.iter().map(with).collect::<Vec<_>>(), 2)
        };
        assert!((at(&path) - 9.0).abs() < 0.1, "{}", at(&path));
        assert_eq!(at(&folder.path().join("b.png")), f64::INFINITY);
    }

    #[test]
    fn small_photos_and_no_iterations_leave_photos_as_they_are() {
        for p in [Pyramid::new(&views([47, 300]), 100, |_| 1e3), Pyramid::new(&views([800, 800]), 0, |_| 1e3)] {
            assert_eq!((p.views.len(), p.at(2, 1), p.places(7)), (3, 2, 0..3));
        }
    }
}
