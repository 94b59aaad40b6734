//! Keys that are let go under another name than they were pressed under: of `?` the Shift may go first, and what is let go then is
//! `/`. egui would hold `?` for ever, and take the next one for a repeat.

use egui::{Event, Key, Modifiers, RawInput};
use winit::event::ElementState;
use winit::keyboard::PhysicalKey;

/// Keys that are down, and their names when they were pressed.
pub(super) type Held = Vec<(PhysicalKey, Key)>;

/// Follows a key for which the events of `input` from number `first` on have just been added (none for Shift and its like): what
/// was pressed is let go.
pub(super) fn follow(held: &mut Held, input: &mut RawInput, first: usize, physical: PhysicalKey, state: ElementState) {
    let before = held.iter().position(|(p, _)| *p == physical).map(|i| held.swap_remove(i).1);
    let now = input.events.iter().enumerate().skip(first).find_map(|(at, event)| match event {
        Event::Key { key, .. } => Some((at, *key)),
        _ => None,
    });
    if state == ElementState::Pressed {
        held.extend(now.map(|(_, key)| (physical, key)));
    }
    let is_another = |key: &Key| now.is_none_or(|(_, now)| now != *key);
    if let Some(key) = before.filter(is_another) {
        let modifiers = Modifiers::NONE;
        let released = Event::Key { key, physical_key: None, pressed: false, repeat: false, modifiers };
        // Before a press of the same key under another name.
        input.events.insert(now.map_or(input.events.len(), |(at, _)| at), released);
    }
}

#[cfg(test)]
mod tests {
    use winit::keyboard::KeyCode;

    use super::*;

    /// A key in a frame of its own.
    fn add(held: &mut Held, context: &egui::Context, key: Key, pressed: bool) -> Vec<(Key, bool, bool)> {
        let event = Event::Key { key, physical_key: None, pressed, repeat: false, modifiers: Modifiers::NONE };
        let mut input = RawInput { events: vec![event], ..RawInput::default() };
        let state = if pressed { ElementState::Pressed } else { ElementState::Released };
        follow(held, &mut input, 0, PhysicalKey::Code(KeyCode::Slash), state);
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
    fn keys_without_a_name_let_nothing_go() {
        let (mut held, mut input) = (Held::default(), RawInput::default());
        let shift = PhysicalKey::Code(KeyCode::ShiftLeft);
        let modifiers = Modifiers::NONE;
        let event = Event::Key { key: Key::D, physical_key: None, pressed: true, repeat: false, modifiers };
        input.events.push(event);
        follow(&mut held, &mut input, 0, PhysicalKey::Code(KeyCode::KeyD), ElementState::Pressed);
        for state in [ElementState::Pressed, ElementState::Released] {
            follow(&mut held, &mut input, 1, shift, state);
        }
        assert_eq!(input.events.len(), 1, "D stays down");
        assert_eq!(held, [(PhysicalKey::Code(KeyCode::KeyD), Key::D)]);
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
