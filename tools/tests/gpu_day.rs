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
    // Which steps get a turn depends on the machine; that it ends and says so does not.
    let run = gpu_day(&["--out", text(&out), "--data", text(&sets), "--budget", "10"]);
    let (printed, said) = (String::from_utf8(run.stdout).unwrap(), String::from_utf8(run.stderr).unwrap());
    assert!(run.status.success() && printed.contains("predicted"), "{printed}{said}");
    let summary = read(&out.join("gpu_day.json"));
    assert_eq!((summary["kind"].as_str(), summary["failed"].as_u64()), (Some("gpu_day"), Some(0)), "{said}");
    let steps = summary["steps"].as_array().unwrap();
    assert_eq!(steps.len(), 8);
    for step in steps {
        match step["file"].as_str() {
            Some(file) => {
                assert!(step["state"] == "done" && read(&out.join(file))["device"]["name"].is_string(), "{step}")
            }
            None => assert!(step["state"] == "skipped" && step["reason"].is_string(), "{step}"),
        }
    }
    let skipped = steps.iter().filter(|s| s["state"] == "skipped").count();
    assert!(skipped >= 1 && summary["skipped"] == skipped && said.matches("SKIPPED ").count() == skipped, "{said}");
    let page = std::fs::read_to_string(out.join("index.html")).unwrap();
    assert!(page.contains("Measured beside predicted") && page.contains("skipped: ") && !page.contains("http"));
}

#[test]
fn measured_figures_are_beside_predicted_ones() {
    let folder = tempfile::tempdir().unwrap();
    let (sets, out) = (folder.path().join("data"), folder.path().join("out"));
    data(&sets);
    let only = "bench_s50k_frame,bench_s50k_train,dnerf_lego";
    let run = gpu_day(&["--out", text(&out), "--data", text(&sets), "--only", only, "--budget", "120"]);
    let (printed, said) = (String::from_utf8(run.stdout).unwrap(), String::from_utf8(run.stderr).unwrap());
    assert!(run.status.success() && printed.contains("H200"), "{printed}{said}");
    let summary = read(&out.join("gpu_day.json"));
    let lego = step(&summary, "dnerf_lego");
    assert!(lego["reason"].as_str().unwrap().contains("dnerf_lego does not exist"), "{lego}");
    assert!(said.contains("SKIPPED training, dnerf_lego"), "{said}");
    for name in ["bench_s50k_frame", "bench_s50k_train"] {
        let figures = step(&summary, name)["figures"].as_array().unwrap();
        let both = |f: &Value| f["predicted"].as_f64().unwrap() > 0.0 && f["measured"].as_f64().unwrap() > 0.0;
        assert!(figures.len() >= 3 && figures.iter().all(both), "{figures:?}");
        assert!(figures.iter().all(|f| f["predicted_on"] == "H200" && f["same_device"] == false), "{figures:?}");
        assert_eq!(read(&out.join(format!("{name}.json")))["scene"]["gaussians"], 300);
    }
    let page = std::fs::read_to_string(out.join("index.html")).unwrap();
    assert!(page.contains("predicted on H200, µs") && page.contains("dnerf_lego does not exist"));
}

#[test]
fn a_step_that_fails_does_not_stop_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let (sets, out) = (folder.path().join("data"), folder.path().join("out"));
    data(&sets);
    std::fs::write(sets.join("bench_s50k/model.ply"), "no model").unwrap();
    let only = "sort,bench_s50k_frame,bench_s50k_train";
    let run = gpu_day(&["--out", text(&out), "--data", text(&sets), "--only", only, "--budget", "15", "--quiet"]);
    let said = String::from_utf8(run.stderr).unwrap();
    assert_eq!(run.status.code(), Some(3), "{said}");
    assert!(run.stdout.is_empty() && said.contains("FAILED frame, bench_s50k"), "{said}");
    let summary = read(&out.join("gpu_day.json"));
    let states: Vec<&str> = summary["steps"].as_array().unwrap().iter().map(|s| s["state"].as_str().unwrap()).collect();
    assert_eq!((states, &summary["failed"]), (vec!["failed", "failed", "done"], &json!(2)));
    let reason = step(&summary, "bench_s50k_frame")["reason"].as_str().unwrap().to_owned();
    assert!(reason.contains("model.ply"), "{reason}");
    assert!(out.join("sort.json").is_file() && !out.join("bench_s50k_frame.json").exists());
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
        (&["--out", text(&out), "--only", "sort,nonsense"], "found nonsense"),
    ] {
        let run = gpu_day(arguments);
        let error = String::from_utf8(run.stderr).unwrap();
        assert!(run.status.code() == Some(2) && error.contains(said) && error.lines().count() == 1, "{error}");
    }
    assert!(!out.exists());
}
