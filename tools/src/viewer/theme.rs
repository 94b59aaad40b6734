//! How the interface looks: dark, flat, a little see-through, so that the scene stays the main thing.

use egui::{Color32, CornerRadius, FontFamily, FontId, Margin, Stroke, TextStyle, vec2};

/// Windows narrower than this start without the panel, points.
pub(super) const PANEL_FROM: f32 = 900.0;
/// Colours of the stages of a frame, in their order.
pub(super) const STAGE_COLORS: [Color32; 3] =
    [Color32::from_rgb(86, 156, 214), Color32::from_rgb(181, 206, 108), Color32::from_rgb(205, 92, 128)];
/// What stands out.
pub(super) const ACCENT: Color32 = Color32::from_rgb(96, 165, 250);
/// Texts beside the main ones.
pub(super) const FAINT: Color32 = Color32::from_rgb(150, 156, 166);
/// What went wrong.
pub(super) const BAD: Color32 = Color32::from_rgb(248, 113, 113);

/// Behind panels.
pub(super) fn panel_fill() -> Color32 {
    Color32::from_rgba_unmultiplied(22, 24, 29, 225)
}

/// Corners of what floats over the scene, points.
pub(super) const ROUNDING: f32 = 6.0;

/// A frame for things at an edge of the window.
pub(super) fn edge() -> egui::Frame {
    egui::Frame::NONE.fill(panel_fill()).inner_margin(Margin::symmetric(12, 8))
}

pub(super) fn apply(context: &egui::Context) {
    context.set_theme(egui::Theme::Dark);
    context.style_mut_of(egui::Theme::Dark, |style| {
        style.text_styles = [
            (TextStyle::Heading, FontId::new(17.0, FontFamily::Proportional)),
            (TextStyle::Body, FontId::new(13.0, FontFamily::Proportional)),
            (TextStyle::Button, FontId::new(13.0, FontFamily::Proportional)),
            (TextStyle::Small, FontId::new(11.0, FontFamily::Proportional)),
            (TextStyle::Monospace, FontId::new(12.0, FontFamily::Monospace)),
        ]
        .into();
        style.spacing.item_spacing = vec2(8.0, 5.0);
        style.spacing.slider_width = 120.0;
        style.spacing.interact_size.y = 20.0;
        // Beside what it moves, and there before the pointer is.
        style.spacing.scroll = egui::style::ScrollStyle { bar_width: 6.0, ..egui::style::ScrollStyle::solid() };
        let visuals = &mut style.visuals;
        visuals.window_fill = panel_fill();
        visuals.window_stroke = Stroke::new(1.0, Color32::from_rgb(58, 62, 70));
        visuals.window_corner_radius = CornerRadius::same(8);
        visuals.override_text_color = Some(Color32::from_rgb(225, 228, 234));
        visuals.selection.bg_fill = Color32::from_rgb(37, 99, 185);
        visuals.slider_trailing_fill = true;
        visuals.extreme_bg_color = Color32::from_rgb(12, 13, 16);
        for widget in [&mut visuals.widgets.inactive, &mut visuals.widgets.hovered, &mut visuals.widgets.active] {
            widget.corner_radius = CornerRadius::same(4);
            widget.expansion = 0.0;
        }
    });
}
