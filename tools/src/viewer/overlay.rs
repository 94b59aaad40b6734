//! Lines and points over the scene: superpoint centres, their paths, camera frusta, the selection. Projected on the host.

use egui::{Color32, Painter, Pos2, Shape, Stroke, pos2};
use engine::scene::Camera;
use glam::DVec3;

use super::known::{self, KnownPoses};
use super::model::{Model, superpoint_color};
use super::state::State;

/// Standard deviations that a ring is wide and a bar long to each side.
const DEVIATIONS: f64 = 2.0;
/// Radii of rings, points: what is known well is seen, and what is known to be anywhere does not hide the rest.
const RADII: [f32; 2] = [2.0, 40.0];

/// Nearest depth that is drawn, as a share of the distance to the target.
const NEAR: f64 = 0.02;
/// Superpoints whose paths are drawn at most.
const MAX_PATHS: usize = 400;

/// From world to points of the window.
pub(super) struct Projection {
    camera: Camera,
    near: f64,
    scale: f64,
}

impl Projection {
    /// `scale`: points per pixel of the camera.
    pub(super) fn new(camera: Camera, distance: f64, scale: f64) -> Self {
        Self { camera, near: NEAR * distance, scale }
    }

    fn view(&self, p: DVec3) -> DVec3 {
        self.camera.rotation * (p - self.camera.position)
    }

    fn flat(&self, v: DVec3) -> Pos2 {
        let c = &self.camera;
        pos2((self.scale * (c.fx * v.x / v.z + c.cx)) as f32, (self.scale * (c.fy * v.y / v.z + c.cy)) as f32)
    }

    /// World units that a point of the window is wide at the depth of `p`.
    pub(super) fn world_per_point(&self, p: DVec3) -> f64 {
        self.view(p).z.max(self.near) / (self.camera.fx * self.scale)
    }

    /// A point in front of the camera.
    pub(super) fn point(&self, p: DVec3) -> Option<Pos2> {
        let v = self.view(p);
        (v.z > self.near).then(|| self.flat(v))
    }

    /// A segment, cut where it leaves the front of the camera.
    pub(super) fn segment(&self, a: DVec3, b: DVec3) -> Option<[Pos2; 2]> {
        let (mut a, mut b) = (self.view(a), self.view(b));
        if a.z < b.z {
            std::mem::swap(&mut a, &mut b);
        }
        if a.z <= self.near {
            return None;
        }
        if b.z < self.near {
            b = a + (b - a) * ((a.z - self.near) / (a.z - b.z));
        }
        Some([self.flat(a), self.flat(b)])
    }
}

/// Draws what the settings ask for.
pub(super) fn draw(painter: &Painter, projection: &Projection, state: &State, model: &Model) {
    if state.settings.frusta {
        frusta(painter, projection, state);
    }
    if state.settings.paths {
        paths(painter, projection, model);
    }
    if state.settings.centers
        && let Some(poses) = &state.poses
    {
        known_poses(painter, projection, model, poses, state.timeline.time);
    } else if state.settings.centers {
        for (i, center) in (0..).zip(&model.centers) {
            if let Some(at) = projection.point(*center) {
                painter.circle(at, 3.0, color(i), Stroke::new(1.0, Color32::from_black_alpha(160)));
            }
        }
    }
    if let Some(superpoint) = state.selection.and_then(|s| s.superpoint) {
        selected(painter, projection, model, superpoint);
    }
}

fn color(superpoint: u32) -> Color32 {
    let [r, g, b] = superpoint_color(superpoint).map(|v| (v * 255.0) as u8);
    Color32::from_rgb(r, g, b)
}

fn path(projection: &Projection, model: &Model, index: usize, stroke: Stroke, painter: &Painter) {
    for step in model.paths.windows(2) {
        if let (Some(a), Some(b)) = (step[0].get(index), step[1].get(index))
            && let Some(segment) = projection.segment(*a, *b)
        {
            painter.line_segment(segment, stroke);
        }
    }
}

fn paths(painter: &Painter, projection: &Projection, model: &Model) {
    let count = model.superpoints();
    let every = count.div_ceil(MAX_PATHS).max(1);
    for i in (0..count).step_by(every) {
        path(projection, model, i, Stroke::new(1.2, color(i as u32).gamma_multiply(0.8)), painter);
    }
}

fn selected(painter: &Painter, projection: &Projection, model: &Model, superpoint: u32) {
    let white = Color32::WHITE;
    path(projection, model, superpoint as usize, Stroke::new(3.0, Color32::from_black_alpha(140)), painter);
    path(projection, model, superpoint as usize, Stroke::new(1.5, white), painter);
    if let Some(at) = model.centers.get(superpoint as usize).and_then(|c| projection.point(*c)) {
        painter.circle(at, 5.0, color(superpoint), Stroke::new(2.0, white));
    }
}

fn frusta(painter: &Painter, projection: &Projection, state: &State) {
    let depth = 0.12 * state.extent.1;
    for (i, camera) in state.cameras.iter().enumerate() {
        let current = state.camera == Some(i);
        let color =
            if current { Color32::from_rgb(255, 190, 60) } else { Color32::from_rgba_unmultiplied(120, 190, 255, 150) };
        let stroke = Stroke::new(if current { 2.0 } else { 1.0 }, color);
        let corner = |x: f64, y: f64| {
            let ray = DVec3::new((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0) * depth;
            camera.position + camera.rotation.transpose() * ray
        };
        let (w, h) = (f64::from(camera.width), f64::from(camera.height));
        let corners = [corner(0.0, 0.0), corner(w, 0.0), corner(w, h), corner(0.0, h)];
        for k in 0..4 {
            for (a, b) in [(corners[k], corners[(k + 1) % 4]), (camera.position, corners[k])] {
                if let Some(segment) = projection.segment(a, b) {
                    painter.add(Shape::line_segment(segment, stroke));
                }
            }
        }
    }
}

/// A ring around each centre, two standard deviations wide across the view of the photo, and a bar of two along it.
fn known_poses(painter: &Painter, projection: &Projection, model: &Model, poses: &KnownPoses, time: f64) {
    let Some(moment) = poses.at(time) else { return };
    let along = DVec3::from_array(moment.direction);
    for (center, known) in model.centers.iter().zip(&moment.superpoints) {
        let Some(at) = projection.point(*center) else { continue };
        let (color, across) = (known::color(known), known.across.unwrap_or(0.0));
        let radius = (DEVIATIONS * across / projection.world_per_point(*center)) as f32;
        if let Some(deviation) = known.along {
            let way = along * (DEVIATIONS * deviation).min(2.0 * model.radius);
            if let Some(bar) = projection.segment(*center - way, *center + way) {
                painter.line_segment(bar, Stroke::new(1.0, color.gamma_multiply(0.6)));
            }
        }
        painter.circle_stroke(at, radius.clamp(RADII[0], RADII[1]), Stroke::new(1.5, color));
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn segments_are_cut_at_the_near_plane() {
        let camera = Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, 1.0, [200, 100]);
        let p = Projection::new(camera, 10.0, 0.5);
        let at = p.point(DVec3::new(0.0, 0.0, 4.0)).unwrap();
        assert!((at.x - 50.0).abs() < 1e-3 && (at.y - 25.0).abs() < 1e-3);
        assert!(p.point(DVec3::new(0.0, 0.0, -4.0)).is_none());
        let cut = p.segment(DVec3::new(0.0, 0.0, 4.0), DVec3::new(1.0, 0.0, -4.0)).unwrap();
        assert!(cut.iter().all(|q| q.x.is_finite() && q.y.is_finite()));
        assert!(p.segment(DVec3::NEG_Z, DVec3::NEG_X).is_none());
    }
}
