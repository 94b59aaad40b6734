//! How far the move of a point shows in views.

use std::borrow::Borrow;

use glam::{DVec2, DVec3};

use crate::scene::Camera;

/// A point counts on a camera when it falls within this share of the image's size around it.
const IMAGE_MARGIN: f64 = 0.1;

/// A move is short, and its two ends are seen alike, when a camera is so many times as far away.
const FAR: f64 = 20.0;
/// By how much they are not.
const SLACK: f64 = 1.5;

/// Cameras through which a motion is measured.
#[derive(Debug, Clone)]
pub struct Views<C> {
    /// The cameras.
    pub cameras: Vec<C>,
    /// Nearest depth that is drawn, world units.
    pub near: f64,
    /// Whether errors count at points that no camera sees, too: as a camera turned to them would see them. Without, only
    /// whether they move at all is measured so.
    pub everywhere: bool,
}

impl<C: Borrow<Camera>> Views<C> {
    /// Whether a point falls into an image.
    pub fn see(&self, point: DVec3) -> bool {
        self.cameras.iter().any(|c| {
            let c = c.borrow();
            pixel(c, point, self.near).is_some_and(|p| is_inside(c, p))
        })
    }

    /// Distance of two points, pixels: the largest in the images into which one of them falls, else what a camera turned to
    /// them would see. Above 0 for different points, wherever they are.
    pub fn movement(&self, one: DVec3, two: DVec3) -> f64 {
        let turned = |c: &C| turned_distance(c.borrow(), one, two, self.near);
        self.in_images(one, two).unwrap_or_else(|| self.cameras.iter().map(turned).fold(0.0, f64::max))
    }

    /// [`Self::movement`]; 0 of points that no camera sees, unless those count.
    pub fn displacement(&self, one: DVec3, two: DVec3) -> f64 {
        if self.everywhere { self.movement(one, two) } else { self.in_images(one, two).unwrap_or(0.0) }
    }

    /// Pixels that a small move of a point is seen as at most, per world unit: in the images into which it falls, else as a
    /// camera turned to it would see it; 0 for points that no camera sees, unless those count.
    pub fn reach(&self, point: DVec3) -> f64 {
        let seen = self.cameras.iter().filter_map(|c| image_reach(c.borrow(), point, self.near)).reduce(f64::max);
        let turned = |c: &C| turned_reach(c.borrow(), point, self.near);
        let unseen = || self.cameras.iter().map(turned).fold(0.0, f64::max);
        seen.unwrap_or_else(|| if self.everywhere { unseen() } else { 0.0 })
    }

    /// Pixels that [`Self::displacement`] cannot be above for points of a ball that move by up to `distance`; infinite where that is
    /// not told so cheaply.
    pub fn most(&self, center: DVec3, radius: f64, distance: f64) -> f64 {
        let of = |c: &C| {
            let c = c.borrow();
            let nearest = center.distance(c.position) - radius - distance;
            if nearest < self.near.max(FAR * distance) {
                return f64::INFINITY;
            }
            // f/z·√(1 + tan²) with z no less than nearest/√(1 + tan²).
            c.fx.max(c.fy) * (1.0 + widest(c)) * distance / nearest * SLACK
        };
        self.cameras.iter().map(of).fold(0.0, f64::max)
    }

    fn in_images(&self, one: DVec3, two: DVec3) -> Option<f64> {
        self.cameras.iter().filter_map(|c| image_distance(c.borrow(), one, two, self.near)).reduce(f64::max)
    }
}

/// Largest tan² of the angle between the optical axis and a point that falls into an image.
fn widest(c: &Camera) -> f64 {
    let reach = |size: u32, center: f64, focal: f64| {
        let size = f64::from(size);
        ((center.max(size - center) + IMAGE_MARGIN * size) / focal).powi(2)
    };
    reach(c.width, c.cx, c.fx) + reach(c.height, c.cy, c.fy)
}

/// Where a point in front of the near plane is in the image's plane, pixels.
fn pixel(c: &Camera, point: DVec3, near: f64) -> Option<(f64, f64)> {
    let p = c.rotation * (point - c.position);
    (p.z > near).then(|| (c.fx * p.x / p.z + c.cx, c.fy * p.y / p.z + c.cy))
}

fn is_inside(c: &Camera, (x, y): (f64, f64)) -> bool {
    let (w, h) = (f64::from(c.width), f64::from(c.height));
    x > -IMAGE_MARGIN * w && x < (1.0 + IMAGE_MARGIN) * w && y > -IMAGE_MARGIN * h && y < (1.0 + IMAGE_MARGIN) * h
}

/// Distance of two points in the image of a camera, pixels; `None` where neither falls into it.
fn image_distance(c: &Camera, one: DVec3, two: DVec3, near: f64) -> Option<f64> {
    let (p, q) = (pixel(c, one, near), pixel(c, two, near));
    let shows = [p, q].into_iter().flatten().any(|p| is_inside(c, p));
    shows.then(|| match (p, q) {
        (Some(p), Some(q)) => DVec2::new(p.0 - q.0, p.1 - q.1).length(),
        // One of them is behind the camera and has no place in its image.
        _ => turned_distance(c, one, two, near),
    })
}

/// About the same for a camera at that place that is turned to the nearer of the points.
fn turned_distance(c: &Camera, one: DVec3, two: DVec3, near: f64) -> f64 {
    let nearest = one.distance(c.position).min(two.distance(c.position)).max(near);
    c.fx.max(c.fy) * one.distance(two) / nearest
}

/// Pixels per world unit at a point that falls into the image: the norm of the projection's derivative, f/z·√(1 + tan²), tan
/// being that of the angle to the optical axis.
fn image_reach(c: &Camera, point: DVec3, near: f64) -> Option<f64> {
    let p = c.rotation * (point - c.position);
    let shows = pixel(c, point, near).is_some_and(|p| is_inside(c, p));
    shows.then(|| c.fx.max(c.fy) / p.z * (1.0 + (p.x / p.z).powi(2) + (p.y / p.z).powi(2)).sqrt())
}

/// The same in the middle of the image of a camera turned to the point.
fn turned_reach(c: &Camera, point: DVec3, near: f64) -> f64 {
    c.fx.max(c.fy) / point.distance(c.position).max(near)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::synthetic::Random;

    #[test]
    fn no_displacement_is_above_the_most() {
        let mut random = Random::new(9);
        let camera = |random: &mut Random| {
            let eye = 3.0 * random.direction();
            Camera::look_at(eye, 0.3 * random.normal3(), DVec3::Z, random.range(0.4, 1.4), [300, 200])
        };
        let cameras = (0..12).map(|_| camera(&mut random)).collect();
        let views = Views { cameras, near: 0.2, everywhere: true };
        let (mut told, mut closest) = (0, 0.0);
        for _ in 0..5000 {
            let (center, radius) = (random.normal3(), random.range(0.0, 0.5));
            let one = center + random.range(0.0, radius) * random.direction();
            let distance = 10f64.powf(random.range(-4.0, -0.5));
            let two = one + random.range(0.0, distance) * random.direction();
            let (most, found) = (views.most(center, radius, distance), views.displacement(one, two));
            assert!(found <= most, "{found} {most}");
            if most.is_finite() {
                told += 1;
                closest = f64::max(closest, found / most);
            }
        }
        assert!(told > 2000 && closest > 0.1, "{told} {closest}");
    }
}
