//! A photo with its camera, at all sizes, and how the camera moves while it is searched for.

use glam::{DMat3, DVec3};

use super::adam::Adam;
use super::solver::LEAST_DIFFERENCE;
use crate::data::dataset::View;
use crate::data::pixels::LEFT_OUT;
use crate::error::Result;
use crate::reference::exp;
use crate::scene::Camera;
use crate::train::photo_loss::{CameraGradient, DevicePhoto, PhotoLoss};

/// No photo is made smaller than this on its shorter side, pixels.
const SMALLEST_SIDE: u32 = 24;
/// Most halvings.
const MOST_HALVINGS: u32 = 4;

/// A photo at one size.
#[derive(Debug)]
pub(super) struct Size {
    pub(super) pixels: [u32; 2],
    pub(super) photo: DevicePhoto,
    /// `[H,W]` of the photo.
    rgba: Vec<u32>,
}

/// What a photo and an image differ by.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Residual {
    /// `[H,W,3]` image less photo; 0 where a mask leaves a pixel out.
    pub(super) difference: Vec<f32>,
    /// `[H,W,3]` weights with which a sum of squares is that of absolute differences, a third per channel.
    pub(super) weight: Vec<f32>,
}

impl Residual {
    /// Mean square of the values that differ at all; 0 where none does.
    pub(super) fn mean_square(&self) -> f64 {
        let differ = self.difference.iter().filter(|d| **d != 0.0);
        let (sum, count) = differ.fold((0.0, 0.0), |(sum, count), d| (sum + f64::from(*d).powi(2), count + 1.0));
        sum / f64::max(count, 1.0)
    }

    /// Sum of the absolute differences of a pixel; `None` outside. `width` is that of the image, pixels.
    pub(super) fn at(&self, [u, v]: [f64; 2], width: u32) -> Option<f64> {
        if !(u >= 0.0 && v >= 0.0 && u < f64::from(width)) {
            return None;
        }
        let at = 3 * (v as usize).checked_mul(width as usize)?.checked_add(u as usize)?;
        let pixel = self.difference.get(at..at.checked_add(3)?)?;
        Some(pixel.iter().map(|d| f64::from(d.abs())).sum())
    }
}

impl Size {
    /// From an image `[H,W,3]` over a background.
    pub(super) fn residual(&self, image: &[f32], background: [f32; 3]) -> Residual {
        residual(&self.rgba, image, background)
    }
}

fn residual(rgba: &[u32], image: &[f32], background: [f32; 3]) -> Residual {
    let photo = rgba.iter().flat_map(|&pixel| {
        let [r, g, b, a] = pixel.to_le_bytes().map(f32::from);
        let values = [0, 1, 2].map(|c| ([r, g, b][c] + (255.0 - a) * background[c]) / 255.0);
        values.map(|value| (pixel != LEFT_OUT).then_some(value))
    });
    let difference: Vec<f32> = image.iter().zip(photo).map(|(i, p)| p.map_or(0.0, |p| i - p)).collect();
    let mean = difference.iter().map(|d| f64::from(d.abs())).sum::<f64>() / difference.len().max(1) as f64;
    let smallest = mean.max(LEAST_DIFFERENCE).powi(2);
    let weight = |d: &f32| (1.0 / (3.0 * (f64::from(*d).powi(2) + smallest).sqrt())) as f32;
    Residual { weight: difference.iter().map(weight).collect(), difference }
}

/// A photo, and the camera that is thought to have taken it.
#[derive(Debug)]
pub(super) struct Sight {
    /// The camera at full size.
    pub(super) camera: Camera,
    /// Full size first, each half of the one before.
    pub(super) sizes: Vec<Size>,
    /// What the camera is turned around: the middle of what it sees.
    pivot: DVec3,
    /// Distance of the pivot, and root mean square distance of what is seen from it.
    reach: [f64; 2],
    adam: Adam,
}

/// Halvings that a photo of this size bears.
pub(super) fn halvings(size: [u32; 2]) -> u32 {
    (1..=MOST_HALVINGS).take_while(|k| size[0].min(size[1]) >> k >= SMALLEST_SIDE).last().unwrap_or(0)
}

impl Sight {
    /// Decodes and uploads a photo at `halvings` + 1 sizes.
    pub(super) fn new(loss: &PhotoLoss<'_>, view: &View, halvings: u32, outline: &[DVec3]) -> Result<Self> {
        let size = |k: u32| {
            let view = if k == 0 { view.clone() } else { view.reduced(1 << k) };
            let pixels = view.image.decode_for_training()?;
            Ok(Size { pixels: [pixels.width, pixels.height], photo: loss.photo(&pixels)?, rgba: pixels.rgba })
        };
        let sizes = (0..=halvings).map(size).collect::<Result<_>>()?;
        let camera = Camera { time: view.time, name: view.name.clone(), ..view.camera.clone() };
        let mut sight = Self { camera, sizes, pivot: DVec3::ZERO, reach: [1.0; 2], adam: Adam::new(6) };
        sight.look(outline);
        Ok(sight)
    }

    /// Takes the middle of the points in the image as what the camera turns around; where there are none, of all.
    fn look(&mut self, outline: &[DVec3]) {
        let seen: Vec<DVec3> = outline.iter().copied().filter(|x| is_inside(&self.camera, *x)).collect();
        let all = if seen.len() < 3 { outline.to_vec() } else { seen };
        let n = all.len().max(1) as f64;
        self.pivot = all.iter().sum::<DVec3>() / n;
        let distance = self.pivot.distance(self.camera.position).max(1e-9);
        let spread = (all.iter().map(|x| x.distance_squared(self.pivot)).sum::<f64>() / n).sqrt();
        self.reach = [distance, spread.clamp(0.05 * distance, distance)];
    }

    /// The camera of a size.
    pub(super) fn camera_at(&self, size: usize) -> Camera {
        let [width, height] = self.sizes[size].pixels;
        self.camera.resized(width, height)
    }

    /// World units per pixel of a size at a point.
    pub(super) fn unit_at(&self, size: usize, x: DVec3) -> f64 {
        let camera = self.camera_at(size);
        let distance = x.distance(camera.position).max(0.05 * self.reach[0]);
        distance / (camera.fx * camera.fy).sqrt()
    }

    /// What a step of 1 in each of the camera's numbers is: turns around the pivot and shifts, both along the camera's axes, that
    /// move what is seen by about a pixel. These numbers hardly disturb each other, unlike turns about the camera's centre.
    fn units(&self, size: usize) -> [DVec3; 2] {
        let [distance, spread] = self.reach;
        let pixel = self.unit_at(size, self.pivot);
        [DVec3::splat(pixel / spread), DVec3::new(pixel, pixel, pixel * distance / spread)]
    }

    /// One step against the gradient of a size; about `rate` pixels.
    pub(super) fn step(&mut self, gradient: &CameraGradient, weight: f64, size: usize, rate: f64) {
        let [turn_unit, shift_unit] = self.units(size);
        let axes = self.camera.rotation;
        let by_turn = gradient.rotation + (self.camera.position - self.pivot).cross(gradient.position);
        let by_turn = axes * by_turn * turn_unit * weight;
        let by_shift = axes * gradient.position * shift_unit * weight;
        let step = self.adam.step(&[by_turn.to_array(), by_shift.to_array()].concat(), rate);
        let turn = DVec3::from_slice(&step[..3]) * turn_unit;
        let shift = DVec3::from_slice(&step[3..]) * shift_unit;
        let back = axes.transpose();
        self.turn(back * turn, back * shift);
    }

    /// Turns the camera around the pivot by Exp(`turn`), then shifts it.
    fn turn(&mut self, turn: DVec3, shift: DVec3) {
        let turned = exp(turn);
        self.camera.position = self.pivot + turned * (self.camera.position - self.pivot) + shift;
        self.camera.rotation = orthonormal(self.camera.rotation * turned.transpose());
    }

    /// Goes along with a rigid change of the world, `back` after a shift by −`shift`.
    pub(super) fn follow(&mut self, back: glam::DQuat, shift: DVec3) {
        self.camera.position = back * (self.camera.position - shift);
        self.pivot = back * (self.pivot - shift);
        self.camera.rotation = orthonormal(self.camera.rotation * DMat3::from_quat(back.conjugate()));
    }

    /// Takes another camera pose, as if nothing were known of gradients.
    pub(super) fn place(&mut self, rotation: DMat3, position: DVec3) {
        self.camera.rotation = orthonormal(rotation);
        self.camera.position = position;
        self.adam = Adam::new(6);
    }
}

/// Root mean square distance in pixels between where two cameras see points; those behind either are left out. `None` where
/// neither sees any.
pub fn apart_px(a: &Camera, b: &Camera, points: &[DVec3]) -> Option<f64> {
    let pairs = points.iter().filter_map(|x| {
        let inside = is_inside(a, *x) || is_inside(b, *x);
        let (a, b) = (project(a, *x)?, project(b, *x)?);
        inside.then(|| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2))
    });
    let squares: Vec<f64> = pairs.collect();
    (!squares.is_empty()).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
}

/// Where a camera sees a point, pixels; `None` behind it.
pub fn project(camera: &Camera, x: DVec3) -> Option<[f64; 2]> {
    camera.project(x).map(|p| p.to_array())
}

fn is_inside(camera: &Camera, x: DVec3) -> bool {
    let size = [camera.width, camera.height].map(f64::from);
    project(camera, x).is_some_and(|[u, v]| (0.0..size[0]).contains(&u) && (0.0..size[1]).contains(&v))
}

fn orthonormal(matrix: DMat3) -> DMat3 {
    DMat3::from_quat(glam::DQuat::from_mat3(&matrix).normalize())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn residuals_are_over_the_background_and_without_what_is_left_out() {
        // Opaque, half transparent (premultiplied), left out.
        let rgba = [0xff00_80ff, 0x8000_0040, LEFT_OUT];
        let image = [1.0, 0.5, 0.25, 0.5, 0.5, 0.5, 0.9, 0.9, 0.9];
        let found = residual(&rgba, &image, [1.0, 0.0, 0.5]);
        let expected = [0.0, 0.5 - 128.0 / 255.0, 0.25, 0.5 - 191.0 / 255.0, 0.5, 0.5 - 63.5 / 255.0, 0.0, 0.0, 0.0];
        for (found, expected) in found.difference.iter().zip(expected) {
            assert!((f64::from(*found) - expected).abs() < 1e-6, "{found} for {expected}");
        }
        let mean = found.difference.iter().map(|d| d.abs()).sum::<f32>() / 9.0;
        for (weight, d) in found.weight.iter().zip(&found.difference) {
            assert!((weight * 3.0 * d.hypot(mean) - 1.0).abs() < 1e-5, "{weight} at {d}");
        }
        let squares: f32 = found.difference.iter().map(|d| d * d).sum();
        assert!((found.mean_square() - f64::from(squares) / 5.0).abs() < 1e-7);
        assert_eq!(Residual::default().mean_square(), 0.0);
    }
}
