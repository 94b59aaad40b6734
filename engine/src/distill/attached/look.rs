//! Where a photo differs, and how far every pixel is from there.

use std::sync::Arc;

use glam::DVec3;

use crate::data::pixels::Pixels;
use crate::scene::Camera;
use crate::train::lost::disc::distance_to;
use crate::train::lost::residual::Difference;

/// Distances end here, px: what is farther off pulls at nothing.
const FARTHEST: f32 = 8.0;
/// Nothing nearer to a camera is looked at, world units.
const NEAR: f64 = 0.05;
/// A point is hidden if it lies this many pixels' width behind what the model shows, and the photo does not differ within so many px.
const BEHIND: f64 = 4.0;
const DIFFERS: f32 = 1.0;

pub(super) struct Look {
    pub(super) camera: Camera,
    photo: Arc<Pixels>,
    /// `[H,W]` by how much it differs.
    amount: Vec<f32>,
    /// Index of its time.
    pub(super) time: usize,
    /// `[H,W]` px to the next pixel that differs.
    distance: Vec<f32>,
    /// `[H,W]` depth beyond which the model hides a point.
    hides: Vec<f32>,
}

/// Where a photo has a point.
#[derive(Debug, Clone, Copy)]
struct At {
    /// Camera space.
    point: DVec3,
    x: usize,
    y: usize,
}

impl Look {
    pub(super) fn new(d: &Difference) -> Self {
        let mut distance = distance_to(&d.left, [d.camera.width, d.camera.height]);
        distance.iter_mut().for_each(|d| *d = d.min(FARTHEST));
        let (camera, photo, time) = (d.camera.clone(), d.photo.clone(), d.time);
        Self { camera, photo, amount: d.amount.clone(), time, distance, hides: d.hides.clone() }
    }

    /// `[H,W]` pixels that differ.
    pub(super) fn differs(&self) -> Vec<bool> {
        self.distance.iter().map(|d| *d <= 0.0).collect()
    }

    /// Width and height, px.
    pub(super) fn size(&self) -> [u32; 2] {
        [self.camera.width, self.camera.height]
    }

    fn at(&self, point: DVec3) -> Option<At> {
        let c = &self.camera;
        let point = c.rotation * (point - c.position);
        if point.z < NEAR {
            return None;
        }
        let (x, y) = (c.fx * point.x / point.z + c.cx, c.fy * point.y / point.z + c.cy);
        let inside = x >= 0.0 && y >= 0.0 && x < f64::from(c.width) && y < f64::from(c.height);
        inside.then_some(At { point, x: x as usize, y: y as usize })
    }

    fn distance_at(&self, x: usize, y: usize) -> f32 {
        self.distance[y * self.camera.width as usize + x]
    }

    /// Pixels between a point (world) and what differs; `None` for one that the photo does not have.
    pub(super) fn distance(&self, point: DVec3) -> Option<f32> {
        self.at(point).map(|a| self.distance_at(a.x, a.y))
    }

    /// Whether the model has something before a point, and the photo does not differ there.
    pub(super) fn is_hidden(&self, point: DVec3) -> bool {
        self.at(point).is_some_and(|a| {
            let i = a.y * self.camera.width as usize + a.x;
            let front = a.point.z * (1.0 - BEHIND / self.camera.fx);
            self.distance[i] > DIFFERS && front > f64::from(self.hides[i])
        })
    }

    /// The same, and by how much it grows with the point.
    pub(super) fn slope(&self, point: DVec3) -> Option<(f64, DVec3)> {
        let At { point, x, y } = self.at(point)?;
        let c = &self.camera;
        let [last_x, last_y] = [c.width as usize - 1, c.height as usize - 1];
        let ([left, right], [up, down]) =
            ([x.saturating_sub(1), (x + 1).min(last_x)], [y.saturating_sub(1), (y + 1).min(last_y)]);
        let by = |after: f32, before: f32, steps: usize| f64::from(after - before) / steps.max(1) as f64;
        let by_x = c.fx / point.z * by(self.distance_at(right, y), self.distance_at(left, y), right - left);
        let by_y = c.fy / point.z * by(self.distance_at(x, down), self.distance_at(x, up), down - up);
        let by_z = -(by_x * point.x + by_y * point.y) / point.z;
        Some((f64::from(self.distance_at(x, y)), c.rotation.transpose() * DVec3::new(by_x, by_y, by_z)))
    }

    /// World units of a pixel at a point; `None` behind the camera.
    pub(super) fn pixel(&self, point: DVec3) -> Option<f64> {
        let z = (self.camera.rotation * (point - self.camera.position)).z;
        (z > NEAR).then(|| z / self.camera.fx)
    }

    /// Premultiplied colour where a point lies where the photo differs: of the pixels there, that which differs most. Others may be of what
    /// is thin in part only.
    pub(super) fn colour(&self, point: DVec3) -> Option<[f32; 4]> {
        let at = self.at(point).filter(|a| self.distance_at(a.x, a.y) <= 0.0)?;
        let [width, height] = [self.camera.width, self.camera.height].map(|s| s as usize);
        let rows = at.y.saturating_sub(1)..(at.y + 2).min(height);
        let around = rows.flat_map(|y| (at.x.saturating_sub(1)..(at.x + 2).min(width)).map(move |x| (x, y)));
        let amount = |(x, y): &(usize, usize)| self.amount[y * width + x];
        let (x, y) = around.max_by(|a, b| amount(a).total_cmp(&amount(b)))?;
        self.photo.at(x as u32, y as u32)
    }

    /// Pixels within so many of where these points are.
    pub(super) fn near(&self, points: &[DVec3], within: f32) -> Vec<usize> {
        let width = self.camera.width as usize;
        let mut mask = vec![false; self.distance.len()];
        points.iter().filter_map(|p| self.at(*p)).for_each(|a| mask[a.y * width + a.x] = true);
        let distance = distance_to(&mask, [self.camera.width, self.camera.height]);
        (0..distance.len()).filter(|&i| distance[i] <= within).collect()
    }
}
