//! Keys that are let go under another name than they were pressed under: of `?` the Shift may go first, and what is let go then is
//! `/`. egui would hold `?` for ever, and take the next one for a repeat.

use egui::{Event, Key, Modifiers, RawInput};
use winit::event::ElementState;
use winit::keyboard::PhysicalKey;

/// Keys that are down, and their names when they were pressed.
pub(super) type Held = Vec<(PhysicalKey, Key)>;

/// Follows a key whose event has just been added to `input`: what was pressed is let go.
pub(super) fn follow(held: &mut Held, input: &mut RawInput, physical: PhysicalKey, state: ElementState) {
    let before = held.iter().position(|(p, _)| *p == physical).map(|i| held.swap_remove(i).1);
    let now = match input.events.iter().rev().find(|e| matches!(e, Event::Key { .. })) {
        Some(Event::Key { key, .. }) => Some(*key),
        _ => None,
    };
    if state == ElementState::Pressed {
        held.extend(now.map(|key| (physical, key)));
    }
    if let Some(key) = before.filter(|key| state == ElementState::Released || now != Some(*key)) {
        let modifiers = Modifiers::NONE;
        let released = Event::Key { key, physical_key: None, pressed: false, repeat: false, modifiers };
        // Before a press of the same key under another name.
        let at = input.events.len() - usize::from(state == ElementState::Pressed && !input.events.is_empty());
        input.events.insert(at, released);
    }
}

#[cfg(test)]
mod tests {
    use winit::keyboard::KeyCode;

    use super::*;

    fn add(held: &mut Held, context: &egui::Context, key: Key, pressed: bool) -> Vec<(Key, bool, bool)> {
        let event = Event::Key { key, physical_key: None, pressed, repeat: false, modifiers: Modifiers::NONE };
        let mut input = RawInput { events: vec![event], ..RawInput::default() };
        let state = if pressed { ElementState::Pressed } else { ElementState::Released };
        follow(held, &mut input, PhysicalKey::Code(KeyCode::Slash), state);
        let mut seen = Vec::new();
        let _ = context.run(input, |context| {
            seen = context.input(|i| {
                let keys = i.events.iter().filter_map(|e| match e {
                    Event::Key { key, pressed, repeat, .. } => Some((*key, *pressed, *repeat)),
                    _ => None,
                });
                keys.collect()
            });
        });
        seen
    }

    #[test]
    fn a_key_may_be_let_go_without_its_shift() {
        let (context, mut held) = (egui::Context::default(), Held::default());
        for _ in 0..3 {
            let pressed = add(&mut held, &context, Key::Questionmark, true);
            assert_eq!(pressed, [(Key::Questionmark, true, false)], "not a repeat");
            add(&mut held, &context, Key::Slash, false);
            assert!(!context.input(|i| i.key_down(Key::Questionmark)) && held.is_empty());
        }
        // A key that stays down repeats.
        add(&mut held, &context, Key::Questionmark, true);
        assert_eq!(add(&mut held, &context, Key::Questionmark, true), [(Key::Questionmark, true, true)]);
        // Shift goes, and the key stays down.
        add(&mut held, &context, Key::Slash, true);
        assert!(context.input(|i| i.key_down(Key::Slash) && !i.key_down(Key::Questionmark)));
        add(&mut held, &context, Key::Slash, false);
        assert!(context.input(|i| !i.key_down(Key::Slash)));
    }
}
