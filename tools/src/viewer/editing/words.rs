//! Commands of the language of edits, as text. Numbers print as what reads back as the same ones.

use engine::scene::Camera;
use glam::DVec3;

use super::gesture::Amount;
use super::mode::{EditMode, Holds, Reach};

/// Which word a selection begins with, from the keys that are held.
pub(crate) fn verb(shift: bool, command: bool) -> &'static str {
    match (shift, command) {
        (true, true) => "intersect",
        (true, false) => "add",
        (false, true) => "subtract",
        (false, false) => "select",
    }
}

fn list(values: impl IntoIterator<Item = f64>) -> String {
    values.into_iter().map(|v| v.to_string()).collect::<Vec<_>>().join(",")
}

pub(crate) fn vector(v: DVec3) -> String {
    list(v.to_array())
}

/// `#ff8800` of red, green and blue from 0 to 1.
pub(crate) fn color(rgb: [f32; 3]) -> String {
    let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
    let [r, g, b] = rgb.map(byte);
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// A word in quotes; `None` of what the language cannot say.
pub(crate) fn quoted(text: &str) -> Option<String> {
    let fine = !text.is_empty() && !text.contains(['"', '\n', '\r']);
    fine.then(|| format!("\"{text}\""))
}

/// The camera of the window.
pub(crate) fn camera(camera: &Camera) -> String {
    let axes = camera.rotation.transpose();
    let fov = 2.0 * (0.5 * f64::from(camera.width) / camera.fx).atan();
    format!(
        "camera eye {} target {} up {} fov {} size {},{} center {} time {}",
        vector(camera.position),
        vector(camera.position + axes.z_axis),
        vector(-axes.y_axis),
        fov.to_degrees(),
        camera.width,
        camera.height,
        list([camera.cx, camera.cy]),
        camera.time,
    )
}

/// A pick through the window's camera: `what` is `click 3,4` and its like.
pub(crate) fn pick(through: &Camera, verb: &str, what: &str, edit: &EditMode) -> String {
    let depth = match edit.reach {
        Reach::Surface => String::new(),
        Reach::Depth => format!(" depth {}", edit.form.depth),
        Reach::Through => " through".to_owned(),
    };
    let similar = if edit.goes_on { format!(" similar {}px", edit.form.similar) } else { String::new() };
    format!("{}; {verb} {what}{depth}{similar}", camera(through))
}

/// Pixels of a line.
pub(crate) fn points(points: &[glam::DVec2]) -> String {
    points.iter().map(|p| list([p.x, p.y])).collect::<Vec<_>>().join(" ")
}

/// A change, holding as the mode says, at `time`.
pub(crate) fn change(amount: &Amount, edit: &EditMode, time: f64) -> String {
    let (what, is_move) = match amount {
        Amount::Move(by) => (format!("move {}", vector(*by)), true),
        Amount::Turn(axis, degrees) => (format!("rotate {} {degrees} pivot center", direction(*axis)), false),
        Amount::Scale(f) if *f == DVec3::splat(f.x) => (format!("scale {} pivot center", f.x), false),
        Amount::Scale(factors) => (format!("scale {} pivot center", vector(*factors)), false),
    };
    let [from, to, ease] = edit.form.during;
    let holds = match edit.holds {
        Holds::Always if is_move => String::new(),
        Holds::Always => format!(" time {time}"),
        Holds::Part => format!(" frame part time {time}"),
        Holds::During => format!(" time {time} during {from}..{to} ease {ease}"),
    };
    what + &holds
}

fn direction(axis: DVec3) -> String {
    let names = [(DVec3::X, "x"), (DVec3::Y, "y"), (DVec3::Z, "z")];
    names.iter().find(|(known, _)| *known == axis).map_or_else(|| vector(axis), |(_, name)| (*name).to_owned())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]
    use engine::edit::script::{Action, parse};

    use super::*;
    use crate::viewer::editing::mode::Tool;

    #[test]
    fn the_camera_of_the_window_is_read_back() {
        let eye = DVec3::new(0.3, -1.7, 2.9);
        let seen = Camera::look_at(eye, DVec3::new(0.1, 0.2, 0.0), DVec3::NEG_Y, 0.7, [1280, 800]);
        let seen = Camera { cx: 517.25, cy: 371.5, time: 0.37, ..seen };
        let command = &parse(&camera(&seen)).unwrap()[0];
        let Action::Camera(read) = &command.action else { panic!("{command:?}") };
        assert!(read.rotation.abs_diff_eq(seen.rotation, 1e-12) && (read.fx - seen.fx).abs() < 1e-9);
        assert_eq!((read.position, read.cx, read.cy, read.time), (eye, 517.25, 371.5, 0.37));
        assert_eq!((read.width, read.height), (1280, 800));
    }

    #[test]
    fn everything_that_the_window_says_is_in_the_language() {
        let seen = Camera::look_at(DVec3::ONE, DVec3::ZERO, DVec3::Z, 0.7, [640, 480]);
        let mut said = 0;
        for (reach, holds) in
            [(Reach::Surface, Holds::Always), (Reach::Depth, Holds::Part), (Reach::Through, Holds::During)]
        {
            let edit = EditMode { reach, holds, tool: Tool::Lasso, goes_on: true, ..EditMode::default() };
            let corners = [glam::DVec2::new(1.5, 2.0), glam::DVec2::new(9.0, 2.0), glam::DVec2::new(4.0, 1e-7)];
            let mut all = vec![
                pick(&seen, verb(true, true), "click 3,4", &edit),
                pick(&seen, verb(true, false), "rect 3,4,5,6", &edit),
                pick(&seen, verb(false, true), &format!("lasso {}", points(&corners)), &edit),
                format!("name {}; merge {}", quoted("a b").unwrap(), quoted("c;d #.ply").unwrap()),
                format!("recolor tint {}", color([1.0, 0.5, 0.0])),
            ];
            let axis = DVec3::new(1e-9, 0.3, -2.0);
            let amounts = [
                Amount::Move(axis),
                Amount::Turn(axis, -3.5),
                Amount::Turn(DVec3::Y, 3.5),
                Amount::Scale(DVec3::splat(0.5)),
                Amount::Scale(DVec3::new(1.0, 2.0, 1.0)),
            ];
            all.extend(amounts.iter().map(|amount| change(amount, &edit, 0.3)));
            for text in all {
                said += parse(&text).unwrap_or_else(|e| panic!("{text}: {e:?}")).len();
            }
        }
        assert_eq!(said, 3 * 14);
        assert!(quoted("a\"b").is_none() && quoted("").is_none());
    }
}
