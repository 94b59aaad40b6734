//! Files that are dropped, cameras of a data set, and how soon the window shows what was done.

use std::path::Path;
use std::time::Duration;

use engine::data::camera_file;
use engine::file;
use engine::scene::synthetic;

use crate::desktop::{Desktop, Window, difference, spgs};
use crate::drop;
use crate::window::{drawn, moving_model};

const SIZE: [u32; 2] = [480, 360];

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

#[test]
fn a_dropped_model_is_shown_and_a_damaged_one_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let desktop = Desktop::new(700, 500);
    let model = moving_model(folder.path(), 500);
    let mut window = Window::open(&desktop, &model, &folder.path().join("out"), &["--size", "480x360", "--pause"]);
    let first = window.picture();
    let other = folder.path().join("other scene.safetensors");
    file::save(&other, &synthetic::moving_scene(900, 12, 9, 4, false)).unwrap();
    let id = window.id().parse().unwrap();
    assert!(drop::file(desktop.display(), id, &other));
    window.wait("the dropped model", |w| difference(&first, &w.picture()) > 1.0);
    window.wait("its name", |w| w.title() == "other scene.safetensors – spgs");
    let dropped = window.picture();
    assert!(drawn(&dropped) > 0.05, "{}", drawn(&dropped));

    let damaged = folder.path().join("damaged.safetensors");
    let bytes = std::fs::read(&other).unwrap();
    std::fs::write(&damaged, &bytes[..bytes.len() / 2]).unwrap();
    let quiet = desktop.capture();
    assert_eq!(quiet.near(ERROR, 40), 0, "no error yet");
    assert!(drop::file(desktop.display(), id, &damaged));
    window.wait("what is wrong with it", |w| w.desktop.capture().near(ERROR, 40) > 20);
    desktop.capture().keep("damaged");
    assert_eq!(difference(&dropped, &window.picture()), 0.0, "the scene stays");
    assert_eq!(window.title(), "other scene.safetensors – spgs");
    assert_eq!(window.quit()["validation_messages"], 0);
}

/// Colour of a message about what went wrong.
const ERROR: [u8; 3] = [248, 113, 113];

/// Four views around the scene at four times, as a file.
fn cameras_around(folder: &Path) -> std::path::PathBuf {
    let scene = synthetic::moving_scene(2000, 12, 9, 3, false);
    let path = folder.join("transforms.json");
    camera_file::write(&path, &tools::cli::camera::orbit(&scene, SIZE, 4)).unwrap();
    path
}

/// `picture` without its first `rows`, and `other` without its last: what a shift of the view leaves of both.
fn shifted(picture: &image::RgbImage, other: &image::RgbImage, rows: u32) -> f64 {
    let (width, height) = picture.dimensions();
    let a = image::imageops::crop_imm(other, 0, rows, width, height - rows).to_image();
    let b = image::imageops::crop_imm(picture, 0, 0, width, height - rows).to_image();
    difference(&a, &b)
}

#[test]
fn presets_are_the_views_that_render_draws() {
    let folder = tempfile::tempdir().unwrap();
    let desktop = Desktop::new(700, 500);
    let model = moving_model(folder.path(), 2000);
    let cameras = cameras_around(folder.path());
    let out = folder.path().join("rendered");
    let [model_text, cameras_text, out_text] = [&model, &cameras, &out].map(|p| p.to_str().unwrap());
    let render = ["render", model_text, "--cameras", cameras_text, "--out", out_text, "--quiet"];
    let done = spgs(&render).output().unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let rendered: Vec<_> = (0..4).map(|i| image::open(out.join(format!("{i:05}.png"))).unwrap().to_rgb8()).collect();

    let more = ["--size", "480x360", "--pause", "--data", cameras_text];
    let mut window = Window::open(&desktop, &model, &folder.path().join("out"), &more);
    // The time line at the bottom takes some rows, so that the view's middle lies higher: by as much in each of them.
    let first = window.picture();
    let rows = (0..60).min_by(|a, b| shifted(&first, &rendered[0], *a).total_cmp(&shifted(&first, &rendered[0], *b)));
    let rows = rows.unwrap();
    println!("{rows} rows, {}", shifted(&first, &rendered[0], rows));
    for (key, camera) in [("", 0), ("Next", 1), ("Next", 2), ("Next", 3), ("Next", 0), ("Prior", 3), ("Prior", 2)] {
        if !key.is_empty() {
            window.key(key);
            std::thread::sleep(Duration::from_millis(500));
        }
        let at = |i: usize, w: &mut Window<'_>| shifted(&w.picture(), &rendered[i], rows);
        window.wait("the way to a preset", |w| at(camera, w) < 0.5);
        for other in (0..4).filter(|i| *i != camera) {
            let far = at(other, &mut window);
            assert!(far > 2.0, "{key}: view {camera} is {far} from {other}");
        }
    }
    assert_eq!(window.quit()["validation_messages"], 0);
}

#[test]
fn camera_frusta_are_drawn_over_the_scene_and_not_into_it() {
    let folder = tempfile::tempdir().unwrap();
    let desktop = Desktop::new(700, 500);
    let model = moving_model(folder.path(), 500);
    let cameras = cameras_around(folder.path());
    let more = ["--size", "480x360", "--pause", "--data", cameras.to_str().unwrap()];
    let mut window = Window::open(&desktop, &model, &folder.path().join("out"), &more);
    // Away from the first camera, which would have its own frame around the view.
    window.tool(&["mousemove", "240", "160", "click", "5", "click", "5", "click", "5", "click", "5"]);
    let without = window.picture();
    let before = desktop.capture();
    window.key("k");
    let current = [255, 190, 60];
    window.wait("the frustum of the current camera", |w| w.desktop.capture().near(current, 40) > 30);
    let after = desktop.capture();
    after.keep("frusta");
    assert_eq!(before.near(current, 40), 0);
    // Between the frame rate and the messages.
    let scene = 50 * 700..260 * 700;
    let changed = after.rgb[scene.clone()].iter().zip(&before.rgb[scene]).filter(|(a, b)| a != b).count();
    assert!(changed > 150, "four frusta in {changed} pixels");
    assert_eq!(difference(&without, &window.picture()), 0.0, "they are not in saved pictures");
    window.key("k");
    window.wait("a view without them", |w| w.desktop.capture().near(current, 40) == 0);
    assert_eq!(window.quit()["validation_messages"], 0);
}

/// Report of a run that draws so many frames of a scene that plays.
fn played(model: &Path, size: [u32; 2], frames: u64) -> serde_json::Value {
    let desktop = Desktop::new(size[0] + 100, size[1] + 100);
    let (frames, size) = (frames.to_string(), format!("{}x{}", size[0], size[1]));
    let arguments = ["view", model.to_str().unwrap(), "--frames", &frames, "--json", "--size", &size, "--no-vsync"];
    let out = spgs(&arguments).env("DISPLAY", desktop.display()).output().unwrap();
    let text = String::from_utf8_lossy(&out.stdout);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    serde_json::from_str(&text[text.find('{').unwrap()..=text.rfind('}').unwrap()]).unwrap()
}

#[test]
fn frames_between_two_of_the_interface_allocate_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let model = moving_model(folder.path(), 300);
    // Without and with the panel.
    for size in [[200, 150], [900, 200]] {
        let json = played(&model, size, 500);
        let counted = &json["allocations_between_interface_frames"];
        println!("{size:?}: {counted}");
        let number = |name: &str| counted[name].as_u64().unwrap();
        // The resolution may change in between.
        assert_eq!(number("allocations"), 0, "{counted}");
        let (runs, seconds) = (json["interface_frames"].as_u64().unwrap(), json["seconds"].as_f64().unwrap());
        assert!(number("frames") + 2 * runs >= 450, "{json}");
        // Ten times per second while the scene plays and nobody touches anything.
        assert!(runs as f64 <= 11.0 * seconds + 15.0, "{json}");
    }
}
