//! Handles at the selection's centre: arrows to move along, rings to turn about, and bars to scale along the world's axes.

use egui::{Color32, Painter, Pos2, Stroke};
use glam::DVec3;

use super::gesture::Kind;
use crate::viewer::overlay::Projection;

/// Length of the handles, points.
const LENGTH: f64 = 84.0;
/// How near to a handle the pointer may be, points.
const NEAR: f32 = 7.0;
/// Length of an arrow's head beyond the line, and width of a bar's end, points.
const HEAD: f32 = 9.0;
/// Of an arrow, the part next to the centre that is not taken: there all axes are near.
const INNER: f64 = 0.25;
/// Points of a ring.
const RING: usize = 48;
/// Colours of the axes.
pub(crate) const COLORS: [Color32; 3] =
    [Color32::from_rgb(240, 84, 84), Color32::from_rgb(120, 205, 90), Color32::from_rgb(90, 150, 255)];

/// The line of a handle on the screen, points of the window; empty behind the camera.
fn line(projection: &Projection, kind: Kind, center: DVec3, axis: usize) -> Vec<Pos2> {
    let reach = LENGTH * projection.world_per_point(center);
    let place = |x: DVec3| projection.point(x);
    let points: Option<Vec<Pos2>> = match kind {
        Kind::Turn => {
            let (u, v) = (DVec3::AXES[(axis + 1) % 3], DVec3::AXES[(axis + 2) % 3]);
            let at = |k: usize| {
                let (sin, cos) = (std::f64::consts::TAU * k as f64 / RING as f64).sin_cos();
                place(center + reach * (cos * u + sin * v))
            };
            (0..=RING).map(at).collect()
        }
        Kind::Move | Kind::Scale => {
            [INNER, 1.0].into_iter().map(|share| place(center + share * reach * DVec3::AXES[axis])).collect()
        }
    };
    points.unwrap_or_default()
}

/// The axis of the handle under a point of the window.
pub(crate) fn hit(projection: &Projection, kind: Kind, center: DVec3, at: Pos2) -> Option<usize> {
    let distance = |axis: usize| {
        let mut line = line(projection, kind, center, axis);
        if let [start, end] = line[..] {
            line[1] = end + (end - start).normalized() * if kind == Kind::Move { HEAD } else { 0.5 * HEAD };
        }
        line.windows(2).map(|s| to_segment(at, s[0], s[1])).fold(f32::INFINITY, f32::min)
    };
    let near = (0..3).map(|axis| (axis, distance(axis))).filter(|(_, d)| *d <= NEAR);
    near.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(axis, _)| axis)
}

fn to_segment(p: Pos2, a: Pos2, b: Pos2) -> f32 {
    let (along, to) = (b - a, p - a);
    let share = (to.dot(along) / along.length_sq().max(1e-6)).clamp(0.0, 1.0);
    (to - share * along).length()
}

/// Draws the handles.
pub(crate) fn draw(painter: &Painter, projection: &Projection, kind: Kind, center: DVec3) {
    for (axis, color) in COLORS.into_iter().enumerate() {
        let line = line(projection, kind, center, axis);
        let Some(end) = line.last().copied() else { continue };
        painter.line(line.clone(), Stroke::new(4.0, Color32::from_black_alpha(110)));
        painter.line(line.clone(), Stroke::new(2.0, color));
        match kind {
            Kind::Move => painter.arrow(end, (end - line[0]).normalized() * HEAD, Stroke::new(3.0, color)),
            Kind::Scale => {
                painter.rect_filled(egui::Rect::from_center_size(end, egui::Vec2::splat(HEAD)), 1.0, color);
            }
            Kind::Turn => {}
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use engine::scene::Camera;

    use super::*;

    #[test]
    fn handles_are_hit_where_they_are_drawn() {
        let camera = Camera::look_at(DVec3::new(1.0, -5.0, 2.0), DVec3::ZERO, DVec3::Z, 0.8, [800, 600]);
        let projection = Projection::new(camera, 5.0, 0.5);
        for kind in [Kind::Move, Kind::Turn, Kind::Scale] {
            for axis in 0..3 {
                let line = line(&projection, kind, DVec3::ZERO, axis);
                let at = if kind == Kind::Turn { line[RING / 8] } else { line[1] };
                assert_eq!(hit(&projection, kind, DVec3::ZERO, at), Some(axis), "{kind:?} {axis}");
            }
            assert_eq!(hit(&projection, kind, DVec3::ZERO, egui::pos2(5.0, 5.0)), None);
            if kind == Kind::Move {
                let [start, end] = line(&projection, kind, DVec3::ZERO, 2)[..] else { continue };
                let tip = end + (end - start).normalized() * (HEAD + 0.9 * NEAR);
                assert_eq!(hit(&projection, kind, DVec3::ZERO, tip), Some(2), "the head of an arrow");
            }
        }
        let center = projection.point(DVec3::ZERO).unwrap();
        let tip = line(&projection, Kind::Move, DVec3::ZERO, 2)[1];
        assert!((f64::from(center.distance(tip)) - LENGTH).abs() < 12.0, "{center} {tip}");
    }
}
