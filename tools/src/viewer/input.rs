//! Mouse, trackpad and keys. Everything comes through egui, so that the interface takes what is meant for it.

use egui::{Key, Modifiers, PointerButton};
use engine::scene::Camera;
use glam::DVec3;

use super::editing::input as editing;
use super::editing::mode::Ask;
use super::navigator::{Navigation, Thrust};
use super::state::{Binding, Click, Request, Show, State, binding};

/// How far apart the clicks of a double click may be, points.
const DOUBLE_CLICK_REACH: f32 = 6.0;

/// The list of keys that `?` shows, in groups.
pub(super) const BINDINGS: [(&str, &[Binding]); 4] = [
    (
        "Camera",
        &[
            binding("Left / middle drag", "orbit (fly: look around)"),
            binding("Right drag, Shift+drag", "pan"),
            binding("Wheel, Ctrl+drag, pinch", "zoom (fly: speed)"),
            binding("Two fingers", "orbit; with Shift pan, with Ctrl zoom"),
            binding("W A S D  Q E", "move; Shift: faster"),
            binding("Tab", "orbit / fly"),
            binding("Double click, F", "look at the point / everything"),
            binding("Numpad 1 3 7 9", "front, right, top, opposite"),
            binding("Page up / down", "cameras of the data set"),
            binding("U", "another direction is up"),
        ],
    ),
    (
        "Time",
        &[
            binding("Space", "play / pause"),
            binding("Left / right", "step; Shift: ten steps"),
            binding("Home / End", "start / end"),
            binding("[  ]", "slower / faster"),
            binding("L", "loop, ping-pong, once"),
        ],
    ),
    (
        "Show",
        &[
            binding("1 2 3 4 5 6", "colour, depth, opacity, tiles, superpoints, expected error"),
            binding("C  P  K", "superpoint centres, their paths, camera frusta"),
            binding("Click, Esc", "select a Gaussian's superpoint / nothing"),
            binding("B", "background"),
            binding("- / +", "resolution"),
            binding("H", "panel"),
        ],
    ),
    (
        "File",
        &[
            binding("F12, Ctrl+S", "save a PNG; with Shift an EXR"),
            binding("R", "start / stop recording the camera's path"),
            binding("Drop a file", "open it"),
            binding("Ctrl+E", "edit"),
            binding("Ctrl+Q", "quit"),
            binding("?, F1", "this list"),
        ],
    ),
];

/// Applies what was done to the scene's part of the window; `height` of the window in points. Returns the keys held.
pub(super) fn scene_input(ui: &egui::Ui, response: &egui::Response, state: &mut State) -> Thrust {
    let height = f64::from(response.rect.height());
    let modifiers = ui.input(|i| i.modifiers);
    // A drag has moved in the frame of its release too.
    let delta = ui.input(|i| i.pointer.delta());
    let delta = [f64::from(delta.x), f64::from(delta.y)];
    let found = click(ui, response, state);
    state.clicks.extend(found);
    // The edit mode begins and ends between two frames: a click that came after Ctrl+E waits for that.
    let click = if edit_mode_changes_before_click(ui) { None } else { state.clicks.pop_front() };
    if !state.clicks.is_empty() {
        ui.ctx().request_repaint();
    }
    let is_taken = state.edit.on && editing::pointer(ui, response, click, state);
    if !is_taken {
        move_camera(response, state, delta, height, modifiers);
    }
    match click {
        Some(Click::Double(at)) => state.requests.push(Request::Pick([at.x, at.y], true)),
        Some(Click::Single(at)) if !state.edit.on => state.requests.push(Request::Pick([at.x, at.y], false)),
        _ => {}
    }
    if response.hovered() {
        scroll(ui, state, height);
    }
    // The time line, or a slider, counts as well.
    state.interacting |= response.dragged() || ui.ctx().is_using_pointer();
    // A slow frame may have what was typed into a field, and the Enter that ended it: neither is for the scene.
    let typing = ui.ctx().wants_keyboard_input();
    let was_typing = std::mem::replace(&mut state.typing, typing);
    if typing || was_typing { Thrust::default() } else { keys(ui.ctx(), state) }
}

/// Whether Ctrl+E was pressed in this frame before the button was let go.
fn edit_mode_changes_before_click(ui: &egui::Ui) -> bool {
    let is_toggle = |event: &egui::Event| match event {
        egui::Event::Key { key: Key::E, pressed: true, repeat: false, modifiers, .. } => modifiers.command,
        _ => false,
    };
    let lets_go = |event: &egui::Event| {
        matches!(event, egui::Event::PointerButton { button: PointerButton::Primary, pressed: false, .. })
    };
    ui.input(|i| {
        let end = i.events.iter().rposition(lets_go).unwrap_or(0);
        i.events[..end].iter().any(is_toggle)
    })
}

/// The click that ended in this frame. For egui two quick clicks are a double click wherever they are: here at one place only.
fn click(ui: &egui::Ui, response: &egui::Response, state: &mut State) -> Option<Click> {
    let pointer = response.interact_pointer_pos().filter(|_| response.clicked())?;
    let let_go = |event: &egui::Event| match event {
        egui::Event::PointerButton { pos, button: PointerButton::Primary, pressed: false, .. } => Some(*pos),
        _ => None,
    };
    // A slow frame may have both clicks, and the way of the pointer after them.
    let [end, in_frame] = ui.input(|i| {
        let mut ends = i.events.iter().rev().filter_map(let_go);
        [ends.next(), ends.next()]
    });
    let at = end.unwrap_or(pointer);
    let last = state.clicked.replace(at);
    let before = in_frame.or(last);
    let is_quick = response.double_clicked() || response.triple_clicked();
    let is_double = is_quick && before.is_some_and(|b| b.distance(at) <= DOUBLE_CLICK_REACH);
    Some(if is_double { Click::Double(at) } else { Click::Single(at) })
}

fn move_camera(response: &egui::Response, state: &mut State, delta: [f64; 2], height: f64, modifiers: Modifiers) {
    let by = |button| response.dragged_by(button) || response.drag_stopped_by(button);
    if by(PointerButton::Secondary) || (by(PointerButton::Primary) || by(PointerButton::Middle)) && modifiers.shift {
        state.navigator.drag_pan(delta, height);
    } else if (by(PointerButton::Primary) || by(PointerButton::Middle)) && modifiers.command {
        state.navigator.drag_zoom(delta, height);
    } else if by(PointerButton::Primary) || by(PointerButton::Middle) {
        state.navigator.drag_turn(delta, height);
    }
}

fn scroll(ui: &egui::Ui, state: &mut State, height: f64) {
    ui.input(|input| {
        let pinch = f64::from(input.zoom_delta());
        let mut scrolled = false;
        for event in &input.events {
            let egui::Event::MouseWheel { unit, delta, modifiers, .. } = event else { continue };
            let delta = [f64::from(delta.x), f64::from(delta.y)];
            match unit {
                egui::MouseWheelUnit::Point => state.navigator.swipe(delta, height, modifiers.shift, modifiers.command),
                _ => state.navigator.wheel(delta[1]),
            }
            scrolled = true;
        }
        state.interacting |= scrolled || pinch != 1.0;
        // egui makes a pinch of the wheel with Ctrl too.
        if pinch != 1.0 && !scrolled {
            state.navigator.zoom(8.0 * pinch.ln());
        }
    });
}

/// Keys that do one thing when they are pressed, then those that are held.
fn keys(context: &egui::Context, state: &mut State) -> Thrust {
    let pressed: Vec<(Key, Modifiers)> = context.input(|input| {
        let key = |e: &egui::Event| match e {
            egui::Event::Key { key, pressed: true, modifiers, repeat, .. } if !repeat || repeats(*key) => {
                Some((*key, *modifiers))
            }
            _ => None,
        };
        input.events.iter().filter_map(key).collect()
    });
    state.shortcuts.extend(pressed.iter().filter(|(_, modifiers)| modifiers.command).map(|(key, _)| *key));
    state.shortcuts.retain(|key| context.input(|input| input.key_down(*key)));
    let at = context.input(|input| input.pointer.latest_pos());
    for (key, modifiers) in pressed {
        if !(is_editing(state) && editing::key(key, modifiers, at, state)) {
            press(key, modifiers, state);
        }
    }
    context.input(|input| {
        // In the edit mode these keys have other work.
        if input.modifiers.command || state.edit.on {
            return Thrust::default();
        }
        let is_held = |key: Key| f64::from(input.key_down(key) && !state.shortcuts.contains(&key));
        let axis = |plus: Key, minus: Key| is_held(plus) - is_held(minus);
        let direction = DVec3::new(axis(Key::D, Key::A), axis(Key::Q, Key::E), axis(Key::W, Key::S));
        Thrust { direction, fast: input.modifiers.shift }
    })
}

/// Whether keys are the edit mode's: it may have been asked for in this frame.
fn is_editing(state: &State) -> bool {
    let toggles = state.requests.iter().filter(|request| **request == Request::Edit(Ask::Toggle)).count();
    state.edit.on != (toggles % 2 == 1)
}

fn repeats(key: Key) -> bool {
    matches!(key, Key::ArrowLeft | Key::ArrowRight | Key::PageUp | Key::PageDown)
}

/// One key.
pub(super) fn press(key: Key, modifiers: Modifiers, state: &mut State) {
    if modifiers.command {
        match key {
            Key::S if modifiers.shift => state.requests.push(Request::SaveExr),
            Key::S => state.requests.push(Request::SavePng),
            Key::E => state.requests.push(Request::Edit(Ask::Toggle)),
            Key::Q => state.requests.push(Request::Quit),
            _ => {}
        }
        return;
    }
    time_key(key, modifiers, state);
    let settings = &mut state.settings;
    match key {
        Key::Tab => toggle_navigation(state),
        Key::F => frame_everything(state),
        Key::PageUp => state.next_camera(-1),
        Key::PageDown => state.next_camera(1),
        Key::U => cycle_up(state),
        Key::Num1 => settings.show = Show::Color,
        Key::Num2 => settings.show = Show::Depth,
        Key::Num3 => settings.show = Show::Opacity,
        Key::Num4 => settings.show = Show::Tiles,
        Key::Num5 => settings.show = Show::Superpoints,
        Key::Num6 => state.show_expected_error(),
        Key::C => settings.centers = !settings.centers,
        Key::P => settings.paths = !settings.paths,
        Key::K => settings.frusta = !settings.frusta,
        Key::B => state.cycle_background(),
        Key::Minus => settings.resolution = (settings.resolution - 0.125).max(0.125),
        Key::Plus | Key::Equals => settings.resolution = (settings.resolution + 0.125).min(1.0),
        Key::H => settings.panel = !settings.panel,
        Key::Questionmark | Key::F1 => settings.help = !settings.help,
        Key::Slash if modifiers.shift => settings.help = !settings.help,
        Key::Escape => {
            settings.help = false;
            state.selection = None;
        }
        Key::R => state.requests.push(Request::ToggleRecording),
        Key::F12 if modifiers.shift => state.requests.push(Request::SaveExr),
        Key::F12 => state.requests.push(Request::SavePng),
        _ => {}
    }
}

fn time_key(key: Key, modifiers: Modifiers, state: &mut State) {
    let timeline = &mut state.timeline;
    let steps = if modifiers.shift { 10.0 } else { 1.0 };
    match key {
        Key::Space => timeline.toggle(),
        Key::ArrowLeft => timeline.step(-steps),
        Key::ArrowRight => timeline.step(steps),
        Key::Home => timeline.seek(timeline.range[0]),
        Key::End => timeline.seek(timeline.range[1]),
        Key::OpenBracket => timeline.faster(0.5),
        Key::CloseBracket => timeline.faster(2.0),
        Key::L => timeline.repeat = timeline.repeat.next(),
        _ => {}
    }
}

fn toggle_navigation(state: &mut State) {
    let mode = match state.navigator.mode {
        Navigation::Orbit => Navigation::Fly,
        Navigation::Fly => Navigation::Orbit,
    };
    state.navigator.mode = mode;
    state.say(if mode == Navigation::Fly { "fly" } else { "orbit" }, false);
}

/// The whole scene, from the direction that the camera looks in.
pub(super) fn frame_everything(state: &mut State) {
    let pose = state.framing();
    state.navigator.glide_to(pose);
}

/// The numpad's views, as in Blender: along axes that stand upright on the world's up.
pub(super) fn numpad(number: u32, state: &mut State) {
    let up = state.navigator.up;
    let upright = Camera::look_at(DVec3::ZERO, up.any_orthonormal_vector(), up, 1.0, [2, 2]).rotation.transpose();
    let direction = match number {
        1 => upright.z_axis,
        3 => -upright.x_axis,
        7 => -up,
        9 => -state.navigator.pose.forward(),
        _ => return,
    };
    let pose = state.navigator.looking(direction);
    state.navigator.glide_to(pose);
}

fn cycle_up(state: &mut State) {
    const UPS: [(DVec3, &str); 4] = [(DVec3::NEG_Y, "−y"), (DVec3::Z, "+z"), (DVec3::Y, "+y"), (DVec3::NEG_Z, "−z")];
    let at = UPS.iter().position(|(u, _)| *u == state.navigator.up);
    let (up, name) = UPS[at.map_or(0, |i| (i + 1) % UPS.len())];
    state.navigator.set_up(up);
    state.say(format!("up is {name}"), false);
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]
    use egui::{Event, MouseWheelUnit, PointerButton, Pos2, RawInput, Rect, pos2, vec2};

    use super::*;
    use crate::viewer::first::test_state as state;

    /// One frame of an interface that is only the scene.
    fn frame(context: &egui::Context, state: &mut State, modifiers: Modifiers, events: Vec<Event>) -> Thrust {
        let screen_rect = Some(Rect::from_min_size(Pos2::ZERO, vec2(640.0, 480.0)));
        let input = RawInput { screen_rect, modifiers, events, ..RawInput::default() };
        let mut thrust = Thrust::default();
        let _ = context.run(input, |context| {
            egui::CentralPanel::default().frame(egui::Frame::NONE).show(context, |ui| {
                let response = ui.interact(ui.max_rect(), ui.id().with("scene"), egui::Sense::click_and_drag());
                thrust = scene_input(ui, &response, state);
            });
        });
        thrust
    }

    fn drag(state: &mut State, button: PointerButton, modifiers: Modifiers) {
        let context = egui::Context::default();
        let press = |pos, pressed| Event::PointerButton { pos, button, pressed, modifiers };
        let (from, to) = (pos2(300.0, 200.0), pos2(340.0, 215.0));
        frame(&context, state, modifiers, vec![Event::PointerMoved(from)]);
        frame(&context, state, modifiers, vec![press(from, true)]);
        frame(&context, state, modifiers, vec![Event::PointerMoved(to)]);
        frame(&context, state, modifiers, vec![press(to, false)]);
    }

    fn key(key: Key, pressed: bool) -> Event {
        Event::Key { key, physical_key: None, pressed, repeat: false, modifiers: Modifiers::NONE }
    }

    #[test]
    fn drags_orbit_pan_and_zoom() {
        let before = state().navigator.pose;
        let after = |button, modifiers| {
            let mut state = state();
            drag(&mut state, button, modifiers);
            state.navigator.pose
        };
        for button in [PointerButton::Primary, PointerButton::Middle] {
            let orbit = after(button, Modifiers::NONE);
            assert!(orbit.rotation != before.rotation && orbit.target == before.target);
            let pan = after(button, Modifiers::SHIFT);
            assert!(pan.rotation == before.rotation && pan.target != before.target);
            let zoom = after(button, Modifiers::COMMAND);
            assert!(zoom.rotation == before.rotation && zoom.distance != before.distance);
        }
        let pan = after(PointerButton::Secondary, Modifiers::NONE);
        assert!(pan.rotation == before.rotation && pan.target != before.target);
    }

    #[test]
    fn a_wheel_zooms_and_two_fingers_turn() {
        let context = egui::Context::default();
        let wheel = |unit, modifiers| {
            let mut state = state();
            let over = vec![Event::PointerMoved(pos2(300.0, 200.0))];
            frame(&context, &mut state, modifiers, over);
            let event = Event::MouseWheel { unit, delta: vec2(3.0, 2.0), modifiers };
            frame(&context, &mut state, modifiers, vec![event]);
            state.navigator.pose
        };
        let before = state().navigator.pose;
        assert!(wheel(MouseWheelUnit::Line, Modifiers::NONE).distance < before.distance);
        let turned = wheel(MouseWheelUnit::Point, Modifiers::NONE);
        assert!(turned.rotation != before.rotation && turned.distance == before.distance);
        assert!(wheel(MouseWheelUnit::Point, Modifiers::SHIFT).target != before.target);
        assert!(wheel(MouseWheelUnit::Point, Modifiers::COMMAND).distance < before.distance);
    }

    #[test]
    fn keys_are_held_or_pressed_once() {
        let (context, mut state) = (egui::Context::default(), state());
        let none = Modifiers::NONE;
        let thrust = frame(&context, &mut state, none, vec![key(Key::W, true), key(Key::E, true)]);
        assert_eq!(thrust.direction, DVec3::new(0.0, -1.0, 1.0));
        assert_eq!(frame(&context, &mut state, none, vec![]).direction, DVec3::new(0.0, -1.0, 1.0));
        let released = vec![key(Key::W, false), key(Key::E, false)];
        assert_eq!(frame(&context, &mut state, none, released).direction, DVec3::ZERO);
        // Ctrl may be let go first.
        let mut with_ctrl = key(Key::E, true);
        if let Event::Key { modifiers, .. } = &mut with_ctrl {
            *modifiers = Modifiers::COMMAND;
        }
        for events in [vec![with_ctrl], vec![], vec![key(Key::E, false)]] {
            assert_eq!(frame(&context, &mut state, none, events).direction, DVec3::ZERO);
        }
        assert_eq!(frame(&context, &mut state, none, vec![key(Key::E, true)]).direction, DVec3::NEG_Y);
        frame(&context, &mut state, none, vec![key(Key::E, false)]);
        frame(&context, &mut state, none, vec![key(Key::Num4, true), key(Key::K, true)]);
        assert!(state.settings.show == Show::Tiles && state.settings.frusta);
        frame(&context, &mut state, none, vec![]);
        assert!(state.settings.frusta, "a key is pressed once");
    }

    #[test]
    fn every_listed_key_does_something() {
        let all: Vec<Key> = vec![
            Key::F,
            Key::PageDown,
            Key::U,
            Key::Tab,
            Key::Num2,
            Key::C,
            Key::P,
            Key::K,
            Key::B,
            Key::Minus,
            Key::H,
            Key::Questionmark,
            Key::F1,
            Key::R,
            Key::F12,
            Key::OpenBracket,
            Key::CloseBracket,
            Key::L,
        ];
        for key in all {
            let (before, mut after) = (state(), state());
            press(key, Modifiers::NONE, &mut after);
            assert_ne!(format!("{before:?}"), format!("{after:?}"), "{key:?}");
        }
        let mut quits = state();
        press(Key::Q, Modifiers::COMMAND, &mut quits);
        press(Key::E, Modifiers::COMMAND, &mut quits);
        assert_eq!(quits.requests, [Request::Quit, Request::Edit(Ask::Toggle)]);
    }

    #[test]
    fn a_click_right_after_ctrl_e_is_the_edit_mode_s() {
        let context = egui::Context::default();
        let mut state = state();
        let at = pos2(300.0, 200.0);
        let button = |pressed| Event::PointerButton {
            pos: at,
            button: PointerButton::Primary,
            pressed,
            modifiers: Modifiers::NONE,
        };
        let toggle =
            Event::Key { key: Key::E, physical_key: None, pressed: true, repeat: false, modifiers: Modifiers::COMMAND };
        frame(&context, &mut state, Modifiers::NONE, vec![Event::PointerMoved(at)]);
        frame(&context, &mut state, Modifiers::NONE, vec![toggle, button(true), button(false)]);
        assert_eq!(std::mem::take(&mut state.requests), [Request::Edit(Ask::Toggle)], "the click waits");
        state.edit.on = true;
        frame(&context, &mut state, Modifiers::NONE, vec![]);
        let [Request::Edit(Ask::Run(commands))] = state.requests.as_slice() else { panic!("{:?}", state.requests) };
        assert!(commands.contains("click 300"), "{commands}");
    }

    #[test]
    fn numpad_views_look_along_upright_axes() {
        for number in [1, 3, 7, 9] {
            let mut state = state();
            numpad(number, &mut state);
            let goal = state.navigator.goal();
            let along = goal.forward().dot(state.navigator.up).abs();
            assert!(if number == 7 { along > 0.999 } else { along < 0.999 });
            assert!(goal.target.distance(state.navigator.pose.target) < 1e-9);
        }
    }
}
