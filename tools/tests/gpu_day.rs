//! `spgs bench gpu-day` from outside, with hardly any time: it ends, says what it left out, and one bad step stops no other.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::path::Path;
use std::process::{Command, Output};

use engine::file::picture::{Alpha, write_png};
use engine::image::Image;
use engine::scene::Scene;
use engine::scene::synthetic::random_gaussians;
use serde_json::{Value, json};

fn gpu_day(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_spgs")).args(["bench", "gpu-day"]).args(arguments).output().unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn read(path: &Path) -> Value {
    let bytes = std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_slice(&bytes).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn step<'a>(summary: &'a Value, name: &str) -> &'a Value {
    summary["steps"].as_array().unwrap().iter().find(|s| s["name"] == name).unwrap_or_else(|| panic!("no {name}"))
}

/// A folder of data sets with a small scene in place of `bench_s50k`, and no `dnerf_lego`.
fn data(folder: &Path) {
    let set = folder.join("bench_s50k");
    std::fs::create_dir_all(set.join("train")).unwrap();
    let still = Scene { gaussians: random_gaussians(300, 1, 1), ..Scene::default() };
    engine::file::save(&set.join("model.ply"), &still).unwrap();
    let pose = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 4.0], [0.0, 0.0, 0.0, 1.0]];
    let image = Image { width: 48, height: 32, rgba: vec![0.5; 48 * 32 * 4], depth: Vec::new() };
    let mut frames = Vec::new();
    for name in ["r_000", "r_001"] {
        write_png(&set.join(format!("train/{name}.png")), &image, Alpha::Drop).unwrap();
        frames.push(json!({ "file_path": format!("./train/{name}"), "transform_matrix": pose }));
    }
    let cameras = json!({ "camera_angle_x": 0.8, "frames": frames });
    std::fs::write(set.join("transforms_train.json"), cameras.to_string()).unwrap();
}

#[test]
fn every_step_has_a_state_and_what_ran_has_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let (sets, out) = (folder.path().join("data"), folder.path().join("out"));
    data(&sets);
    let run = gpu_day(&["--out", text(&out), "--data", text(&sets), "--budget", "30"]);
    let (printed, said) = (String::from_utf8(run.stdout).unwrap(), String::from_utf8(run.stderr).unwrap());
    assert!(run.status.success(), "{said}");
    assert!(printed.contains("predicted") && printed.contains("H200"), "{printed}");
    let summary = read(&out.join("gpu_day.json"));
    assert_eq!((summary["kind"].as_str(), summary["failed"].as_u64()), (Some("gpu_day"), Some(0)), "{said}");
    assert_eq!(summary["steps"].as_array().unwrap().len(), 8);
    for step in summary["steps"].as_array().unwrap() {
        let state = step["state"].as_str().unwrap();
        match step["file"].as_str() {
            Some(file) => assert!(state == "done" && read(&out.join(file))["device"]["name"].is_string(), "{step}"),
            None => assert!(state == "skipped" && step["reason"].is_string(), "{step}"),
        }
    }
    let lego = step(&summary, "dnerf_lego");
    assert!(lego["reason"].as_str().unwrap().contains("dnerf_lego does not exist"), "{lego}");
    assert!(said.contains("SKIPPED training, dnerf_lego"), "{said}");
    // What is small enough for any device has both figures.
    let figures = step(&summary, "bench_s50k_frame")["figures"].as_array().unwrap();
    assert!(
        figures.iter().all(|f| f["predicted"].as_f64().unwrap() > 0.0 && f["predicted_on"] == "H200"),
        "{figures:?}"
    );
    let frame = read(&out.join("bench_s50k_frame.json"));
    assert_eq!(frame["scene"]["gaussians"], 300);
    let page = std::fs::read_to_string(out.join("index.html")).unwrap();
    assert!(page.contains("Measured beside predicted") && page.contains("skipped: ") && !page.contains("http"));
}

#[test]
fn a_step_that_fails_does_not_stop_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let (sets, out) = (folder.path().join("data"), folder.path().join("out"));
    data(&sets);
    std::fs::write(sets.join("bench_s50k/model.ply"), "no model").unwrap();
    let run = gpu_day(&["--out", text(&out), "--data", text(&sets), "--budget", "12", "--quiet"]);
    let said = String::from_utf8(run.stderr).unwrap();
    assert_eq!(run.status.code(), Some(3), "{said}");
    assert!(run.stdout.is_empty() && said.contains("FAILED frame, bench_s50k"), "{said}");
    let summary = read(&out.join("gpu_day.json"));
    let state = |name: &str| step(&summary, name)["state"].as_str().unwrap().to_owned();
    assert_eq!([state("self_test"), state("bench_s50k_frame")], ["done", "failed"]);
    assert!(summary["failed"].as_u64().unwrap() >= 1);
    let reason = step(&summary, "bench_s50k_frame")["reason"].as_str().unwrap().to_owned();
    assert!(reason.contains("model.ply"), "{reason}");
    let page = std::fs::read_to_string(out.join("index.html")).unwrap();
    assert!(page.contains("failed: "), "the page says what failed");
}

#[test]
fn mistakes_are_told_before_anything_runs() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    for (arguments, said) in [
        (&["--budget", "20"][..], "--out"),
        (&["--out", text(&out), "--budget", "481"], "1 to 480"),
        (&["--out", text(&out), "--budget", "nan"], "1 to 480"),
        (&["--out", text(&out), "--data", "/no/such/folder"], "/no/such/folder"),
    ] {
        let run = gpu_day(arguments);
        let error = String::from_utf8(run.stderr).unwrap();
        assert!(run.status.code() == Some(2) && error.contains(said) && error.lines().count() == 1, "{error}");
    }
    assert!(!out.exists());
}
