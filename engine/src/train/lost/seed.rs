//! First points of an object whose path is known: where all images that show it, moved along, are opaque.

use std::sync::Arc;

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::track::Track;
use crate::data::pixels::Pixels;
use crate::scene::Camera;
use crate::train::init::Point;
use crate::train::rng;

/// Stream of random numbers used here.
const STREAM: u32 = 0x4c4f_5354;
/// Points that are tried.
const TRIED: usize = 50_000;
/// Radii of the object within which they, and its superpoints, are.
pub(super) const REACH: f64 = 1.6;
/// A point is the object's if at least this share of its images is opaque there.
const OPAQUE_IN: f64 = 0.9;
/// Alpha of an opaque pixel.
const OPAQUE: f32 = 0.5;

/// An image that shows the object.
pub(super) struct Shown {
    pub(super) camera: Camera,
    pub(super) photo: Arc<Pixels>,
    /// Index of its time.
    pub(super) time: usize,
}

/// Premultiplied colour and alpha of the photo at a place of the image, px.
fn sample(photo: &Pixels, at: DVec2) -> Option<[f32; 4]> {
    let inside = at.x >= 0.0 && at.y >= 0.0;
    if inside { photo.at(at.x as u32, at.y as u32) } else { None }
}

/// Up to `most` points of the object as it stands at time `reference`, with its mean colour.
pub(super) fn points(track: &Track, images: &[Shown], reference: usize, most: usize, seed: u64) -> Vec<Point> {
    let offset = |image: &Shown| track.places[image.time] - track.places[reference];
    let is_object = |point: &DVec3| {
        let opaque = |image: &Shown| {
            let at = image.camera.project(*point + offset(image))?;
            sample(&image.photo, at).map(|[.., alpha]| alpha >= OPAQUE)
        };
        let (seen, inside) = images.iter().filter_map(opaque).fold((0, 0), |(n, k), o| (n + 1, k + usize::from(o)));
        seen > 0 && inside as f64 >= OPAQUE_IN * f64::from(seen)
    };
    let tried = |i: usize| {
        let unit = |axis: usize| 2.0 * rng::uniform(seed, STREAM, (3 * i + axis) as u64) - 1.0;
        let of = DVec3::new(unit(0), unit(1), unit(2));
        (of.length() <= 1.0).then(|| track.places[reference] + REACH * track.radius * of)
    };
    let found: Vec<DVec3> = (0..TRIED).into_par_iter().filter_map(tried).filter(is_object).collect();
    let color = colour(track, images);
    let kept = found.len().min(most);
    (0..kept).map(|i| Point { position: found[i * found.len() / kept].as_vec3().to_array(), color }).collect()
}

/// Mean colour of the images in the object's middle.
fn colour(track: &Track, images: &[Shown]) -> [u8; 3] {
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
