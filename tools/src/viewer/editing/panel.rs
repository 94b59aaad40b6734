//! The panel of the edit mode: tools, ways to select, changes, named selections and the list of edits.

use egui::{DragValue, RichText, TextEdit, Ui};

use super::gesture::Kind;
use super::input::{modifiers, run};
use super::mode::{Ask, Holds, Reach, Tool};
use super::words::{self, quoted};
use crate::viewer::state::{Request, State};
use crate::viewer::theme::FAINT;
use crate::viewer::widgets::{grouped, row, section};

/// Rows of the list of edits that are seen at once.
const ROWS: f32 = 9.0;

/// Draws it; `gaussians` is their number.
pub(crate) fn draw(ui: &mut Ui, state: &mut State, gaussians: usize) {
    ui.horizontal(|ui| {
        ui.label(RichText::new("Edit").heading());
        if ui.button("done").on_hover_text("Ctrl+E").clicked() {
            state.requests.push(Request::Edit(Ask::Toggle));
        }
    });
    row(ui, "selected", format!("{} of {}", grouped(state.edit.selected as u64), grouped(gaussians as u64)));
    // Always: what is below would move under the pointer otherwise.
    row(ui, "hidden, locked", format!("{}, {}", state.edit.hidden, state.edit.locked));
    section(ui, "Select", |ui| tools(ui, state));
    egui::CollapsingHeader::new("select by …").id_salt("by").show(ui, |ui| properties(ui, state));
    section(ui, "Selections", |ui| names(ui, state));
    section(ui, "Change", |ui| changes(ui, state));
    section(ui, "Edits", |ui| edits(ui, state));
    section(ui, "Save", |ui| save(ui, state));
}

/// A button that runs commands.
fn button(ui: &mut Ui, state: &mut State, text: &str, hint: &str, commands: &str) {
    if ui.button(text).on_hover_text(hint).clicked() {
        run(state, commands);
    }
}

fn number(ui: &mut Ui, value: &mut f64, speed: f64, hint: &str) {
    let field = DragValue::new(value).speed(speed).range(0.0..=f64::INFINITY).max_decimals(4);
    ui.add(field).on_hover_text(hint);
}

fn tools(ui: &mut Ui, state: &mut State) {
    let edit = &mut state.edit;
    ui.horizontal(|ui| {
        for (tool, name, hint) in Tool::ALL {
            ui.selectable_value(&mut edit.tool, tool, name).on_hover_text(hint);
        }
    });
    ui.horizontal(|ui| {
        ui.selectable_value(&mut edit.reach, Reach::Surface, "surface");
        ui.selectable_value(&mut edit.reach, Reach::Depth, "to");
        number(ui, &mut edit.form.depth, 0.01, "behind the surface, world units");
        ui.selectable_value(&mut edit.reach, Reach::Through, "through");
    });
    ui.horizontal(|ui| {
        ui.checkbox(&mut edit.goes_on, "and what moves alike,").on_hover_text("O");
        number(ui, &mut edit.form.similar, 0.05, "pixels off one rigid motion");
        ui.label("px");
    });
    ui.horizontal(|ui| {
        button(ui, state, "all", "Ctrl+A", "select all");
        button(ui, state, "none", "Esc", "select none");
        button(ui, state, "invert", "Ctrl+I", if state.edit.selected > 0 { "invert" } else { "select all" });
        let commands = format!("grow {} time {}", state.edit.form.grow, state.timeline.time);
        button(ui, state, "grow", "adds what is near", &commands);
        number(ui, &mut state.edit.form.grow, 0.005, "world units");
    });
    ui.horizontal(|ui| {
        button(ui, state, "hide", "H", "hide");
        button(ui, state, "isolate", "Shift+H", "isolate");
        button(ui, state, "show", "Alt+H: everything", "show");
        button(ui, state, "lock", "cannot be selected then", "lock");
        button(ui, state, "unlock", "everything", "unlock");
    });
}

/// Ways to select without the pointer. Shift adds, Ctrl takes away.
fn properties(ui: &mut Ui, state: &mut State) {
    let modifiers = modifiers(ui);
    let verb = words::verb(modifiers.shift, modifiers.command);
    let time = state.timeline.time;
    let form = &mut state.edit.form;
    ui.horizontal(|ui| {
        form.center.iter_mut().for_each(|v| drop(ui.add(DragValue::new(v).speed(0.01).max_decimals(3))));
        number(ui, &mut form.radius, 0.01, "radius, or half the side");
    });
    let (center, r) = (glam::DVec3::from_array(form.center), form.radius);
    let sphere = format!("{verb} sphere {} {r} time {time}", words::vector(center));
    let cube = format!("{verb} box {} {} time {time}", words::vector(center - r), words::vector(center + r));
    ui.horizontal(|ui| {
        button(ui, state, "sphere", "centres within it", &sphere);
        button(ui, state, "box", "centres within it", &cube);
        if ui.button("here").on_hover_text("the selection's centre").clicked()
            && let Some(center) = state.edit.center()
        {
            state.edit.form.center = center.to_array();
        }
    });
    let form = &mut state.edit.form;
    let below = |ui: &mut Ui, name: &str, value: &mut f64, hint: &str| -> Option<String> {
        ui.horizontal(|ui| {
            ui.label(RichText::new(name).color(FAINT));
            number(ui, value, 0.005, hint);
            ["below", "above"].iter().find(|side| ui.button(**side).clicked()).map(|side| format!("{side} {value}"))
        })
        .inner
    };
    let opacity = below(ui, "opacity", &mut form.opacity, "0 to 1").map(|limit| format!("{verb} opacity {limit}"));
    let size = below(ui, "size", &mut form.size, "largest standard deviation, world units");
    let size = size.map(|limit| format!("{verb} size {limit}"));
    let color = ui.horizontal(|ui| {
        ui.color_edit_button_rgb(&mut form.color);
        number(ui, &mut form.within, 0.01, "distance in RGB from 0 to 1");
        ui.button("colour").clicked()
    });
    let color = color.inner.then(|| format!("{verb} color {} within {}", words::color(form.color), form.within));
    let floaters = ui.horizontal(|ui| {
        number(ui, &mut form.floaters, 0.01, "distance from a camera of --data");
        ui.button("floaters").clicked()
    });
    let floaters = floaters.inner.then(|| format!("{verb} floaters {} time {time}", form.floaters));
    [opacity, size, color, floaters].into_iter().flatten().for_each(|commands| run(state, commands));
}

fn names(ui: &mut Ui, state: &mut State) {
    for name in state.edit.names.clone() {
        let Some(word) = quoted(&name.name) else { continue };
        ui.horizontal(|ui| {
            let [eye, lock] = [if name.hidden { "–" } else { "👁" }, if name.locked { "🔒" } else { "🔓" }];
            let seen = if name.hidden { "show" } else { "hide" };
            button(ui, state, eye, seen, &format!("{seen} named {word}"));
            let held = if name.locked { "unlock" } else { "lock" };
            button(ui, state, lock, held, &format!("{held} named {word}"));
            let modifiers = modifiers(ui);
            let verb = words::verb(modifiers.shift, modifiers.command);
            let label = ui.selectable_label(false, &name.name);
            if label.on_hover_text("select; Shift adds, Ctrl takes away").clicked() {
                run(state, format!("{verb} named {word}"));
            }
            ui.label(RichText::new(grouped(name.count as u64)).small().color(FAINT));
        });
    }
    ui.horizontal(|ui| {
        ui.add(TextEdit::singleline(&mut state.edit.form.name).hint_text("name").desired_width(120.0));
        let word = quoted(state.edit.form.name.trim()).filter(|_| state.edit.selected > 0);
        if ui.add_enabled(word.is_some(), egui::Button::new("name it")).clicked()
            && let Some(word) = word
        {
            run(state, format!("name {word}"));
        }
    });
}

fn changes(ui: &mut Ui, state: &mut State) {
    let edit = &mut state.edit;
    ui.horizontal(|ui| {
        ui.label(RichText::new("handles").color(FAINT));
        ui.selectable_value(&mut edit.handles, Kind::Move, "move").on_hover_text("G");
        ui.selectable_value(&mut edit.handles, Kind::Turn, "turn").on_hover_text("R");
        ui.selectable_value(&mut edit.handles, Kind::Scale, "scale").on_hover_text("S");
    });
    ui.horizontal(|ui| {
        ui.selectable_value(&mut edit.holds, Holds::Always, "always").on_hover_text("in the world, at all times");
        ui.selectable_value(&mut edit.holds, Holds::Part, "along").on_hover_text("along with its motion");
        ui.selectable_value(&mut edit.holds, Holds::During, "during").on_hover_text("for a while only");
    });
    if edit.holds == Holds::During {
        ui.horizontal(|ui| {
            for (value, hint) in edit.form.during.iter_mut().zip(["from", "to", "the way there and back"]) {
                ui.add(DragValue::new(value).speed(0.01).max_decimals(3)).on_hover_text(hint);
            }
        });
    }
    let time = state.timeline.time;
    ui.horizontal(|ui| {
        button(ui, state, "delete", "Del", "delete");
        button(ui, state, "duplicate", "Shift+D", "duplicate");
        button(ui, state, "freeze", "as it is now, always", &format!("freeze {time}"));
        button(ui, state, "reverse", "backwards in time", "time reverse");
    });
    ui.horizontal(|ui| {
        ui.color_edit_button_rgb(&mut state.edit.form.tint);
        number(ui, &mut state.edit.form.gain, 0.01, "how much brighter");
        let (tint, gain) = (words::color(state.edit.form.tint), state.edit.form.gain);
        button(ui, state, "tint", "keeps brightness, changes hue", &format!("recolor tint {tint} gain {gain}"));
        button(ui, state, "brighten", "keeps hue", &format!("recolor gain {gain}"));
    });
    ui.horizontal(|ui| {
        ui.add(TextEdit::singleline(&mut state.edit.form.merge).hint_text("another model").desired_width(150.0));
        let word = quoted(state.edit.form.merge.trim());
        if ui.add_enabled(word.is_some(), egui::Button::new("add")).on_hover_text("or drop a file").clicked()
            && let Some(word) = word
        {
            run(state, format!("merge {word}"));
        }
    });
}

fn edits(ui: &mut Ui, state: &mut State) {
    ui.horizontal(|ui| {
        for (text, hint, ask) in [("undo", "Ctrl+Z", Ask::Undo), ("redo", "Ctrl+Shift+Z", Ask::Redo)] {
            let any = if ask == Ask::Undo { state.edit.done > 0 } else { state.edit.done < state.edit.list.len() };
            if ui.add_enabled(any, egui::Button::new(text)).on_hover_text(hint).clicked() {
                state.requests.push(Request::Edit(ask));
            }
        }
    });
    let height = ui.text_style_height(&egui::TextStyle::Small);
    let edit = &state.edit;
    let area = egui::ScrollArea::vertical().id_salt("edits").max_height(ROWS * (height + 4.0)).stick_to_bottom(true);
    area.auto_shrink([false, true]).show_rows(ui, height, edit.list.len(), |ui, rows| {
        for k in rows {
            let text = RichText::new(format!("{}  {}", k + 1, edit.list[k])).small();
            let text = if k < edit.done { text } else { text.color(FAINT).strikethrough() };
            ui.add(egui::Label::new(text).truncate()).on_hover_text(&edit.list[k]);
        }
    });
    let field = TextEdit::singleline(&mut state.edit.form.command).hint_text("a command (spgs help editing)");
    let field = ui.add(field.desired_width(f32::INFINITY));
    if field.lost_focus() && ui.input(|i| i.key_pressed(egui::Key::Enter)) {
        let commands = std::mem::take(&mut state.edit.form.command);
        run(state, commands);
    }
}

fn save(ui: &mut Ui, state: &mut State) {
    ui.add(TextEdit::singleline(&mut state.edit.form.file).desired_width(f32::INFINITY));
    ui.horizontal(|ui| {
        if ui.button("save").on_hover_text("Ctrl+S: the model, and the list of edits beside it").clicked() {
            state.requests.push(Request::Edit(Ask::Save));
        }
        if state.edit.unsaved {
            ui.label(RichText::new("not saved yet").small().color(FAINT));
        }
    });
}
