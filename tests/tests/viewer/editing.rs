//! The edit mode, driven by mouse and keys: what is seen, what is undone, and that the saved list makes the saved model.

use std::path::{Path, PathBuf};
use std::time::Duration;

use engine::file;
use engine::scene::Scene;

use crate::desktop::{Desktop, Window, difference, spgs};
use crate::window::moving_model;

fn scene(path: &Path) -> Scene {
    file::load(path).unwrap().scene
}

/// Saves with the window's key, and gives back the model once the list beside it is there too.
pub fn save(window: &mut Window<'_>, model: &Path) -> (PathBuf, PathBuf) {
    let folder = model.parent().unwrap();
    let files = (folder.join("scene.edited.safetensors"), folder.join("scene.edited.edits.toml"));
    for path in [&files.0, &files.1] {
        let _ = std::fs::remove_file(path);
    }
    window.key("ctrl+s");
    window.wait("the saved model and its list", |_| files.0.exists() && files.1.exists());
    files
}

/// The list makes the model again, bit for bit.
pub fn check_list(model: &Path, (edited, list): &(PathBuf, PathBuf)) {
    let again = edited.with_file_name("again.safetensors");
    let text = |path: &Path| path.to_str().unwrap().to_owned();
    let arguments = ["edit".into(), text(model), text(&again), "--script".into(), text(list), "--quiet".into()];
    let out = spgs(&arguments.each_ref().map(String::as_str)).output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    assert!(std::fs::read(edited).unwrap() == std::fs::read(again).unwrap(), "the list makes another model");
}

pub fn type_keys(window: &Window<'_>, keys: &[&str]) {
    keys.iter().for_each(|key| window.key(key));
}

#[test]
fn a_part_is_selected_moved_undone_deleted_and_saved() {
    let folder = tempfile::tempdir().unwrap();
    let desktop = Desktop::new(1100, 760);
    let model = moving_model(folder.path(), 1000);
    let out = folder.path().join("out");
    let mut window = Window::open(&desktop, &model, &out, &["--size", "1000x700", "--pause", "--time", "0.3"]);
    let first = window.picture();
    window.key("ctrl+e");
    assert_eq!(difference(&first, &window.settled()), 0.0, "nothing is selected yet");
    // A click selects, Shift adds, Escape ends.
    window.tool(&["mousemove", "370", "330", "click", "1"]);
    let clicked = window.picture();
    assert!(difference(&first, &clicked) > 0.2, "a part stands out");
    desktop.capture().keep("edit_click");
    window.tool(&["keydown", "shift", "mousemove", "470", "400", "click", "1", "keyup", "shift"]);
    let both = window.picture();
    assert!(difference(&clicked, &both) > 0.1, "two parts stand out");
    window.key("ctrl+z");
    assert_eq!(difference(&clicked, &window.picture()), 0.0, "a selection is undone");
    // Along x by a typed number, in the world at all times.
    type_keys(&window, &["g", "x", "minus", "0", "period", "4"]);
    window.picture();
    desktop.capture().keep("edit_move");
    window.key("Return");
    let moved = window.picture();
    assert!(difference(&clicked, &moved) > 0.2, "it moved");
    type_keys(&window, &["r", "z", "9", "0", "Return"]);
    type_keys(&window, &["s", "1", "period", "5", "Return"]);
    let scaled = window.picture();
    assert!(difference(&moved, &scaled) > 0.1, "it is turned and larger");
    type_keys(&window, &["g", "5", "Escape"]);
    assert_eq!(difference(&scaled, &window.picture()), 0.0, "Escape leaves it as it was");
    type_keys(&window, &["ctrl+z", "ctrl+z"]);
    let undone = window.picture();
    assert_eq!(difference(&moved, &undone), 0.0, "undone");
    window.key("ctrl+z");
    assert_eq!(difference(&clicked, &window.picture()), 0.0, "undone");
    type_keys(&window, &["ctrl+shift+z", "ctrl+shift+z", "ctrl+shift+z"]);
    assert_eq!(difference(&scaled, &window.picture()), 0.0, "and done again");

    let files = save(&mut window, &model);
    check_list(&model, &files);
    assert_eq!(scene(&files.0).gaussians.len(), 1000);
    type_keys(&window, &["shift+d", "x", "period", "7", "Return", "ctrl+i", "Delete"]);
    let cut = window.picture();
    assert!(difference(&scaled, &cut) > 0.2, "all others are gone");
    let files = save(&mut window, &model);
    check_list(&model, &files);
    let left = scene(&files.0).gaussians.len();
    assert!(left > 0 && left < 1000, "{left}");
    // Edits that are in no file are not lost.
    window.key("ctrl+z");
    assert_eq!(window.quit()["validation_messages"], 0);
    let kept = std::fs::read_to_string(out.join("unsaved-1.edits.toml")).unwrap();
    assert!(kept.contains("command = \"duplicate\"") && !kept.contains("command = \"delete\""), "{kept}");
}

#[test]
fn rectangles_lassos_handles_and_names_work() {
    let folder = tempfile::tempdir().unwrap();
    let desktop = Desktop::new(1100, 760);
    let model = moving_model(folder.path(), 1000);
    let mut window =
        Window::open(&desktop, &model, &folder.path().join("out"), &["--size", "1000x700", "--pause", "--time", "0.3"]);
    let first = window.picture();
    type_keys(&window, &["ctrl+e", "b"]);
    window.settled();
    window.drag("1", [300, 250], [100, 90]);
    let boxed = window.picture();
    assert!(difference(&first, &boxed) > 0.1, "a rectangle selects");
    desktop.capture().keep("edit_rectangle");
    window.key("l");
    window.tool(&["keydown", "ctrl", "mousemove", "300", "250", "mousedown", "1"]);
    for at in [["420", "250"], ["420", "300"], ["360", "320"], ["300", "300"]] {
        window.tool(&["mousemove", at[0], at[1]]);
        std::thread::sleep(Duration::from_millis(150));
    }
    window.tool(&["mouseup", "1", "keyup", "ctrl"]);
    let less = window.picture();
    assert!(difference(&boxed, &less) > 0.05, "a lasso takes away");
    desktop.capture().keep("edit_lasso");
    type_keys(&window, &["ctrl+z", "h"]);
    let hidden = window.picture();
    assert!(difference(&first, &hidden) > 0.1 && difference(&boxed, &hidden) > 0.1, "it is hidden");
    window.key("alt+h");
    assert_eq!(difference(&first, &window.picture()), 0.0, "and shown");
    type_keys(&window, &["ctrl+a", "l"]);
    let all = window.picture();
    desktop.capture().keep("edit_handles");
    // The handles are on the screen: the blue one is taken and dragged.
    let [handle, _] = handle(&desktop);
    window.drag("1", handle, [0, -60]);
    assert!(difference(&all, &window.picture()) > 0.2, "a handle moves everything");
    let files = save(&mut window, &model);
    check_list(&model, &files);
    let list = std::fs::read_to_string(&files.1).unwrap();
    let moved = list.lines().find(|line| line.contains("move ")).unwrap();
    let is_along = |line: &str| line.split(['"', ' ', ',']).filter(|word| word.parse() == Ok(0.0)).count() == 2;
    assert!(is_along(moved), "{moved}");
    assert_eq!(window.quit()["validation_messages"], 0);
}

#[test]
fn the_panel_selects_colours_and_freezes() {
    let folder = tempfile::tempdir().unwrap();
    let desktop = Desktop::new(1100, 760);
    let model = moving_model(folder.path(), 500);
    let mut window =
        Window::open(&desktop, &model, &folder.path().join("out"), &["--size", "1000x700", "--pause", "--time", "0.3"]);
    window.picture();
    window.key("ctrl+e");
    let first = window.settled();
    assert!(difference(&first, &window.press("", [770, 205])) > 0.5, "`all`: everything stands out");
    window.press("", [870, 454]);
    window.press("", [904, 429]);
    window.press("", [808, 205]);
    desktop.capture().keep("edit_panel");
    let tinted = window.press("", [600, 50]);
    assert!(difference(&first, &tinted) > 1.0, "`tint` has coloured it");
    window.key("End");
    assert!(difference(&tinted, &window.picture()) < 0.01, "`freeze` has stopped it");
    let files = save(&mut window, &model);
    let list = std::fs::read_to_string(&files.1).unwrap();
    let at = |command: &str| list.find(command).unwrap_or_else(|| panic!("no {command} in {list}"));
    assert!(at("select all") < at("recolor tint #") && at("recolor tint #") < at("freeze 0.3"), "{list}");
    check_list(&model, &files);
    assert_eq!(window.quit()["validation_messages"], 0);
}

/// Middle of what is drawn in the colour of the second axis, and the point of it farthest from there.
pub fn handle(desktop: &Desktop) -> [[i32; 2]; 2] {
    let screen = desktop.capture();
    let is_handle = |p: &[u8; 3]| p.iter().zip([120_u8, 205, 90]).all(|(a, b)| a.abs_diff(b) < 4);
    let found = (0..screen.rgb.len()).filter(|&i| is_handle(&screen.rgb[i]));
    let found: Vec<[i32; 2]> = found.map(|i| [i % screen.width, i / screen.width].map(|v| v as i32)).collect();
    assert!(found.len() > 20, "{} pixels of a handle", found.len());
    let middle = [0, 1].map(|k| found.iter().map(|p| p[k]).sum::<i32>() / found.len() as i32);
    let apart = |p: &&[i32; 2]| (p[0] - middle[0]).pow(2) + (p[1] - middle[1]).pow(2);
    [middle, *found.iter().max_by_key(apart).unwrap()]
}
