//! Odd orders of what a person does.

use std::time::Duration;

use engine::confidence::Evidence;
use engine::file;
use engine::scene::synthetic;

use crate::desktop::{Desktop, Window, difference, spgs};
use crate::window::moving_model;

#[test]
fn a_path_that_is_still_recorded_is_written_at_the_end_in_one_size() {
    let folder = tempfile::tempdir().unwrap();
    let desktop = Desktop::new(900, 700);
    let model = moving_model(folder.path(), 500);
    let out = folder.path().join("out");
    let mut window = Window::open(&desktop, &model, &out, &["--size", "480x360"]);
    window.picture();
    window.key("r");
    window.drag("1", [200, 150], [60, 30]);
    window.tool(&["windowsize", "--sync", window.id(), "600", "420"]);
    window.drag("1", [200, 150], [60, 30]);
    window.picture();
    assert_eq!(window.quit()["validation_messages"], 0);
    let cameras = engine::data::load_cameras(&out.join("path-1.json"), None, None).unwrap().cameras;
    assert!(cameras.len() >= 2, "{}", cameras.len());
    assert!(cameras.iter().all(|c| [c.width, c.height] == [480, 360]));
    let (first, last) = (&cameras[0], &cameras[cameras.len() - 1]);
    assert!(first.position.distance(last.position) > 1e-3);
    assert_eq!((first.cx, first.cy), (240.0, 180.0));
}

#[test]
fn a_shifted_key_may_be_let_go_after_its_shift() {
    let folder = tempfile::tempdir().unwrap();
    let desktop = Desktop::new(700, 560);
    let model = moving_model(folder.path(), 200);
    let mut window = Window::open(&desktop, &model, &folder.path().join("out"), &["--size", "640x480", "--pause"]);
    window.picture();
    // The word that a picture was saved goes.
    std::thread::sleep(Duration::from_millis(6500));
    let without = desktop.capture();
    let changed = |d: &Desktop| d.capture().rgb.iter().zip(&without.rgb).filter(|(a, b)| a != b).count();
    for open in [true, false, true, false] {
        window.tool(&["keydown", "shift", "keydown", "slash", "keyup", "shift", "keyup", "slash"]);
        window.wait("the list of keys", |w| (changed(w.desktop) > 20_000) == open);
    }
    assert_eq!(window.quit()["validation_messages"], 0);
}

#[test]
fn quick_clicks_at_two_places_are_no_double_click() {
    let folder = tempfile::tempdir().unwrap();
    let desktop = Desktop::new(1100, 760);
    let model = moving_model(folder.path(), 1000);
    let mut window =
        Window::open(&desktop, &model, &folder.path().join("out"), &["--size", "1000x700", "--pause", "--time", "0.3"]);
    let first = window.picture();
    let [one, two] = [["mousemove", "370", "330", "click", "1"], ["mousemove", "470", "400", "click", "1"]];
    window.tool(&[&one[..], &["sleep", "0.1"], &two].concat());
    let selected = window.settled();
    window.key("Escape");
    assert!(difference(&first, &selected) > 0.2, "the second selects");
    assert_eq!(difference(&first, &window.settled()), 0.0, "the camera stays");
    // Without a break, so that a slow frame has both.
    window.tool(&[&two[..], &two].concat());
    window.settled();
    window.key("Escape");
    window.wait("the camera at the point", |w| difference(&first, &w.picture()) > 1.0);
    assert_eq!(window.quit()["validation_messages"], 0);
}

#[test]
fn a_second_click_waits_for_the_frame_that_had_no_room() {
    let folder = tempfile::tempdir().unwrap();
    let desktop = Desktop::new(1100, 760);
    let model = moving_model(folder.path(), 1000);
    // The first selection of a window draws with buffers of its own, which its first frame may overflow.
    for pause in ["0.01", "0.03", "0.05"] {
        let out = folder.path().join(pause);
        let arguments = ["--size", "1000x700", "--pause", "--time", "0.3"];
        let mut window = Window::open(&desktop, &model, &out, &arguments);
        let first = window.picture();
        let [one, two] = [["mousemove", "370", "330", "click", "1"], ["mousemove", "470", "400", "click", "1"]];
        // The pointer goes on: what counts is where it was let go.
        window.tool(&[&one[..], &["sleep", pause], &two, &["mousemove", "30", "660"]].concat());
        let selected = window.settled();
        assert!(difference(&first, &selected) > 0.2, "after {pause} s nothing is selected");
        window.key("Escape");
        assert_eq!(difference(&first, &window.settled()), 0.0, "the camera stays");
        assert_eq!(window.quit()["validation_messages"], 0);
    }
}

#[test]
fn a_window_without_a_model_and_one_with_a_network_end_after_their_frames() {
    let folder = tempfile::tempdir().unwrap();
    let desktop = Desktop::new(300, 250);
    let network = folder.path().join("network.safetensors");
    let mut scene = synthetic::moving_scene(300, 6, 2, 73, true);
    scene.deformation.superpoint_deformation_mut().unwrap().table = None;
    file::save(&network, &scene).unwrap();
    let table = moving_model(folder.path(), 100);
    let [network, table] = [&network, &table].map(|p| p.to_str().unwrap());
    let run = |arguments: &[&str]| {
        let all = [&["view", "--frames", "3", "--size", "200x150"], arguments].concat();
        spgs(&all).env("DISPLAY", desktop.display()).output().unwrap()
    };
    for arguments in [&[][..], &[network], &[network, "--motion", "network"]] {
        let out = run(arguments);
        assert!(out.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&out.stderr));
    }
    let out = run(&[table, "--motion", "network"]);
    let text = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.code() == Some(2) && text.contains("no network F"), "{text}");
}

#[test]
fn expected_errors_are_shown_until_the_model_is_another() {
    let folder = tempfile::tempdir().unwrap();
    let desktop = Desktop::new(1100, 760);
    let model = moving_model(folder.path(), 500);
    let scene = file::load(&model).unwrap().scene;
    let n = scene.gaussians.len();
    // Expected are 0.2 where Gaussians are and 0.05 behind, 4 times as bright.
    let evidence = Evidence { visibility: vec![1e9; n], error: vec![0.2e9; n], background: [1e9, 0.05e9] };
    let file = folder.path().join("confidence.safetensors");
    evidence.write(&file, &scene).unwrap();
    let more = ["--size", "1000x700", "--pause", "--time", "0.3", "--confidence", file.to_str().unwrap()];
    let mut window = Window::open(&desktop, &model, &folder.path().join("out"), &more);
    let first = window.picture();
    window.key("6");
    let errors = window.picture();
    desktop.capture().keep("expected_error");
    assert!(errors.pixels().all(|p| p[0] == p[1] && p[1] == p[2]), "grey");
    let [least, most] = [errors.as_raw().iter().min().unwrap(), errors.as_raw().iter().max().unwrap()];
    assert!(least.abs_diff(51) <= 1 && (180..=205).contains(most), "{least} to {most}");
    window.key("1");
    assert_eq!(difference(&first, &window.picture()), 0.0);
    // Of what is edited nothing is known.
    window.key("6");
    window.key("ctrl+e");
    // The edit mode takes clicks from its first frame on: a slow machine must have drawn it. The click must have selected, too.
    window.settled();
    window.press("", [370, 330]);
    window.key("Delete");
    window.wait("colours", |w| w.picture().pixels().any(|p| p[0] != p[1]));
    assert_eq!(window.quit()["validation_messages"], 0);

    let other = folder.path().join("other.safetensors");
    file::save(&other, &synthetic::moving_scene(500, 12, 9, 4, false)).unwrap();
    let arguments = ["view", other.to_str().unwrap(), "--frames", "3", "--confidence", file.to_str().unwrap()];
    let out = spgs(&arguments).env("DISPLAY", desktop.display()).output().unwrap();
    let text = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.code() == Some(3) && text.contains("another model"), "{:?}: {text}", out.status);
}
