//! Pointer and keys in the edit mode.

use egui::{Key, Modifiers, PointerButton};
use glam::{DVec2, DVec3};

use super::gesture::{Gesture, Kind};
use super::gizmo;
use super::mode::{Ask, Tool};
use super::words;
use crate::viewer::overlay::Projection;
use crate::viewer::state::{Binding, Click, Request, State, binding};

/// Shortest side of a rectangle, and step of a lasso, pixels.
const STEP: f64 = 3.0;

/// The edit mode's part of the list of keys.
pub(crate) const BINDINGS: [(&str, &[Binding]); 2] = [
    (
        "Edit",
        &[
            binding("Ctrl+E", "begin / end; S of the camera, R, L, B and H are these:"),
            binding("Click; Shift, Ctrl", "select; add, take away"),
            binding("B, L", "drag rectangles, lassos / clicks again"),
            binding("O", "clicks take what moves alike, too"),
            binding("Ctrl+A, Ctrl+I, Esc", "all, the others, nothing"),
            binding("H, Shift+H, Alt+H", "hide, isolate, show all"),
            binding("G R S, or handles", "move, turn, scale"),
            binding("then X Y Z, a number", "along an axis, by this"),
            binding("Enter, click / Esc", "do it / leave it"),
        ],
    ),
    (
        "Edits",
        &[
            binding("Del, X", "delete"),
            binding("Shift+D", "duplicate and move"),
            binding("Ctrl+Z, Ctrl+Shift+Z", "undo, redo"),
            binding("Ctrl+S", "save model and list of edits"),
            binding("Drop a file", "add it to the scene"),
        ],
    ),
];

pub(crate) fn run(state: &mut State, commands: impl Into<String>) {
    state.requests.push(Request::Edit(Ask::Run(commands.into())));
}

/// Takes the pointer; true when the camera must not have it.
pub(crate) fn pointer(ui: &egui::Ui, response: &egui::Response, clicked: Option<Click>, state: &mut State) -> bool {
    let scale = state.edit.frame.scale;
    let pixel = |p: egui::Pos2| DVec2::new(f64::from(p.x), f64::from(p.y)) * scale;
    let (at, origin) = ui.input(|i| (i.pointer.latest_pos(), i.pointer.press_origin()));
    let Some(at) = at else { return state.edit.gesture.is_some() };
    if state.edit.gesture.is_some() {
        follow_gesture(response, state, pixel(at));
        return true;
    }
    if response.drag_started_by(PointerButton::Primary)
        && let Some(origin) = origin
    {
        if let Some((kind, axis)) = handle(state, origin) {
            start(state, kind, pixel(origin));
            // What turns cannot be scaled along one axis: there a bar scales along all.
            let axis = (kind != Kind::Scale || !state.timeline.moves()).then_some(axis);
            if let Some(gesture) = &mut state.edit.gesture {
                (gesture.axis, gesture.held, gesture.to) = (axis, true, pixel(at));
            }
            return true;
        }
        if state.edit.tool.takes_drags() {
            state.edit.drawn = vec![pixel(origin)];
        }
    }
    if !state.edit.drawn.is_empty() {
        // All of the way: a slow frame may have much of it.
        let moved = |event: &egui::Event| match event {
            egui::Event::PointerMoved(at) => Some(pixel(*at)),
            _ => None,
        };
        let way: Vec<DVec2> = ui.input(|i| i.events.iter().filter_map(moved).collect());
        drag(response, state, &way, modifiers(ui));
        return true;
    }
    if let Some(Click::Single(at)) = clicked {
        click(state, pixel(at), modifiers(ui));
        return true;
    }
    false
}

/// Keys that were held when a button was pressed or let go; by the end of a slow frame they may be up.
pub(super) fn modifiers(ui: &egui::Ui) -> Modifiers {
    let of_button = |event: &egui::Event| match event {
        egui::Event::PointerButton { modifiers, .. } => Some(*modifiers),
        _ => None,
    };
    ui.input(|i| i.events.iter().rev().find_map(of_button).unwrap_or(i.modifiers))
}

/// The handle under a point of the window.
fn handle(state: &State, at: egui::Pos2) -> Option<(Kind, usize)> {
    let center = state.edit.center()?;
    let frame = state.edit.frame;
    let projection = Projection::new(state.view(frame.size), state.navigator.pose.distance, 1.0 / frame.scale);
    gizmo::hit(&projection, state.edit.handles, center, at).map(|axis| (state.edit.handles, axis))
}

fn follow_gesture(response: &egui::Response, state: &mut State, at: DVec2) {
    let Some(gesture) = &mut state.edit.gesture else { return };
    gesture.to = at;
    state.interacting = true;
    let let_go = response.drag_stopped_by(PointerButton::Primary);
    if response.clicked_by(PointerButton::Secondary) {
        state.edit.rest();
    } else if response.clicked_by(PointerButton::Primary) || gesture.held && let_go {
        finish(state);
    }
}

/// A rectangle or a lasso grows along the pointer's way, or is done.
fn drag(response: &egui::Response, state: &mut State, way: &[DVec2], modifiers: Modifiers) {
    let edit = &mut state.edit;
    for &at in way {
        match (edit.tool, edit.drawn.last().copied()) {
            (Tool::Lasso, Some(last)) if last.distance(at) >= STEP => edit.drawn.push(at),
            (Tool::Rectangle, _) => {
                edit.drawn.truncate(1);
                edit.drawn.push(at);
            }
            _ => {}
        }
    }
    state.interacting = true;
    if response.dragged_by(PointerButton::Primary) {
        return;
    }
    let line = std::mem::take(&mut state.edit.drawn);
    let what = match (state.edit.tool, line.as_slice()) {
        (Tool::Rectangle, [a, b]) if (*a - *b).abs().min_element() >= STEP => {
            format!("rect {},{},{},{}", a.x, a.y, b.x, b.y)
        }
        (Tool::Lasso, line) if line.len() > 2 => format!("lasso {}", words::points(line)),
        _ => return,
    };
    pick(state, &what, modifiers);
}

fn click(state: &mut State, at: DVec2, modifiers: Modifiers) {
    let what = match state.edit.tool {
        // The Gaussian on the surface of one pixel.
        Tool::Gaussian => {
            let (x, y) = (at.x.floor(), at.y.floor());
            format!("rect {x},{y},{},{}", x + 1.0, y + 1.0)
        }
        _ => format!("click {},{}", at.x, at.y),
    };
    pick(state, &what, modifiers);
}

fn pick(state: &mut State, what: &str, modifiers: Modifiers) {
    let camera = state.view(state.edit.frame.size);
    let commands = words::pick(&camera, words::verb(modifiers.shift, modifiers.command), what, &state.edit);
    run(state, commands);
}

/// Whether something is selected, or may be when what was asked for is done: keys come faster than frames.
fn may_have_selection(state: &State) -> bool {
    state.edit.selected > 0 || state.requests.iter().any(|request| matches!(request, Request::Edit(_)))
}

/// Begins to move, turn or scale the selection, with the pointer at a pixel.
fn start(state: &mut State, kind: Kind, at: DVec2) {
    let center = state.edit.center().or(may_have_selection(state).then_some(DVec3::ZERO));
    let Some(center) = center else {
        state.say("nothing is selected", false);
        return;
    };
    state.edit.handles = kind;
    state.timeline.playing = false;
    state.edit.gesture =
        Some(Gesture { kind, axis: None, from: at, to: at, typed: String::new(), center, held: false });
}

/// Does what the gesture has come to.
fn finish(state: &mut State) {
    let Some(gesture) = state.edit.gesture.take() else { return };
    let amount = gesture.amount(&state.view(state.edit.frame.size));
    let commands = words::change(&amount, &state.edit, state.timeline.time);
    run(state, commands);
}

/// A key, with the pointer at a point of the window; false when it is not one of the edit mode's.
pub(crate) fn key(key: Key, modifiers: Modifiers, at: Option<egui::Pos2>, state: &mut State) -> bool {
    if state.edit.gesture.is_some() {
        return gesture_key(key, modifiers, state);
    }
    if modifiers.command {
        return command_key(key, modifiers, state);
    }
    let pixel = at.map_or(DVec2::ZERO, |p| DVec2::new(f64::from(p.x), f64::from(p.y)) * state.edit.frame.scale);
    let has_selection = may_have_selection(state);
    let toggled = |tool: Tool, now: Tool| if now == tool { Tool::Superpoint } else { tool };
    match key {
        Key::G => start(state, Kind::Move, pixel),
        Key::R => start(state, Kind::Turn, pixel),
        Key::S => start(state, Kind::Scale, pixel),
        Key::B => state.edit.tool = toggled(Tool::Rectangle, state.edit.tool),
        Key::L => state.edit.tool = toggled(Tool::Lasso, state.edit.tool),
        Key::O => state.edit.goes_on = !state.edit.goes_on,
        Key::Delete | Key::Backspace | Key::X if has_selection => run(state, "delete"),
        Key::D if modifiers.shift && has_selection => {
            run(state, "duplicate");
            start(state, Kind::Move, pixel);
        }
        Key::H if modifiers.alt => run(state, "show"),
        Key::H if modifiers.shift && has_selection => run(state, "isolate"),
        Key::H if has_selection => run(state, "hide"),
        Key::Escape if has_selection => run(state, "select none"),
        // Not the camera's, the recorder's or the panel's.
        Key::Delete | Key::Backspace | Key::X | Key::D | Key::H => {}
        _ => return false,
    }
    true
}

fn command_key(key: Key, modifiers: Modifiers, state: &mut State) -> bool {
    let ask = match key {
        Key::Z if modifiers.shift => Ask::Redo,
        Key::Z => Ask::Undo,
        Key::Y => Ask::Redo,
        Key::S if !modifiers.shift => Ask::Save,
        Key::A if modifiers.shift => Ask::Run("select none".into()),
        Key::A => Ask::Run("select all".into()),
        Key::I if may_have_selection(state) => Ask::Run("invert".into()),
        Key::I => Ask::Run("select all".into()),
        _ => return false,
    };
    state.requests.push(Request::Edit(ask));
    true
}

fn gesture_key(key: Key, modifiers: Modifiers, state: &mut State) -> bool {
    if modifiers.command {
        return false;
    }
    let Some(gesture) = &mut state.edit.gesture else { return false };
    let toggle = |axis: usize, now: Option<usize>| (now != Some(axis)).then_some(axis);
    match key {
        Key::X => gesture.axis = toggle(0, gesture.axis),
        Key::Y => gesture.axis = toggle(1, gesture.axis),
        Key::Z => gesture.axis = toggle(2, gesture.axis),
        Key::G => gesture.kind = Kind::Move,
        Key::R => gesture.kind = Kind::Turn,
        Key::S => gesture.kind = Kind::Scale,
        Key::Minus => match gesture.typed.strip_prefix('-') {
            Some(rest) => gesture.typed = rest.to_owned(),
            None => gesture.typed.insert(0, '-'),
        },
        Key::Backspace => drop(gesture.typed.pop()),
        Key::Period | Key::Comma if !gesture.typed.contains('.') => gesture.typed.push('.'),
        Key::Escape => state.edit.rest(),
        Key::Enter => finish(state),
        key => match digit(key) {
            Some(digit) => gesture.typed.push(digit),
            None => return false,
        },
    }
    true
}

fn digit(key: Key) -> Option<char> {
    const DIGITS: [Key; 10] =
        [Key::Num0, Key::Num1, Key::Num2, Key::Num3, Key::Num4, Key::Num5, Key::Num6, Key::Num7, Key::Num8, Key::Num9];
    let digit = DIGITS.iter().position(|k| *k == key)?;
    char::from_digit(digit as u32, 10)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::viewer::first::test_state;

    /// What comes of keys, with a selection around the origin.
    fn asked(keys: &[(Key, Modifiers)]) -> Vec<Ask> {
        let mut state = test_state();
        let edit = &mut state.edit;
        (edit.on, edit.selected, edit.placed, edit.frame.size) = (true, 2, vec![DVec3::X, DVec3::NEG_X], [640, 480]);
        for (pressed, modifiers) in keys {
            key(*pressed, *modifiers, Some(egui::pos2(300.0, 200.0)), &mut state);
        }
        assert!(state.edit.gesture.is_none(), "{keys:?}");
        let asks = state.requests.into_iter().filter_map(|request| match request {
            Request::Edit(ask) => Some(ask),
            _ => None,
        });
        asks.collect()
    }

    #[test]
    fn keys_become_commands() {
        let plain = |keys: &[Key]| asked(&keys.iter().map(|k| (*k, Modifiers::NONE)).collect::<Vec<_>>());
        let with = |key, modifiers| asked(&[(key, modifiers)]);
        let run = |commands: &str| [Ask::Run(commands.into())];
        use Key::{Enter, Escape, Minus, Num0, Num1, Num5, Num9, Period};
        assert_eq!(plain(&[Key::G, Key::Y, Minus, Period, Num5, Enter]), run("move 0,-0.5,0"));
        assert_eq!(
            plain(&[Key::G, Key::R, Key::X, Key::X, Key::Z, Num9, Num0, Enter]),
            run("rotate z 90 pivot center time 0")
        );
        assert_eq!(
            plain(&[Key::S, Num1, Num5, Key::Backspace, Period, Num5, Enter]),
            run("scale 1.5 pivot center time 0")
        );
        assert_eq!(plain(&[Key::S, Num5, Escape]), []);
        assert_eq!(plain(&[Key::X]), run("delete"));
        assert_eq!(plain(&[Escape]), run("select none"));
        assert_eq!(with(Key::H, Modifiers::ALT), run("show"));
        assert_eq!(with(Key::H, Modifiers::SHIFT), run("isolate"));
        assert_eq!(with(Key::I, Modifiers::COMMAND), run("invert"));
        assert_eq!(with(Key::Z, Modifiers::COMMAND), [Ask::Undo]);
        assert_eq!(with(Key::Z, Modifiers::COMMAND | Modifiers::SHIFT), [Ask::Redo]);
        assert_eq!(with(Key::S, Modifiers::COMMAND), [Ask::Save]);
    }

    #[test]
    fn the_viewers_other_keys_stay() {
        for other in [Key::Space, Key::F12, Key::Num1, Key::ArrowLeft, Key::F, Key::K, Key::Questionmark] {
            let mut state = test_state();
            state.edit.on = true;
            assert!(!key(other, Modifiers::NONE, None, &mut state), "{other:?}");
        }
        let mut state = test_state();
        assert!(!key(Key::Q, Modifiers::COMMAND, None, &mut state));
        // Nothing is selected: nothing begins.
        assert!(key(Key::G, Modifiers::NONE, None, &mut state) && state.edit.gesture.is_none());
    }
}
