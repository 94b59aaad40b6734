//! What a person does, done by a machine.

use std::time::Duration;

use engine::file;
use engine::scene::synthetic;

use crate::desktop::{Desktop, Window, difference, spgs};

/// Share of pixels that are not the background's black.
pub fn drawn(picture: &image::RgbImage) -> f64 {
    let lit = picture.pixels().filter(|p| p.0.iter().any(|v| *v > 12)).count();
    lit as f64 / f64::from(picture.width() * picture.height())
}

pub fn moving_model(folder: &std::path::Path, gaussians: usize) -> std::path::PathBuf {
    let path = folder.join("scene.safetensors");
    file::save(&path, &synthetic::moving_scene(gaussians, 12, 9, 3, false)).unwrap();
    path
}

#[test]
fn a_window_is_orbited_scrubbed_resized_and_closed() {
    let folder = tempfile::tempdir().unwrap();
    let desktop = Desktop::new(900, 700);
    let model = moving_model(folder.path(), 2000);
    let mut window = Window::open(&desktop, &model, &folder.path().join("out"), &["--size", "640x480", "--pause"]);
    let first = window.picture();
    assert_eq!(first.dimensions(), (640, 480));
    assert!(drawn(&first) > 0.05, "{}", drawn(&first));
    let screen = desktop.capture();
    screen.keep("window");
    assert!(screen.colors([200, 100, 440, 380]) > 50, "the scene is on the screen");
    assert!(screen.colors([10, 10, 120, 40]) > 8, "the frame rate is on the screen");
    // Nothing moves by itself.
    assert_eq!(difference(&first, &window.picture()), 0.0);

    window.drag("1", [300, 200], [90, 30]);
    let orbited = window.picture();
    assert!(difference(&first, &orbited) > 1.0, "orbit");
    window.drag("3", [300, 200], [60, 0]);
    let panned = window.picture();
    assert!(difference(&orbited, &panned) > 1.0, "pan");
    window.tool(&["mousemove", "320", "200", "click", "4", "click", "4"]);
    let zoomed = window.picture();
    assert!(drawn(&zoomed) > drawn(&panned), "zoom");
    for _ in 0..3 {
        window.key("shift+Right");
    }
    let scrubbed = window.picture();
    assert!(difference(&zoomed, &scrubbed) > 0.5, "scrub");
    window.key("Home");
    assert_eq!(difference(&zoomed, &window.picture()), 0.0, "back to the start");
    window.key("End");
    assert!(difference(&zoomed, &window.picture()) < 0.1, "this scene ends as it starts");
    window.key("Left");
    let scrubbed = window.picture();
    window.tool(&["mousemove", "320", "200", "keydown", "d"]);
    std::thread::sleep(Duration::from_millis(400));
    window.tool(&["keyup", "d"]);
    let flown = window.picture();
    assert!(difference(&scrubbed, &flown) > 0.5, "fly");
    window.key("Home");
    window.key("f");
    std::thread::sleep(Duration::from_secs(2));

    let modes: Vec<_> = ["1", "2", "3", "4", "5"]
        .map(|key| {
            window.key(key);
            window.picture()
        })
        .into();
    for (i, a) in modes.iter().enumerate() {
        assert!(drawn(a) > 0.02, "mode {} is empty", i + 1);
        assert!(modes[..i].iter().all(|b| difference(a, b) > 1.0), "mode {} looks like another", i + 1);
    }
    window.key("1");
    assert_eq!(difference(&modes[0], &window.picture()), 0.0, "back to colours");

    for size in [[500, 400], [64, 64], [801, 603], [640, 480]] {
        window.resize(size[0], size[1]);
        std::thread::sleep(Duration::from_millis(300));
        assert_eq!(window.picture().dimensions(), (size[0], size[1]));
    }
    let json = window.quit();
    assert_eq!(json["validation_messages"], 0);
}

#[test]
fn keys_open_the_list_select_record_and_save_floats() {
    let folder = tempfile::tempdir().unwrap();
    let desktop = Desktop::new(1300, 820);
    let model = moving_model(folder.path(), 2000);
    let out = folder.path().join("out");
    let mut window = Window::open(&desktop, &model, &out, &["--size", "1280x800"]);
    window.key("space");
    let plain = window.picture();
    window.key("question");
    std::thread::sleep(Duration::from_millis(500));
    desktop.capture().keep("keys");
    assert_eq!(difference(&plain, &window.picture()), 0.0, "the list is not in saved pictures");
    window.key("Escape");
    for key in ["c", "p", "k"] {
        window.key(key);
    }
    // A frame without the list, which would take the click.
    window.picture();
    window.tool(&["mousemove", "500", "370", "click", "1"]);
    std::thread::sleep(Duration::from_millis(500));
    desktop.capture().keep("selection");
    let selected = window.picture();
    assert!(difference(&plain, &selected) > 0.5, "a superpoint stands out");
    window.key("Escape");
    window.key("r");
    window.key("space");
    window.drag("1", [500, 370], [120, 10]);
    window.key("r");
    let path = window.file("path-1.json");
    let cameras = engine::data::load_cameras(&path, None, None).unwrap().cameras;
    assert!(cameras.len() >= 2, "{} frames", cameras.len());
    assert!(cameras[0].position.distance(cameras[cameras.len() - 1].position) > 1e-3);
    assert!(cameras.iter().any(|c| c.time != cameras[0].time), "time runs along the path");
    window.key("shift+F12");
    let floats = engine::file::picture::read(&window.file("view-1.exr")).unwrap();
    assert_eq!((floats.width, floats.height), (1280, 800));
    let json = window.quit();
    assert_eq!(json["validation_messages"], 0);
    assert!(json["frames"].as_u64().unwrap() > 5);
}

#[test]
fn a_training_folder_is_shown_anew() {
    let folder = tempfile::tempdir().unwrap();
    let desktop = Desktop::new(400, 300);
    let run = folder.path().join("run");
    std::fs::create_dir(&run).unwrap();
    let save = |gaussians, seed| {
        file::save(&run.join("model.safetensors"), &synthetic::moving_scene(gaussians, 12, 9, seed, false)).unwrap();
    };
    save(300, 3);
    let mut window = Window::open(&desktop, &run, &folder.path().join("out"), &["--size", "320x240", "--pause"]);
    let first = window.picture();
    assert!(drawn(&first) > 0.05, "{}", drawn(&first));
    // Another number of Gaussians, so that nothing of the old scene fits.
    save(900, 4);
    window.wait("the second model", |w| difference(&first, &w.picture()) > 1.0);
    // What cannot be read is passed over; the window goes on.
    let second = window.picture();
    std::fs::write(run.join("model.safetensors"), b"no model").unwrap();
    std::thread::sleep(Duration::from_millis(1500));
    assert_eq!(difference(&second, &window.picture()), 0.0);
    assert_eq!(window.quit()["validation_messages"], 0);
}

#[test]
fn a_run_of_resizes_leaves_nothing_behind() {
    resizes(40);
}

#[test]
#[ignore = "the full number of the bound: minutes on a CPU device"]
fn a_thousand_resizes_leave_nothing_behind() {
    resizes(1000);
}

fn resizes(count: u32) {
    let folder = tempfile::tempdir().unwrap();
    let desktop = Desktop::new(900, 700);
    let model = moving_model(folder.path(), 300);
    let mut window = Window::open(&desktop, &model, &folder.path().join("out"), &["--size", "320x240"]);
    for i in 0..count {
        window.resize(200 + 37 * i % 400, 150 + 53 * i % 300);
        // As long as a frame takes: sizes that follow each other sooner are one to the program.
        std::thread::sleep(Duration::from_millis(30));
        if i % 100 == 50 {
            // Minimised and back.
            window.tool(&["windowunmap", "--sync", window.id()]);
            window.tool(&["windowmap", "--sync", window.id()]);
            window.tool(&["windowfocus", window.id()]);
        }
    }
    window.resize(320, 240);
    std::thread::sleep(Duration::from_millis(500));
    assert_eq!(window.picture().dimensions(), (320, 240));
    let json = window.quit();
    assert_eq!(json["validation_messages"], 0);
    println!("{} of {count} sizes were drawn", json["resizes"]);
    assert!(json["resizes"].as_u64().unwrap() >= u64::from(count / 2), "{json}");
}

#[test]
fn a_lost_device_is_replaced_by_another() {
    lose_devices(&["100"]);
}

#[test]
fn a_device_may_be_lost_while_the_scene_comes_to_it_again() {
    lose_devices(&["100", "3"]);
}

/// Loses devices at these submissions, one after the other: the window shows the same and can be used as before.
fn lose_devices(at: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let desktop = Desktop::new(400, 300);
    let model = moving_model(folder.path(), 200);
    let mut more = vec!["--size", "320x240", "--pause", "--time", "0.4"];
    more.extend(at.iter().flat_map(|n| ["--lose-device-at", n]));
    let mut window = Window::open(&desktop, &model, &folder.path().join("out"), &more);
    let before = window.picture();
    assert!(drawn(&before) > 0.02, "{}", drawn(&before));
    for i in 0..150 {
        window.tool(&["mousemove", &(100 + i % 50).to_string(), "100"]);
        std::thread::sleep(Duration::from_millis(10));
    }
    assert_eq!(difference(&before, &window.picture()), 0.0, "the same scene, time and camera");
    window.key("2");
    window.wait("another picture", |w| difference(&before, &w.picture()) > 0.1);
    let json = window.quit();
    assert_eq!((&json["device_losses"], &json["validation_messages"]), (&at.len().into(), &0.into()), "{json}");
    // Counted over all devices: each that drew has images of a first size.
    assert!(json["resizes"].as_u64().unwrap() >= 2, "{json}");
}

#[test]
fn a_device_that_is_lost_again_and_again_ends_the_program() {
    let folder = tempfile::tempdir().unwrap();
    let desktop = Desktop::new(400, 300);
    let model = moving_model(folder.path(), 200);
    let mut arguments = vec!["view", model.to_str().unwrap(), "--size", "320x240"];
    arguments.extend(["--lose-device-at", "60"].repeat(3));
    let out = spgs(&arguments).env("DISPLAY", desktop.display()).output().unwrap();
    let text = String::from_utf8_lossy(&out.stderr);
    assert_eq!(out.status.code(), Some(5), "{text}");
    assert!(text.lines().any(|l| l.starts_with("spgs: device lost in submission")), "{text}");
    assert_eq!(text.lines().filter(|l| l.contains("another device is opened")).count(), 2, "{text}");
}

#[test]
fn mistakes_get_one_line_and_a_code() {
    let folder = tempfile::tempdir().unwrap();
    let model = moving_model(folder.path(), 10);
    let run = |arguments: &[&str]| {
        let out = spgs(arguments).output().unwrap();
        let text = String::from_utf8_lossy(&out.stderr).into_owned();
        assert_eq!(text.lines().filter(|l| l.starts_with("spgs: ")).count(), 1, "{text}");
        (out.status.code().unwrap(), text)
    };
    let (code, text) = run(&["view", model.to_str().unwrap()]);
    assert!(code == 2 && text.contains("no display"), "{code}: {text}");
    let (code, text) = run(&["view", "/nowhere/at/all.ply"]);
    assert!(code == 3 && text.contains("/nowhere/at/all.ply"), "{code}: {text}");
}

#[test]
#[ignore = "a measurement: run it alone, without the validation layer"]
fn fifty_thousand_gaussians_are_interactive() {
    let folder = tempfile::tempdir().unwrap();
    let desktop = Desktop::new(640, 480);
    let model = moving_model(folder.path(), 50_000);
    let mut arguments = vec!["view", model.to_str().unwrap(), "--frames", "300", "--json"];
    arguments.extend(["--size", "640x480", "--full-resolution", "--no-vsync"]);
    let out = spgs(&arguments).env("DISPLAY", desktop.display()).output().unwrap();
    let text = String::from_utf8_lossy(&out.stdout);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let json = &text[text.find('{').unwrap()..=text.rfind('}').unwrap()];
    println!("{json}");
    let json: serde_json::Value = serde_json::from_str(json).unwrap();
    assert!(json["fps"].as_f64().unwrap() >= 10.0, "{json}");
}

/// Pictures for people, in the folder that `SPGS_SCREENSHOTS` names.
#[test]
#[ignore = "makes pictures for people to look at"]
fn showcase() {
    let folder = tempfile::tempdir().unwrap();
    let desktop = Desktop::new(1280, 800);
    let path = folder.path().join("demo.safetensors");
    file::save(&path, &synthetic::demo_scene()).unwrap();
    let window = Window::open(&desktop, &path, &folder.path().join("out"), &["--size", "1280x800", "--no-vsync"]);
    std::thread::sleep(Duration::from_secs(8));
    desktop.capture().keep("1_colour");
    for (key, name) in [("2", "2_depth"), ("3", "3_opacity"), ("4", "4_tiles"), ("5", "5_superpoints")] {
        window.key(key);
        std::thread::sleep(Duration::from_secs(2));
        desktop.capture().keep(name);
    }
    window.key("1");
    window.key("p");
    window.key("c");
    window.key("question");
    std::thread::sleep(Duration::from_secs(2));
    desktop.capture().keep("6_keys");
    window.key("Escape");
    window.key("space");
    window.tool(&["mousemove", "520", "400", "click", "1"]);
    window.key("r");
    std::thread::sleep(Duration::from_secs(3));
    desktop.capture().keep("7_selection");
    window.key("r");
    window.key("h");
    window.resize(640, 480);
    std::thread::sleep(Duration::from_secs(2));
    desktop.capture().keep("8_small");
    window.quit();
}
