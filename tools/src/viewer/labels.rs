//! What floats over the scene and is only read: the frame rate, and messages. It is painted, not laid out as areas of egui: an
//! area takes the clicks on it, and in its first frame, before its size is known, those on 600 by 400 points.

use egui::text::{LayoutJob, TextFormat};
use egui::{Align2, Color32, Context, FontId, Id, LayerId, Order, Rect, TextStyle, Vec2, vec2};

use super::state::{Show, State};
use super::theme::{self, ACCENT, BAD, FAINT};

/// Height of the time line with its margins, points.
const TIME_LINE: f32 = 56.0;
const MARGIN: f32 = 10.0;
/// Height of a line, in sizes of its font.
const LINE: f32 = 1.5;
const PADDING: Vec2 = vec2(10.0, 6.0);

/// Paints the rate at the top left, messages at the bottom left.
pub(super) fn draw(context: &Context, state: &State, has_model: bool) {
    let window = context.content_rect();
    let free = Rect::from_min_max(window.min, window.max - vec2(0.0, TIME_LINE - MARGIN)).shrink(MARGIN);
    paint(context, free, Align2::LEFT_TOP, rate(context, state, has_model));
    if !state.messages.is_empty() {
        paint(context, free, Align2::LEFT_BOTTOM, messages(context, state, free.width()));
    }
}

fn paint(context: &Context, free: Rect, corner: Align2, text: LayoutJob) {
    let painter = context.layer_painter(LayerId::new(Order::Middle, Id::new("labels")));
    let galley = painter.layout_job(text);
    let area = corner.align_size_within_rect(galley.size() + 2.0 * PADDING, free);
    painter.rect_filled(area, theme::ROUNDING, theme::panel_fill());
    painter.galley(area.min + PADDING, galley, Color32::WHITE);
}

/// Text in pieces.
struct Text<'a> {
    job: LayoutJob,
    context: &'a Context,
}

impl Text<'_> {
    fn add(&mut self, gap: f32, text: &str, size: Size, color: Color32) {
        let style = self.context.style();
        let font = |of: TextStyle| style.text_styles.get(&of).cloned().unwrap_or_default();
        let font = match size {
            Size::Large => FontId::proportional(20.0),
            Size::Body => font(TextStyle::Body),
            Size::Small => font(TextStyle::Small),
        };
        let line_height = Some(LINE * font.size);
        self.job.append(text, gap, TextFormat { line_height, ..TextFormat::simple(font, color) });
    }

    fn line(&mut self, text: &str, size: Size, color: Color32) {
        if !self.job.is_empty() {
            self.add(0.0, "\n", size, color);
        }
        self.add(0.0, text, size, color);
    }
}

#[derive(Clone, Copy)]
enum Size {
    Large,
    Body,
    Small,
}

fn rate(context: &Context, state: &State, has_model: bool) -> LayoutJob {
    let visuals = &context.style().visuals;
    let number = |v: Option<f64>| v.map_or("–".to_owned(), |v| format!("{v:.0}"));
    let mut text = Text { job: LayoutJob::default(), context };
    text.add(0.0, &number(state.statistics.fps()), Size::Large, visuals.strong_text_color());
    text.add(8.0, "FPS", Size::Small, FAINT);
    text.add(8.0, &format!("1 % low {}", number(state.statistics.low_fps())), Size::Small, FAINT);
    if let Some(frames) = state.recording {
        text.line(&format!("⏺ recording, {frames} frames"), Size::Body, BAD);
    }
    if let Some(name) = &state.loading {
        text.line(&format!("opening {name} …"), Size::Body, visuals.text_color());
    } else if !has_model {
        text.line("drop a model here", Size::Body, visuals.text_color());
    }
    if state.settings.show != Show::Color {
        text.line(state.settings.show.name(), Size::Small, ACCENT);
    }
    text.job
}

fn messages(context: &Context, state: &State, width: f32) -> LayoutJob {
    let mut text = Text { job: LayoutJob::default(), context };
    text.job.wrap.max_width = (width - 40.0).clamp(100.0, 640.0);
    for message in &state.messages {
        let color = if message.is_error { BAD } else { context.style().visuals.text_color() };
        text.line(&message.text, Size::Body, color);
    }
    text.job
}

#[cfg(test)]
mod tests {
    use egui::Sense;

    use super::*;
    use crate::viewer::first::test_state;

    #[test]
    fn what_is_only_read_leaves_clicks_to_the_scene() {
        let (context, mut state) = (Context::default(), test_state());
        theme::apply(&context);
        let frame = |state: &mut State, events| {
            let screen_rect = Some(Rect::from_min_size(egui::Pos2::ZERO, vec2(1000.0, 700.0)));
            let mut clicked = false;
            let _ = context.run(egui::RawInput { screen_rect, events, ..egui::RawInput::default() }, |context| {
                draw(context, state, true);
                egui::CentralPanel::default().frame(egui::Frame::NONE).show(context, |ui| {
                    clicked = ui.interact(ui.max_rect(), ui.id().with("scene"), Sense::click_and_drag()).clicked();
                });
            });
            clicked
        };
        let click = |x: f32, y: f32| {
            let (pos, button, modifiers) = (egui::pos2(x, y), egui::PointerButton::Primary, egui::Modifiers::NONE);
            let of = |pressed| egui::Event::PointerButton { pos, button, pressed, modifiers };
            vec![egui::Event::PointerMoved(pos), of(true), of(false)]
        };
        for _ in 0..3 {
            assert!(!frame(&mut state, Vec::new()));
        }
        state.say("saved", false);
        frame(&mut state, Vec::new());
        assert!(frame(&mut state, click(300.0, 250.0)), "beside a message that has just come");
        assert!(frame(&mut state, click(25.0, 630.0)), "on it");
        assert!(frame(&mut state, click(20.0, 20.0)), "on the rate");
    }
}
