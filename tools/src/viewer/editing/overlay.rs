//! Lines of the edit mode over the scene: what is selected, what is dragged, and where a gesture takes it.

use egui::{Align2, Color32, FontId, Painter, Pos2, Rect, Shape, Stroke, pos2};
use glam::{DAffine3, DVec2, DVec3};

use super::gesture::Amount;
use super::gizmo;
use super::mode::{EditMode, Tool};
use crate::viewer::overlay::Projection;
use crate::viewer::state::State;

/// What is selected.
pub(crate) const SELECTED: Color32 = Color32::from_rgb(255, 160, 40);

/// Radius of the circle around a Gaussian that is selected by itself, points.
const LONE: f32 = 7.0;

/// Draws what the edit mode shows over the scene.
pub(crate) fn draw(painter: &Painter, projection: &Projection, state: &State) {
    let edit = &state.edit;
    if !edit.on {
        return;
    }
    dragged(painter, edit);
    let Some(center) = edit.center() else { return };
    let outline = hull(edit.placed.iter().filter_map(|x| projection.point(*x)).collect());
    closed(painter, &outline, Stroke::new(1.5, SELECTED));
    if outline.len() < 3 {
        // One Gaussian, or two, have no outline.
        for at in &outline {
            painter.circle_stroke(*at, LONE, Stroke::new(1.5, SELECTED));
        }
    }
    match &edit.gesture {
        None => gizmo::draw(painter, projection, edit.handles, center),
        Some(gesture) => {
            let amount = gesture.amount(&state.view(edit.frame.size));
            if let Some(axis) = gesture.axis {
                let far = 1e3 * projection.world_per_point(center) * DVec3::AXES[axis];
                if let Some(line) = projection.segment(center - far, center + far) {
                    painter.line_segment(line, Stroke::new(1.0, gizmo::COLORS[axis]));
                }
            }
            ghost(painter, projection, edit, &amount.map(gesture.center));
            say(painter, &amount, &gesture.typed);
        }
    }
}

/// Where the selection comes to be.
fn ghost(painter: &Painter, projection: &Projection, edit: &EditMode, map: &DAffine3) {
    let points: Vec<Pos2> = edit.placed.iter().filter_map(|x| projection.point(map.transform_point3(*x))).collect();
    let dot = |at: &Pos2| Shape::circle_filled(*at, 1.5, SELECTED.gamma_multiply(0.8));
    painter.extend(points.iter().map(dot));
    closed(painter, &hull(points), Stroke::new(1.5, Color32::WHITE));
}

/// The numbers of a gesture, at the top of the scene.
fn say(painter: &Painter, amount: &Amount, typed: &str) {
    let three = |v: DVec3| format!("{:.4}  {:.4}  {:.4}", v.x, v.y, v.z);
    let text = match amount {
        Amount::Move(by) => format!("move  {}", three(*by)),
        Amount::Turn(_, degrees) => format!("turn  {degrees:.1}°"),
        Amount::Scale(factors) => format!("scale  {}", three(*factors)),
    };
    let text = if typed.is_empty() { text } else { format!("{text}   [{typed}]") };
    let at = painter.clip_rect().center_top() + egui::vec2(0.0, 14.0);
    let font = FontId::monospace(14.0);
    for (shift, color) in [(1.0, Color32::BLACK), (0.0, Color32::WHITE)] {
        painter.text(at + egui::vec2(shift, shift), Align2::CENTER_TOP, &text, font.clone(), color);
    }
}

/// The rectangle or the lasso that is being dragged.
fn dragged(painter: &Painter, edit: &EditMode) {
    let point = |p: &DVec2| pos2((p.x / edit.frame.scale) as f32, (p.y / edit.frame.scale) as f32);
    let points: Vec<Pos2> = edit.drawn.iter().map(point).collect();
    let stroke = Stroke::new(1.5, SELECTED);
    match (edit.tool, points.as_slice()) {
        (Tool::Rectangle, [a, b]) => {
            let rect = Rect::from_two_pos(*a, *b);
            painter.rect(rect, 0.0, SELECTED.gamma_multiply(0.08), stroke, egui::StrokeKind::Middle);
        }
        (Tool::Lasso, line) => closed(painter, line, stroke),
        _ => {}
    }
}

fn closed(painter: &Painter, line: &[Pos2], stroke: Stroke) {
    if line.len() > 1 {
        painter.add(Shape::closed_line(line.to_vec(), stroke));
    }
}

/// The convex outline of points, by Andrew's monotone chain.
fn hull(mut points: Vec<Pos2>) -> Vec<Pos2> {
    points.sort_unstable_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    if points.len() < 3 {
        return points;
    }
    let half = |points: &mut dyn Iterator<Item = Pos2>| {
        let mut chain: Vec<Pos2> = Vec::new();
        for p in points {
            while let [.., a, b] = chain[..]
                && (b.x - a.x) * (p.y - a.y) <= (b.y - a.y) * (p.x - a.x)
            {
                chain.pop();
            }
            chain.push(p);
        }
        chain.pop();
        chain
    };
    let mut outline = half(&mut points.iter().copied());
    outline.extend(half(&mut points.iter().rev().copied()));
    outline
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_outline_is_convex_and_around_everything() {
        let points: Vec<Pos2> = (0..200).map(|i| pos2((i * 37 % 101) as f32, (i * 53 % 89) as f32)).collect();
        let outline = hull(points.clone());
        assert!(outline.len() > 3);
        for (i, a) in outline.iter().enumerate() {
            let b = outline[(i + 1) % outline.len()];
            let side = |p: &Pos2| (b.x - a.x) * (p.y - a.y) - (b.y - a.y) * (p.x - a.x);
            assert!(points.iter().all(|p| side(p) >= -1e-3), "{a} {b}");
        }
        assert_eq!(hull(vec![pos2(1.0, 2.0); 5]).len(), 1);
    }
}
