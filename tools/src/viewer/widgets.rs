//! Pieces of panels.

use egui::{Align, Layout, RichText, Ui};

use super::theme::{ACCENT, FAINT};

/// A part of a panel with a title.
pub(super) fn section(ui: &mut Ui, title: &str, add: impl FnOnce(&mut Ui)) {
    ui.add_space(6.0);
    ui.separator();
    ui.label(RichText::new(title).strong().color(ACCENT));
    add(ui);
}

/// A name and its value.
pub(super) fn row(ui: &mut Ui, name: &str, value: String) {
    ui.horizontal(|ui| {
        ui.label(RichText::new(name).color(FAINT));
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| ui.monospace(value));
    });
}

/// `1 234 567`.
pub(super) fn grouped(n: u64) -> String {
    let digits = n.to_string();
    let mut out = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(' ');
        }
        out.push(digit);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_stand_in_groups() {
        assert_eq!(grouped(0), "0");
        assert_eq!(grouped(1234567), "1 234 567");
    }
}
