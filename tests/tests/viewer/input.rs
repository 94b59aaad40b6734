//! How soon the window shows what was done, and what its frames allocate.

use std::path::Path;
use std::time::Duration;

use crate::desktop::{ALLOCATIONS, Desktop, Window, spgs};
use crate::window::moving_model;

#[test]
fn input_is_seen_within_two_frames() {
    let folder = tempfile::tempdir().unwrap();
    let desktop = Desktop::new(700, 500);
    let model = moving_model(folder.path(), 2000);
    let mut window = Window::open(&desktop, &model, &folder.path().join("out"), &["--size", "480x360", "--pause"]);
    window.picture();
    // Once out of rest and once while the scene plays: wheel, drag, a preset's glide, held keys, a click.
    for _ in 0..2 {
        window.tool(&["mousemove", "240", "160"]);
        for button in ["4", "5", "4", "5"] {
            window.tool(&["click", button]);
            std::thread::sleep(Duration::from_millis(130));
        }
        window.drag("1", [200, 150], [60, 30]);
        for key in ["f", "u", "2", "1", "b"] {
            window.key(key);
            std::thread::sleep(Duration::from_millis(170));
        }
        window.tool(&["keydown", "d"]);
        std::thread::sleep(Duration::from_millis(300));
        window.tool(&["keyup", "d"]);
        window.key("f");
        std::thread::sleep(Duration::from_millis(600));
        window.tool(&["mousemove", "240", "160", "click", "1"]);
        std::thread::sleep(Duration::from_millis(300));
        window.key("Escape");
        window.key("space");
    }
    let json = window.quit();
    let photon = &json["input_to_photon"];
    println!("{photon}");
    assert!(photon["events"].as_u64().unwrap() >= 20, "{json}");
    assert!(photon["frames_max"].as_u64().unwrap() <= 2, "{json}");
    assert!(photon["ms_median"].as_f64().unwrap() <= photon["ms_max"].as_f64().unwrap());
    assert_eq!(json["validation_messages"], 0);
}

/// Frames, runs of the interface, seconds and allocations of a run that draws so many frames.
fn counted(model: &Path, frames: u64) -> [f64; 4] {
    let desktop = Desktop::new(300, 200);
    let frames = frames.to_string();
    let arguments = ["view", model.to_str().unwrap(), "--frames", &frames, "--json", "--size", "200x150", "--no-vsync"];
    let out = spgs(&arguments).env("DISPLAY", desktop.display()).output().unwrap();
    let (text, errors) = (String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
    assert!(out.status.success(), "{errors}");
    let json = &text[text.find('{').unwrap()..=text.rfind('}').unwrap()];
    let json: serde_json::Value = serde_json::from_str(json).unwrap();
    let allocations = errors.lines().find_map(|l| l.strip_prefix(ALLOCATIONS)).unwrap();
    let number = |name: &str| json[name].as_f64().unwrap();
    [number("frames"), number("interface_frames"), number("seconds"), allocations.parse().unwrap()]
}

#[test]
fn frames_between_two_of_the_interface_allocate_next_to_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let model = moving_model(folder.path(), 300);
    let (short, long) = (counted(&model, 50), counted(&model, 650));
    let [frames, runs, seconds, allocations]: [f64; 4] = std::array::from_fn(|i| long[i] - short[i]);
    println!("{frames} frames in {seconds:.2} s, {runs} runs of the interface: {allocations} allocations");
    // Ten times per second while the scene plays and nobody touches anything.
    assert!(runs <= 11.0 * seconds + 5.0, "{runs} runs in {seconds} s");
    let most = PER_FRAME * frames + PER_RUN * (runs + 3.0);
    assert!(allocations <= most, "{allocations} allocations, {most} expected at most");
}

/// Most allocations of a frame, and of a run of the interface.
const PER_FRAME: f64 = 8.0;
const PER_RUN: f64 = 200.0;
