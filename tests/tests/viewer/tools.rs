//! Every tool of the edit mode: its picture, and the command that it says.

use std::path::{Path, PathBuf};
use std::time::Duration;

use engine::data::camera_file;
use engine::file;
use engine::scene::Camera;
use engine::scene::synthetic::random_scene;
use glam::DVec3;

use crate::desktop::{Desktop, Window, difference};
use crate::editing::{check_list, handle, save, type_keys};
use crate::window::moving_model;

/// A folder with a model that moves, another one, and cameras.
struct Files {
    folder: tempfile::TempDir,
    model: PathBuf,
    other: PathBuf,
    cameras: PathBuf,
}

impl Files {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let (model, other, cameras) = (moving_model(folder.path(), 600), at("other.ply"), at("cameras.json"));
        file::save(&other, &random_scene(60, 0, 7)).unwrap();
        // The window begins with the first; floaters are near to the second.
        let camera = |name: &str, eye: DVec3| Camera {
            name: name.into(),
            ..Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.8, [64, 48])
        };
        let [far, near] = [camera("far", DVec3::new(0.0, -5.0, 1.0)), camera("near", 0.5 * DVec3::X)];
        camera_file::write(&cameras, &[far, near]).unwrap();
        Self { folder, model, other, cameras }
    }

    fn open<'a>(&self, desktop: &'a Desktop) -> Window<'a> {
        let cameras = self.cameras.to_str().unwrap();
        let mut window = Window::open(
            desktop,
            &self.model,
            &self.folder.path().join("out"),
            &["--size", "1000x900", "--pause", "--time", "0.3", "--data", cameras],
        );
        window.picture();
        window.key("ctrl+e");
        window.settled();
        window
    }
}

/// Types into the field that was clicked. The keys are no shortcuts, also those that come with the Enter in one frame.
fn typed(window: &mut Window<'_>, text: &str) {
    std::thread::sleep(Duration::from_millis(500));
    window.tool(&["type", text]);
    window.key("Return");
    std::thread::sleep(Duration::from_millis(700));
}

/// Where commands are typed: the topmost of the fields as wide as the panel.
fn field(desktop: &Desktop) -> [i32; 2] {
    let screen = desktop.capture();
    let x = 970;
    let y = (0..860).find(|y| screen.rgb[y * screen.width + x] == [12, 13, 16]).expect("a field");
    [x as i32, y as i32 + 8]
}

/// The saved list has these, in this order.
fn assert_said(list: &Path, commands: &[&str]) {
    let list = std::fs::read_to_string(list).unwrap();
    let mut rest = list.as_str();
    for command in commands {
        let at = rest.find(command).unwrap_or_else(|| panic!("no {command}, or not in order, in {list}"));
        rest = &rest[at + command.len()..];
    }
}

#[test]
fn handles_turn_and_scale_alone_along_and_for_a_while() {
    let (files, desktop) = (Files::new(), Desktop::new(1020, 910));
    let mut window = files.open(&desktop);
    let first = window.press("", [370, 430]);
    // The panel's rings.
    window.press("", [878, 379]);
    desktop.capture().keep("tools_rings");
    let [_, ring] = handle(&desktop);
    window.drag("1", ring, [-30, 25]);
    let turned = window.picture();
    assert!(difference(&first, &turned) > 0.1, "a ring turns");
    desktop.capture().keep("tools_turned");
    type_keys(&window, &["s", "Escape"]);
    window.picture();
    desktop.capture().keep("tools_bars");
    let [_, bar] = handle(&desktop);
    window.drag("1", bar, [40, 40]);
    let scaled = window.picture();
    assert!(difference(&turned, &scaled) > 0.05, "a bar scales");
    desktop.capture().keep("tools_scaled");
    window.press("", [834, 404]);
    type_keys(&window, &["g", "z", "period", "4", "Return"]);
    let along = window.picture();
    assert!(difference(&scaled, &along) > 0.1, "along with the part's motion");
    window.press("", [885, 404]);
    desktop.capture().keep("tools_during");
    type_keys(&window, &["r", "x", "9", "0", "Return"]);
    assert!(difference(&along, &window.picture()) > 0.05, "for a while");
    window.key("Home");
    let start = window.picture();
    window.key("ctrl+z");
    assert!(difference(&start, &window.picture()) < 0.02, "and not at the beginning");
    window.key("ctrl+shift+z");
    let files = save(&mut window, &files.model);
    assert_said(&files.1, &["rotate ", "scale ", "move 0,0,0.4 frame part time 0.3", "during 0.25..0.75 ease 0.1"]);
    check_list(&files.0.with_file_name("scene.safetensors"), &files);
    assert_eq!(window.quit()["validation_messages"], 0);
}

#[test]
fn the_panel_selects_by_everything_and_merges() {
    let (files, desktop) = (Files::new(), Desktop::new(1020, 910));
    let mut window = files.open(&desktop);
    let plain = window.picture();
    // Single Gaussians: select, add, take away.
    window.press("", [829, 130]);
    let one = window.press("", [370, 430]);
    let two = window.press("shift", [220, 300]);
    assert!(difference(&plain, &one) > 0.01 && difference(&one, &two) > 0.01, "one Gaussian, and another");
    desktop.capture().keep("tools_gaussians");
    let one_again = window.press("ctrl", [220, 300]);
    assert_eq!(difference(&one, &one_again), 0.0, "and without it");
    window.press("", [902, 205]);
    type_keys(&window, &["o"]);
    window.press("", [776, 130]);
    window.press("", [370, 430]);
    window.press("", [824, 230]);
    desktop.capture().keep("tools_isolated");
    window.press("", [874, 230]);
    window.press("", [908, 230]);
    let locked = window.press("", [770, 205]);
    desktop.capture().keep("tools_locked");
    let all = window.press("", [963, 230]);
    assert_eq!(difference(&locked, &all), 0.0, "what was locked stays unselected");
    // By what they have in common.
    window.press("", [805, 255]);
    window.press("", [948, 330]);
    desktop.capture().keep("tools_by");
    window.press("shift", [930, 355]);
    window.press("ctrl", [895, 380]);
    window.press("", [852, 405]);
    desktop.capture().keep("tools_floaters");
    window.press("", [805, 255]);
    window.tool(&["mousemove", "838", "479", "click", "1"]);
    typed(&mut window, files.other.to_str().unwrap());
    let merged = window.press("", [940, 479]);
    assert!(difference(&plain, &merged) > 0.5, "merged");
    desktop.capture().keep("tools_merged");
    let commands = field(&desktop);
    window.tool(&["mousemove", &commands[0].to_string(), &commands[1].to_string(), "click", "1"]);
    typed(&mut window, "select superpoints 0-3; recolor tint #00ff00");
    assert!(difference(&merged, &window.picture()) > 0.1, "a command that was typed");
    desktop.capture().keep("tools_command");
    let files = save(&mut window, &files.model);
    assert_said(
        &files.1,
        &[
            "select rect 370,430,371,431",
            "add rect 220,300,221,301",
            "subtract rect 220,300,221,301",
            "grow 0.02 time 0.3",
            "similar 1.5px",
            "\"isolate\"",
            "\"show\"",
            "\"lock\"",
            "select all",
            "unlock",
            "select opacity above 0.1",
            "add size above 0.1",
            "subtract color #b34c33 within 0.2",
            "select floaters 0.5",
            "merge ",
            "select superpoints 0-3",
            "recolor tint #00ff00",
        ],
    );
    let list = std::fs::read_to_string(&files.1).unwrap();
    assert!(!list.contains("rotate") && !list.contains("\"hide\""), "what is typed is no shortcut: {list}");
    check_list(&files.0.with_file_name("scene.safetensors"), &files);
    assert_eq!(window.quit()["validation_messages"], 0);
}
