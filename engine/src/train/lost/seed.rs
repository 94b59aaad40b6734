//! First points of an object whose path is known: where the images that show it, moved along, have it.

use std::sync::Arc;

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::track::Track;
use crate::data::pixels::Pixels;
use crate::scene::Camera;
use crate::train::rng;

/// Stream of random numbers used here.
const STREAM: u32 = 0x4c4f_5354;
/// Points that are tried.
const TRIED: usize = 50_000;
/// A point faces a camera from this cosine on.
const FACES: f64 = 0.4;

/// An image that shows the object.
pub(super) struct Shown {
    pub(super) camera: Camera,
    pub(super) photo: Arc<Pixels>,
    /// `[H,W]` pixels that the object may cover.
    pub(super) mask: Arc<[bool]>,
    /// Index of its time.
    pub(super) time: usize,
}

/// Which points are the object's.
pub(super) struct Carving {
    /// Radii of the object within which they are.
    pub(super) reach: f64,
    /// Share of the images that must have it there.
    pub(super) share: f64,
}

impl Shown {
    pub(super) fn has(&self, at: DVec2) -> Option<bool> {
        let inside =
            at.x >= 0.0 && at.y >= 0.0 && at.x < f64::from(self.photo.width) && at.y < f64::from(self.photo.height);
        inside.then(|| self.mask[at.y as usize * self.photo.width as usize + at.x as usize])
    }
}

/// Premultiplied colour and alpha of the photo at a place of the image, px.
fn sample(photo: &Pixels, at: DVec2) -> Option<[f32; 4]> {
    let inside = at.x >= 0.0 && at.y >= 0.0;
    if inside { photo.at(at.x as u32, at.y as u32) } else { None }
}

/// Up to `most` points of the object as it stands at time `reference`.
pub(super) fn carve(
    track: &Track,
    images: &[Shown],
    reference: usize,
    carving: &Carving,
    most: usize,
    seed: u64,
) -> Vec<DVec3> {
    let offset = |image: &Shown| track.places[image.time] - track.places[reference];
    let is_object = |point: &DVec3| {
        let has = |image: &Shown| image.has(image.camera.project(*point + offset(image))?);
        let (seen, inside) = images.iter().filter_map(has).fold((0, 0), |(n, k), o| (n + 1, k + usize::from(o)));
        seen > 0 && inside as f64 >= carving.share * f64::from(seen)
    };
    let tried = |i: usize| {
        let unit = |axis: usize| 2.0 * rng::uniform(seed, STREAM, (3 * i + axis) as u64) - 1.0;
        let of = DVec3::new(unit(0), unit(1), unit(2));
        (of.length() <= 1.0).then(|| track.places[reference] + carving.reach * track.radius * of)
    };
    let found: Vec<DVec3> = (0..TRIED).into_par_iter().filter_map(tried).filter(is_object).collect();
    let kept = found.len().min(most);
    (0..kept).map(|i| found[i * found.len() / kept]).collect()
}

/// The median colour of a point of the object as it stands at time `reference`, over the images whose camera it faces and that
/// have the object there; `None` where none does.
pub(super) fn colour_of(point: DVec3, track: &Track, images: &[Shown], reference: usize) -> Option<[u8; 3]> {
    let outward = (point - track.places[reference]).normalize_or_zero();
    let shows = |image: &Shown| {
        let centre = track.places[image.time];
        let at = image.camera.project(point + centre - track.places[reference])?;
        let faces = outward.dot((image.camera.position - centre).normalize_or_zero()) >= FACES;
        (faces && image.has(at)?).then(|| sample(&image.photo, at))?
    };
    median_colour(&images.iter().filter_map(shows).collect::<Vec<_>>())
}

/// The median of each channel of premultiplied colours; `None` of none.
pub(crate) fn median_colour(seen: &[[f32; 4]]) -> Option<[u8; 3]> {
    let channel = |c: usize| {
        let mut values: Vec<f32> = seen.iter().map(|rgba| rgba[c]).collect();
        values.sort_by(f32::total_cmp);
        values[values.len() / 2]
    };
    (!seen.is_empty()).then(|| std::array::from_fn(|c| (255.0 * channel(c)).round() as u8))
}

/// Mean colour of the images in the object's middle.
pub(super) fn mean_colour(track: &Track, images: &[Shown]) -> [u8; 3] {
    let mut sum = [0.0_f64; 4];
    for image in images {
        let centre = track.places[image.time];
        let (Some(at), depth) =
            (image.camera.project(centre), (image.camera.rotation * (centre - image.camera.position)).z)
        else {
            continue;
        };
        let radius = 0.7 * track.radius / depth * image.camera.fx;
        let steps = -4..=4;
        for (x, y) in steps.clone().flat_map(|x| steps.clone().map(move |y| (x, y))) {
            let beside = DVec2::new(f64::from(x), f64::from(y)) * (radius / 4.0);
            if let Some(rgba) = sample(&image.photo, at + beside).filter(|_| beside.length() <= radius) {
                sum.iter_mut().zip(rgba).for_each(|(s, c)| *s += f64::from(c));
            }
        }
    }
    // Premultiplied: the sum of alphas is what the colours are shares of.
    std::array::from_fn(|c| if sum[3] > 0.0 { (255.0 * sum[c] / sum[3]).round().clamp(0.0, 255.0) as u8 } else { 128 })
}
