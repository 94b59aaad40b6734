//! The `spgs` program from outside: exit codes, one line for each mistake, never half a file.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::path::Path;
use std::process::{Command, Output};

use engine::scene::synthetic::{moving_scene, random_gaussians};
use engine::scene::{Gaussians, Scene};

fn spgs(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_spgs")).args(arguments).output().unwrap()
}

/// The one line that a mistake gets, after checking the exit code.
fn mistake(arguments: &[&str], code: i32) -> String {
    let out = spgs(arguments);
    let text = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(code), "{arguments:?}: {text}");
    assert!(out.stdout.is_empty(), "{arguments:?} wrote to standard output");
    let lines: Vec<&str> = text.lines().filter(|l| !l.starts_with("spgs: warning: ")).collect();
    assert_eq!(lines.len(), 1, "{arguments:?}: {text}");
    assert!(lines[0].starts_with("spgs: ") && !lines[0].contains("panicked"), "{text}");
    lines[0].to_owned()
}

fn ok(arguments: &[&str]) -> String {
    let out = spgs(arguments);
    assert!(out.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap()
}

fn ok_json(arguments: &[&str]) -> serde_json::Value {
    serde_json::from_str(&ok(arguments)).unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A folder with `model.ply`, a moving `moving.safetensors` and `cameras.json` (three 48x32 frames).
fn project() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let still = Scene { gaussians: random_gaussians(200, 1, 1), ..Scene::default() };
    engine::file::save(&path("model.ply"), &still).unwrap();
    engine::file::save(&path("moving.safetensors"), &moving_scene(200, 4, 5, 2, false)).unwrap();
    let frame = |time: f64| {
        let pose = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 4.0], [0.0, 0.0, 0.0, 1.0]];
        serde_json::json!({ "file_path": "./none", "time": time, "transform_matrix": pose })
    };
    let cameras = serde_json::json!({
        "camera_angle_x": 0.8, "w": 48, "h": 32, "frames": [frame(0.0), frame(0.5), frame(1.0)],
    });
    std::fs::write(path("cameras.json"), cameras.to_string()).unwrap();
    folder
}

#[test]
fn usage_mistakes_are_code_2() {
    assert!(mistake(&[], 2).contains("subcommand"));
    assert!(mistake(&["nonsense"], 2).contains("nonsense"));
    assert!(mistake(&["demo", "--frames", "0"], 2).contains("--frames"));
    assert!(mistake(&["demo", "--frames", "x"], 2).contains("--frames"));
    assert!(mistake(&["render", "m.ply"], 2).ends_with("--out <DIR>; see spgs render --help"));
    let line = mistake(&["render", "m.ply", "--out", "o"], 2);
    assert!(line.contains("--cameras") && line.contains("--path"), "{line}");
    assert!(mistake(&["devices", "--nonsense"], 2).contains("--nonsense"));
    for background in ["1,2", "a,b,c", "1,2,nan"] {
        let line = mistake(&["render", "m", "--cameras", "c", "--out", "o", "--background", background], 2);
        assert!(line.contains("--background") && line.contains(background), "{line}");
    }
    assert!(mistake(&["render", "m", "--cameras", "c", "--out", "o", "--time", "inf"], 2).contains("--time"));
    assert!(mistake(&["render", "m", "--cameras", "c", "--out", "o", "--format", "gif"], 2).contains("gif"));
    assert!(mistake(&["bench", "m.ply", "--synthetic", "5"], 2).contains("--synthetic"));
    assert!(mistake(&["bench", "frame", "--nonsense"], 2).ends_with("see spgs bench frame --help"));
}

#[test]
fn the_modes_of_bench_say_how_they_are_called_now() {
    for (old, new) in [
        (&["bench", "--train", "--synthetic", "10"][..], "`spgs bench train`"),
        (&["bench", "--paper"], "`spgs bench paper`"),
        (&["bench", "--ablation", "DATA"], "`spgs bench ablation DATA`"),
        (&["bench", "--hard-cases"], "`spgs bench hard-cases`"),
    ] {
        assert!(mistake(old, 2).contains(new), "{}", mistake(old, 2));
    }
    assert!(mistake(&["bench", "--synthetic", "5", "sweep"], 2).contains("--synthetic in front of `sweep`"));
    let all = ok(&["bench", "--help"]);
    for mode in ["frame", "train", "sweep", "paper", "sort", "ablation", "hard-cases"] {
        assert!(all.contains(mode) && ok(&["bench", mode, "--help"]).contains("--json"), "{mode}");
    }
    assert!(all.contains("gpu-day") && ok(&["bench", "gpu-day", "--help"]).contains("--budget"), "{all}");
}

#[test]
fn help_explains_commands_and_topics() {
    let all = ok(&["help"]);
    assert_eq!(all, ok(&["--help"]));
    assert!(all.contains("render") && all.contains("Topics") && all.contains("model-file"), "{all}");
    assert_eq!(ok(&["help", "render"]), ok(&["render", "--help"]));
    assert!(ok(&["help", "model-file"]).contains("gaussians.opacity_logit"));
    let line = mistake(&["help", "nonsense"], 2);
    assert!(line.contains("nonsense") && line.contains("model-file") && line.contains("drivers"), "{line}");
}

#[test]
fn an_unknown_device_is_a_usage_mistake_that_lists_what_there_is() {
    for device in ["99", "no such device"] {
        let line = mistake(&["demo", "--device", device], 2);
        assert!(line.contains(device) && line.contains("[0]"), "{line}");
    }
}

#[test]
fn bad_files_are_code_3_and_name_file_and_place() {
    let folder = project();
    let bad = folder.path().join("bad.ply");
    assert!(mistake(&["inspect", "/no/such/file.ply"], 3).contains("/no/such/file.ply"));
    std::fs::write(&bad, b"not a model at all").unwrap();
    assert!(mistake(&["inspect", text(&bad)], 3).contains("bad.ply"));
    let whole = std::fs::read(folder.path().join("model.ply")).unwrap();
    std::fs::write(&bad, &whole[..whole.len() - 7]).unwrap();
    let out = folder.path().join("out");
    let cameras = folder.path().join("cameras.json");
    let line = mistake(&["render", text(&bad), "--cameras", text(&cameras), "--out", text(&out)], 3);
    assert!(line.contains("bad.ply") && line.contains("byte"), "{line}");
    assert!(!out.exists(), "a failed render left its folder");
    let broken = folder.path().join("broken.json");
    std::fs::write(&broken, b"{\"frames\": [").unwrap();
    let model = folder.path().join("model.ply");
    assert!(
        mistake(&["render", text(&model), "--cameras", text(&broken), "--out", text(&out)], 3).contains("broken.json")
    );
    assert!(!out.exists(), "a failed render left its folder");
}

#[test]
fn frames_and_motion_that_are_not_there_are_usage_mistakes() {
    let folder = project();
    let (model, cameras, out) =
        (folder.path().join("model.ply"), folder.path().join("cameras.json"), folder.path().join("out"));
    let base = ["render", text(&model), "--cameras", text(&cameras), "--out", text(&out)];
    let line = mistake(&[&base[..], &["--frame", "3"]].concat(), 2);
    assert!(line.contains("--frame") && line.contains('3') && line.contains("0 to 2"), "{line}");
    for motion in ["table", "network"] {
        mistake(&[&base[..], &["--motion", motion]].concat(), 2);
    }
    let report = ["bench", "--synthetic", "10", "--frames", "1", "--width", "16", "--json", "/no/such/folder/x.json"];
    assert!(mistake(&report, 2).contains("/no/such/folder"));
}

#[test]
fn render_writes_the_frames_that_were_asked_for() {
    let folder = project();
    let (model, cameras, out) =
        (folder.path().join("moving.safetensors"), folder.path().join("cameras.json"), folder.path().join("out"));
    let base = ["render", text(&model), "--cameras", text(&cameras), "--out", text(&out)];
    let summary = ok_json(&[&base[..], &["--json"]].concat());
    assert_eq!(summary["frames"].as_array().unwrap().len(), 3);
    assert_eq!(summary["frames"][1]["time"], 0.5);
    let read = |name: &str| engine::file::picture::read(&out.join(name)).unwrap();
    let (first, middle) = (read("00000.png"), read("00001.png"));
    assert_eq!((first.width, first.height), (48, 32));
    assert_ne!(first.rgba, middle.rgba, "nothing moved between t = 0 and t = 0.5");
    ok(&[&base[..], &["--frame", "2", "--frame", "0", "--format", "exr", "--time", "0.5", "--width", "24", "--quiet"]]
        .concat());
    let (exr, other) = (read("00002.exr"), read("00000.exr"));
    assert_eq!((exr.width, exr.height), (24, 16));
    assert_eq!(exr.depth.len(), 24 * 16);
    assert_eq!(exr.rgba, other.rgba, "the same view at the same time");
    assert!(!out.join("00001.exr").exists());
}

#[test]
fn bad_gaussians_are_counted_in_a_warning() {
    let folder = project();
    let model = folder.path().join("poisoned.ply");
    let mut gaussians: Gaussians = random_gaussians(10, 3, 0);
    gaussians.mean[4][1] = f32::NAN;
    gaussians.rotation[7] = [0.0; 4];
    engine::file::save(&model, &Scene { gaussians, ..Scene::default() }).unwrap();
    let (cameras, out) = (folder.path().join("cameras.json"), folder.path().join("out"));
    let run =
        spgs(&["render", text(&model), "--cameras", text(&cameras), "--out", text(&out), "--frame", "0", "--json"]);
    assert!(run.status.success());
    let warnings = String::from_utf8(run.stderr).unwrap();
    assert!(warnings.contains("2 of 10 Gaussians are skipped"), "{warnings}");
    let summary: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
    assert_eq!(summary["gaussians"], 8);
    assert_eq!(summary["rejected"]["not_finite"], 1);
    assert_eq!(summary["rejected"]["zero_rotation"], 1);
}

#[test]
fn inspect_and_devices_describe() {
    let folder = project();
    let model = folder.path().join("moving.safetensors");
    let description = ok_json(&["inspect", text(&model), "--json"]);
    assert_eq!(description["gaussians"], 200);
    assert!(ok(&["inspect", text(&model)]).contains("200"));
    let devices = ok_json(&["devices", "--json"]);
    let first = &devices.as_array().unwrap()[0];
    assert!(first["device"]["name"].is_string() && first["requirements"].as_array().unwrap().len() > 5);
    assert!(ok(&["devices"]).contains("subgroups"));
}

#[test]
fn demo_and_bench_report_what_they_measured() {
    let folder = tempfile::tempdir().unwrap();
    let (pictures, json, page) =
        (folder.path().join("demo"), folder.path().join("bench.json"), folder.path().join("bench.html"));
    let demo = ok_json(&["demo", "--frames", "2", "--out", text(&pictures), "--json"]);
    assert!(demo["measurement"]["fps"].as_f64().unwrap() > 0.0);
    assert!(pictures.join("00000.png").is_file() && pictures.join("00001.png").is_file());
    let size = ["--width", "64", "--height", "48", "--frames", "3", "--warmup", "1", "--check"];
    let scene = ["bench", "--synthetic", "2000", "--superpoints", "8", "--json", text(&json), "--report", text(&page)];
    let printed = ok(&[&scene[..], &size[..]].concat());
    assert!(printed.contains("dispatches") && printed.contains("blend"), "{printed}");
    let record: serde_json::Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
    assert_eq!(record["scene"]["gaussians"], 2000);
    let measured = &record["measurement"];
    assert!(measured["frame_ms"]["median"].as_f64().unwrap() > 0.0);
    assert!(measured["copy_gb_per_s"].as_f64().unwrap() > 0.0);
    assert!(measured["bytes_per_gaussian"].as_f64().unwrap() > 0.0);
    assert!(measured["dispatches"].as_u64().unwrap() <= 18);
    assert!(record["error_against_f64"]["psnr"].as_f64().unwrap() >= 65.0, "{}", record["error_against_f64"]);
    let rows = measured["operations"].as_array().unwrap();
    assert!(rows.iter().any(|r| r["kernel"] == "blend" && r["bytes"].as_u64().unwrap() > 0));
    let html = std::fs::read_to_string(&page).unwrap();
    assert!(html.contains("<svg") && html.contains("blend") && !html.contains("http"), "a self-contained page");
    assert!(html.contains("Predicted on H200") && printed.contains("predicted, not measured"), "{printed}");
    prediction(&record["predicted"], measured);
}

/// A prediction is of what was recorded, and its parts add up.
fn prediction(predicted: &serde_json::Value, measured: &serde_json::Value) {
    assert_eq!(predicted["dispatches"], measured["dispatches"]);
    assert_eq!(predicted["barriers"], measured["barriers"]);
    let share = |name: &str| predicted["subtiles"][name].as_f64().unwrap();
    assert!((0.25..=1.0).contains(&share("reached")) && (0.0..=1.0).contains(&share("blended")), "{predicted}");
    let gpus = predicted["gpus"].as_array().unwrap();
    assert_eq!(
        gpus.iter().map(|g| g["gpu"].as_str().unwrap()).collect::<Vec<_>>(),
        ["H200", "RTX 4090", "RX 7900 XTX"]
    );
    for gpu in gpus {
        let operations = gpu["operations"].as_array().unwrap();
        let us: f64 = operations.iter().map(|o| o["us"].as_f64().unwrap()).sum();
        assert!((us / 1e3 - gpu["device_ms"].as_f64().unwrap()).abs() < 1e-9 && us > 10.0, "{us}");
        let blend = operations.iter().find(|o| o["label"] == "blend").unwrap();
        assert!(blend["dispatch"]["issued"].as_f64() > blend["dispatch"]["instructions"].as_f64(), "{blend}");
        assert!(gpu["constants"].as_array().unwrap().iter().all(|c| !c["source"].as_str().unwrap().is_empty()));
        assert!(gpu["goal"].is_null(), "the goal is of another scene");
    }
}

#[test]
fn bench_measures_training_of_a_synthetic_scene_and_of_photos() {
    let folder = tempfile::tempdir().unwrap();
    let (json, page) = (folder.path().join("train.json"), folder.path().join("train.html"));
    let scene = ["bench", "train", "--synthetic", "600", "--superpoints", "5", "--width", "40", "--height", "32"];
    let files = ["--frames", "2", "--warmup", "1", "--json", text(&json), "--report", text(&page)];
    let printed = ok(&[&scene[..], &files[..]].concat());
    assert!(printed.contains("blend_backward") && printed.contains("times)"), "{printed}");
    let record: serde_json::Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
    assert_eq!((&record["scene"]["gaussians"], &record["scene"]["superpoints"]), (&600.into(), &5.into()));
    let measured = &record["training"];
    let positive = |key: &str| assert!(measured[key].as_f64().unwrap() > 0.0, "{key}: {}", measured[key]);
    ["dispatches", "barriers", "copy_gb_per_s", "steps_per_second", "state_ratio"].into_iter().for_each(positive);
    assert!(measured["step_ms"]["p95"].as_f64() >= measured["step_ms"]["median"].as_f64());
    assert!(measured["memory"]["parameters"].as_u64().unwrap() >= 600 * 59 * 4);
    assert!(measured["last_step"]["superpoints"] == 5 && measured["last_step"]["loss"].as_f64().unwrap() > 0.0);
    // Every kernel says what it moves, network F's products by their own sizes.
    let rows = measured["kernels"].as_array().unwrap();
    for name in ["blend", "image_loss", "blend_backward", "deform_project_backward", "linear_forward", "superpoint_sum"]
    {
        let row = rows.iter().find(|r| r["kernel"] == name).unwrap_or_else(|| panic!("no row for {name}"));
        assert!(row["bytes"].as_u64().unwrap() > 0 && row["us"].as_f64().unwrap() > 0.0, "{row}");
    }
    prediction(&measured["predicted"], measured);
    let html = std::fs::read_to_string(&page).unwrap();
    assert!(
        html.contains("<svg") && html.contains("linear_forward") && !html.contains("http"),
        "a self-contained page"
    );

    assert!(mistake(&["bench", "sweep", "--quality", "high"], 2).contains("--quality"));
    assert!(mistake(&["bench", "train", "model.ply"], 2).contains("--cameras"));
    assert!(mistake(&["bench", "train", "--check"], 2).contains("--check"));
}
