//! The interface: a panel of numbers and switches, the time line, the list of keys.

use egui::{Align, Align2, Color32, Context, Layout, RichText, Sense, Ui, vec2};
use engine::render::{FrameStatistics, MemoryUse, Quality};

use super::input::{self, BINDINGS};
use super::navigator::Navigation;
use super::state::{Binding, Request, Selection, Settings, Show, State};
use super::statistics::{HISTORY, STAGES};
use super::theme::{self, ACCENT, FAINT, STAGE_COLORS};
use super::timeline::Timeline;
use super::widgets::{grouped, row, section};

/// What the panel tells beside the state.
#[derive(Debug, Clone, Default)]
pub(super) struct Info {
    pub(super) device: String,
    pub(super) model: String,
    pub(super) gaussians: usize,
    pub(super) superpoints: usize,
    pub(super) key_times: usize,
    pub(super) rendered: [u32; 2],
    pub(super) memory: MemoryUse,
    /// Gaussians of the selected superpoint; opacity and scales of the selected Gaussian.
    pub(super) selected: Option<(usize, f32, [f32; 3])>,
}

/// What the panel and the time line show of a frame that stands still.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Numbers {
    time: f64,
    playing: bool,
    loading: bool,
    frame: FrameStatistics,
    rendered: [u32; 2],
    memory: MemoryUse,
    measured: bool,
}

impl Numbers {
    pub(super) fn of(state: &State, info: &Info) -> Self {
        Self {
            time: state.timeline.time,
            playing: state.timeline.playing,
            loading: state.loading.is_some(),
            frame: state.frame,
            rendered: info.rendered,
            memory: info.memory,
            measured: state.statistics.history().next().is_some(),
        }
    }
}

/// Draws what has buttons and numbers around the scene.
pub(super) fn draw(context: &Context, state: &mut State, info: &Info) {
    egui::TopBottomPanel::bottom("time")
        .frame(theme::edge())
        .show_separator_line(false)
        .show(context, |ui| time_bar(ui, &mut state.timeline));
    if state.settings.panel || state.edit.on {
        egui::SidePanel::right("panel")
            .frame(theme::edge())
            .resizable(false)
            .exact_width(252.0)
            .show_separator_line(false)
            .show(context, |ui| {
                egui::ScrollArea::vertical().show(ui, |ui| match state.edit.on {
                    true => super::editing::panel::draw(ui, state, info.gaussians),
                    false => side_panel(ui, state, info),
                });
            });
    }
    if state.settings.help {
        help(context, state);
    }
}

fn time_bar(ui: &mut Ui, time: &mut Timeline) {
    ui.horizontal(|ui| {
        ui.add_enabled_ui(time.moves(), |ui| {
            let symbol = if time.playing { "⏸" } else { "▶" };
            let button = egui::Button::new(RichText::new(symbol).size(15.0)).min_size(vec2(30.0, 24.0));
            if ui.add(button).on_hover_text("Space").clicked() {
                time.toggle();
            }
            if ui.button(time.repeat.name()).on_hover_text("at the end (L)").clicked() {
                time.repeat = time.repeat.next();
            }
            let mut speed = time.speed;
            let field =
                egui::DragValue::new(&mut speed).speed(0.01).range(1.0 / 64.0..=64.0).suffix("×").max_decimals(2);
            if ui.add(field).on_hover_text("speed ([ and ])").changed() {
                time.speed = speed;
            }
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                ui.monospace(format!("{:8.3}", time.time));
                ui.spacing_mut().slider_width = (ui.available_width() - 4.0).max(40.0);
                let [start, end] = time.range;
                let mut t = time.time;
                let slider = egui::Slider::new(&mut t, start..=end.max(start + 1e-9)).show_value(false);
                let slider = ui.add(slider);
                // A slow frame may have the whole of a click, which a slider does not see.
                let clicked = clicked_at(ui, slider.rect);
                if let Some(share) = clicked {
                    t = start + (end - start) * share;
                }
                if slider.changed() || clicked.is_some() {
                    time.playing = false;
                    time.seek(t);
                }
            });
        });
    });
}

/// Where along a slider the pointer was pressed and let go within this frame, 0 to 1.
fn clicked_at(ui: &Ui, slider: egui::Rect) -> Option<f64> {
    let is_click = ui.input(|i| i.pointer.primary_pressed() && i.pointer.primary_released());
    let at = ui.input(|i| i.pointer.interact_pos()).filter(|at| is_click && slider.contains(*at))?;
    // As egui lays sliders out: the handle stays within.
    let inner = slider.x_range().shrink(slider.height() / 2.5);
    Some(f64::from(egui::remap_clamp(at.x, inner, 0.0..=1.0)))
}

fn side_panel(ui: &mut Ui, state: &mut State, info: &Info) {
    let name = if info.model.is_empty() { "no model" } else { &info.model };
    ui.add(egui::Label::new(RichText::new(name).heading()).truncate());
    let faint =
        |ui: &mut Ui, text: String| ui.add(egui::Label::new(RichText::new(text).small().color(FAINT)).truncate());
    faint(ui, format!("{} Gaussians", grouped(info.gaussians as u64)));
    if info.superpoints > 0 {
        faint(ui, format!("{} superpoints, {} key times", grouped(info.superpoints as u64), info.key_times));
    }
    faint(ui, info.device.clone());
    // First, so that a click shows its numbers in small windows too.
    if let Some(selection) = state.selection {
        section(ui, "Selection", |ui| selection_section(ui, state, &selection, info));
    }
    section(ui, "Frame", |ui| frame_section(ui, state, info));
    section(ui, "Show", |ui| show_section(ui, state));
    section(ui, "Quality", |ui| quality_section(ui, &mut state.settings, info));
    section(ui, "Camera", |ui| camera_section(ui, state));
    section(ui, "Save", |ui| save_section(ui, state));
}

fn frame_section(ui: &mut Ui, state: &State, info: &Info) {
    stage_graph(ui, state);
    let mean = state.statistics.mean_stages();
    for ((name, ms), color) in STAGES.iter().zip(mean).zip(STAGE_COLORS) {
        ui.horizontal(|ui| {
            let (square, _) = ui.allocate_exact_size(vec2(9.0, 9.0), Sense::hover());
            ui.painter().rect_filled(square, 2.0, color);
            ui.label(RichText::new(*name).small());
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                ui.label(RichText::new(format!("{ms:.3} ms")).small().monospace());
            });
        });
    }
    row(ui, "device time", format!("{:.3} ms", mean.iter().sum::<f32>()));
    row(ui, "visible", grouped(state.frame.visible.into()));
    row(ui, "tile instances", grouped(state.frame.instances));
    let [w, h] = info.rendered;
    row(ui, "tiles", grouped(u64::from(w.div_ceil(16)) * u64::from(h.div_ceil(16))));
    let m = &info.memory;
    let bytes = m.scene + m.per_gaussian + m.per_instance + m.images;
    row(ui, "device memory", format!("{:.1} MB", bytes as f64 / 1e6));
}

/// Stage times of the latest frames, stacked.
fn stage_graph(ui: &mut Ui, state: &State) {
    let size = vec2(ui.available_width(), 64.0);
    let (area, _) = ui.allocate_exact_size(size, Sense::hover());
    let painter = ui.painter_at(area);
    painter.rect_filled(area, 3.0, Color32::from_rgba_unmultiplied(0, 0, 0, 110));
    let total = |times: &[f32]| times.iter().sum::<f32>();
    let most = state.statistics.history().map(|t| total(t)).fold(0.0_f32, f32::max);
    if most <= 0.0 {
        return;
    }
    let top = nice_above(most);
    let width = area.width() / HISTORY as f32;
    let count = state.statistics.history().count();
    for (i, times) in state.statistics.history().enumerate() {
        let x = area.right() - (count - i) as f32 * width;
        let mut y = area.bottom();
        for (ms, color) in times.iter().zip(STAGE_COLORS) {
            let height = ms / top * area.height();
            let bar = egui::Rect::from_min_max(egui::pos2(x, y - height), egui::pos2(x + width, y));
            painter.rect_filled(bar, 0.0, color);
            y -= height;
        }
    }
    let label = format!("{top} ms");
    painter.text(area.left_top() + vec2(4.0, 2.0), Align2::LEFT_TOP, label, egui::FontId::proportional(10.0), FAINT);
}

/// 1, 2 or 5 times a power of ten, at least `x`.
fn nice_above(x: f32) -> f32 {
    let power = 10_f32.powf(x.log10().floor());
    [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|v| *v >= x).unwrap_or(10.0 * power)
}

fn show_section(ui: &mut Ui, state: &mut State) {
    let settings = &mut state.settings;
    egui::ComboBox::from_id_salt("show").width(ui.available_width()).selected_text(settings.show.name()).show_ui(
        ui,
        |ui| {
            let is_known = |show: Show| show != Show::ExpectedError || state.has_confidence;
            for (i, show) in (1..).zip(Show::ALL).filter(|(_, show)| is_known(*show)) {
                ui.selectable_value(&mut settings.show, show, format!("{}   {i}", show.name()));
            }
        },
    );
    ui.checkbox(&mut settings.centers, "superpoint centres");
    ui.checkbox(&mut settings.paths, "superpoint paths");
    ui.checkbox(&mut settings.frusta, format!("camera frusta ({})", state.cameras.len()));
    ui.horizontal(|ui| {
        ui.label(RichText::new("background").color(FAINT));
        ui.color_edit_button_rgb(&mut settings.background);
    });
}

fn quality_section(ui: &mut Ui, settings: &mut Settings, info: &Info) {
    ui.horizontal(|ui| {
        for (name, preset) in Quality::PRESETS {
            if ui.selectable_label(settings.quality_name == name, name).clicked() {
                settings.quality_name = name;
                settings.quality = Quality { resolution: 1.0, ..preset };
            }
        }
        ui.checkbox(&mut settings.vsync, "vsync");
    });
    ui.horizontal(|ui| {
        ui.spacing_mut().slider_width = 100.0;
        let slider = egui::Slider::new(&mut settings.resolution, 0.125..=1.0).step_by(0.125).show_value(false);
        ui.add(slider);
        let [w, h] = info.rendered;
        ui.label(RichText::new(format!("{w}×{h}")).small().monospace());
    });
    ui.checkbox(&mut settings.adaptive, "fewer pixels while moving");
}

fn camera_section(ui: &mut Ui, state: &mut State) {
    ui.horizontal(|ui| {
        ui.selectable_value(&mut state.navigator.mode, Navigation::Orbit, "orbit");
        ui.selectable_value(&mut state.navigator.mode, Navigation::Fly, "fly");
        if ui.button("everything").on_hover_text("F").clicked() {
            input::frame_everything(state);
        }
    });
    let mut fov = state.navigator.pose.fov_y.to_degrees();
    ui.horizontal(|ui| {
        let slider = egui::Slider::new(&mut fov, 5.0..=120.0).suffix("°").max_decimals(0);
        if ui.add(slider).on_hover_text("vertical field of view").changed() {
            state.navigator.pose.fov_y = fov.to_radians();
        }
    });
    if state.cameras.is_empty() {
        return;
    }
    ui.horizontal(|ui| {
        if ui.button("◀").on_hover_text("Page up").clicked() {
            state.next_camera(-1);
        }
        if ui.button("▶").on_hover_text("Page down").clicked() {
            state.next_camera(1);
        }
        let text = match state.camera.and_then(|i| Some((i, state.cameras.get(i)?))) {
            Some((i, camera)) => format!("{} of {}  {}", i + 1, state.cameras.len(), camera.name),
            None => format!("{} cameras", state.cameras.len()),
        };
        ui.add(egui::Label::new(RichText::new(text).small()).truncate());
    });
}

fn selection_section(ui: &mut Ui, state: &mut State, selection: &Selection, info: &Info) {
    row(ui, "Gaussian", grouped(selection.picked.gaussian.into()));
    if let Some(superpoint) = selection.superpoint {
        row(ui, "superpoint", superpoint.to_string());
    }
    if let Some((count, opacity, scale)) = info.selected {
        if selection.superpoint.is_some() {
            row(ui, "its Gaussians", grouped(count as u64));
        }
        row(ui, "opacity", format!("{opacity:.3}"));
        row(ui, "scale", scale.map(|s| format!("{s:.2e}")).join(" "));
    }
    row(ui, "depth", format!("{:.3}", selection.picked.depth));
    row(ui, "weight in the pixel", format!("{:.3}", selection.picked.weight));
    row(ui, "blended there", selection.picked.blended.to_string());
    if ui.button("nothing").on_hover_text("Esc").clicked() {
        state.selection = None;
    }
}

fn save_section(ui: &mut Ui, state: &mut State) {
    ui.horizontal(|ui| {
        if ui.button("PNG").on_hover_text("F12").clicked() {
            state.requests.push(Request::SavePng);
        }
        if ui.button("EXR").on_hover_text("Shift+F12").clicked() {
            state.requests.push(Request::SaveExr);
        }
        let text = if state.recording.is_some() { "⏹ stop" } else { "⏺ record path" };
        if ui.button(text).on_hover_text("R").clicked() {
            state.requests.push(Request::ToggleRecording);
        }
    });
}

/// The frame rate in the corner, and what goes on.
fn help(context: &Context, state: &mut State) {
    let mut open = true;
    let edits = if state.edit.on { super::editing::input::BINDINGS.as_slice() } else { &[] };
    egui::Window::new("Keys")
        .anchor(Align2::CENTER_CENTER, [0.0, -20.0])
        .collapsible(false)
        .resizable(false)
        .open(&mut open)
        .show(context, |ui| {
            ui.horizontal_top(|ui| {
                for pair in edits.chunks(2).chain(BINDINGS.chunks(2)) {
                    ui.vertical(|ui| pair.iter().for_each(|(title, bindings)| help_group(ui, title, bindings)));
                    ui.add_space(8.0);
                }
            });
        });
    state.settings.help &= open;
}

fn help_group(ui: &mut Ui, title: &str, bindings: &[Binding]) {
    ui.label(RichText::new(title).strong().color(ACCENT));
    egui::Grid::new(title).num_columns(2).spacing([10.0, 2.0]).show(ui, |ui| {
        for binding in bindings {
            ui.label(RichText::new(binding.keys).small().strong());
            ui.label(RichText::new(binding.does).small().color(FAINT));
            ui.end_row();
        }
    });
    ui.add_space(6.0);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_well() {
        assert_eq!((nice_above(0.7), nice_above(12.0), nice_above(5.0)), (1.0, 20.0, 5.0));
    }
}
