//! The self-test from outside: the verdict is kept and holds as long as it should, and a driver that does nothing is no device.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stderr, reason = "tests")]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use engine::scene::Scene;
use engine::scene::synthetic::random_gaussians;
use serde_json::Value;

/// A model, cameras and a cache folder of their own.
struct Project(tempfile::TempDir);

impl Project {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let still = Scene { gaussians: random_gaussians(50, 1, 0), ..Scene::default() };
        engine::file::save(&folder.path().join("model.ply"), &still).unwrap();
        let pose = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 4.0], [0.0, 0.0, 0.0, 1.0]];
        let frame = serde_json::json!({ "file_path": "./none", "transform_matrix": pose });
        let cameras = serde_json::json!({ "camera_angle_x": 0.8, "w": 32, "h": 24, "frames": [frame] });
        std::fs::write(folder.path().join("cameras.json"), cameras.to_string()).unwrap();
        Self(folder)
    }

    /// The program with a cache folder of the project's; kernels that Mesa has compiled once stay compiled.
    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_spgs"));
        let home = || std::env::var_os("HOME").map(|home| PathBuf::from(home).join(".cache"));
        if let Some(mesa) = std::env::var_os("XDG_CACHE_HOME").map(PathBuf::from).or_else(home) {
            command.env("MESA_SHADER_CACHE_DIR", mesa);
        }
        command.args(arguments).env("XDG_CACHE_HOME", self.cache()).env_remove("SPGS_SELF_TEST").current_dir(&self.0);
        command
    }

    fn cache(&self) -> PathBuf {
        self.0.path().join("cache")
    }

    fn run(&self, arguments: &[&str]) -> Output {
        let out = self.command(arguments).output().unwrap();
        assert!(out.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&out.stderr));
        out
    }

    /// Renders a picture: the shortest way to use a device.
    fn render(&self, more: &[&str]) {
        let render = ["render", "model.ply", "--cameras", "cameras.json", "--out", "pictures", "--quiet"];
        self.run(&[&render, more].concat());
    }

    /// Files of verdicts of frames.
    fn verdicts(&self) -> Vec<PathBuf> {
        let Ok(entries) = std::fs::read_dir(self.cache().join("spgs")) else { return Vec::new() };
        let name = |p: &Path| p.file_name().unwrap().to_string_lossy().into_owned();
        entries.map(|e| e.unwrap().path()).filter(|p| name(p).starts_with("self-test-frame-")).collect()
    }

    /// The only verdict.
    fn verdict(&self) -> (PathBuf, Value) {
        let files = self.verdicts();
        assert_eq!(files.len(), 1, "{files:?}");
        (files[0].clone(), serde_json::from_slice(&std::fs::read(&files[0]).unwrap()).unwrap())
    }

    fn device(&self) -> Value {
        let list: Value = serde_json::from_slice(&self.run(&["devices", "--json"]).stdout).unwrap();
        let used = list.as_array().unwrap().iter().find(|d| !d["self_test"]["frame"].is_null());
        used.unwrap_or(&list[0]).clone()
    }
}

#[test]
fn a_verdict_is_kept_until_something_changes() {
    let project = Project::new();
    assert!(project.device()["self_test"]["frame"].is_null(), "nothing is known of a device at first");
    project.render(&[]);
    let (file, first) = project.verdict();
    assert!(first["failure"].is_null(), "{first}");
    assert_eq!(project.device()["self_test"]["frame"], first);
    // A run writes how long it took, which no two runs share to the last digit.
    let tested_again = |what: &str, expected: bool, more: &[&str]| {
        let before = std::fs::read(&file).unwrap_or_default();
        project.render(more);
        let after = std::fs::read(&file).unwrap();
        assert_eq!(after != before, expected, "{what}");
        serde_json::from_slice::<Value>(&after).expect(what);
    };
    tested_again("the same device", false, &[]);
    tested_again("--self-test", true, &["--self-test"]);
    for (key, value) in [("driver", "another"), ("shaders", "others"), ("device", "another"), ("cache_uuid", "00")] {
        let (_, mut changed) = project.verdict();
        changed["subject"][key] = value.into();
        std::fs::write(&file, changed.to_string()).unwrap();
        tested_again(key, true, &[]);
    }
    for damaged in ["", "{", "null", "[1, 2]", "\u{0}\u{1}"] {
        std::fs::write(&file, damaged).unwrap();
        tested_again(damaged, true, &[]);
    }
}

#[test]
fn a_known_failure_is_told_without_another_test() {
    let project = Project::new();
    project.render(&[]);
    let (file, mut verdict) = project.verdict();
    let why = "kernel `sort_scatter`: `keys_out` differs in 9 of 9 words";
    verdict["failure"] = why.into();
    std::fs::write(&file, verdict.to_string()).unwrap();
    assert_eq!(project.device()["usable"], false);
    let out = project.command(&["render", "model.ply", "--cameras", "cameras.json", "--out", "more"]).output().unwrap();
    let text = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(1), "{text}");
    let last = text.lines().last().unwrap();
    assert!(last.contains(why) && last.contains("SPGS_SELF_TEST=0") && last.contains("--device"), "{text}");
    assert!(!project.0.path().join("more").exists(), "no half result");
    let skipped = project.command(&["demo", "--frames", "1", "--device", "no such device"]).output().unwrap();
    assert_eq!(skipped.status.code(), Some(2), "a wrong name stays a usage mistake");
    project.render(&["--self-test"]);
    assert!(project.verdict().1["failure"].is_null(), "the device passes when it is tested again");
}

#[test]
fn the_test_can_be_left_out_and_needs_no_cache() {
    let project = Project::new();
    let render = ["render", "model.ply", "--cameras", "cameras.json", "--out", "pictures", "--quiet"];
    let out = project.command(&render).env("SPGS_SELF_TEST", "0").output().unwrap();
    assert!(out.status.success() && project.verdicts().is_empty());
    // A file where the folder should be: nothing can be kept.
    std::fs::remove_dir_all(project.cache()).unwrap_or_default();
    std::fs::write(project.cache(), "no folder").unwrap();
    let out = project.command(&render).output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
}

/// Environment of a driver that `ci/drivers` unpacked. Without it the test is skipped loudly, unless `SPGS_REQUIRE_DATA=1`.
fn driver(name: &str) -> Option<Vec<(String, String)>> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../ci/drivers");
    let wanted =
        format!("unset ${{!VK_*}} LD_PRELOAD; settings=$({} env {name}); eval \"$settings\"; env -0", script.display());
    let out = Command::new("bash").args(["-euc", &wanted]).output().unwrap();
    if !out.status.success() || out.stdout.is_empty() {
        let why = String::from_utf8_lossy(&out.stderr).trim().to_owned();
        assert!(std::env::var("SPGS_REQUIRE_DATA").as_deref() != Ok("1"), "SPGS_REQUIRE_DATA=1, but: {why}");
        eprintln!("SKIPPED: driver `{name}` is not there ({why}); ci/drivers fetch {name}");
        return None;
    }
    let text = String::from_utf8_lossy(&out.stdout).into_owned();
    let pairs = text.split('\0').filter_map(|pair| pair.split_once('='));
    Some(pairs.map(|(k, v)| (k.to_owned(), v.to_owned())).collect())
}

#[test]
fn a_driver_that_does_nothing_is_no_device() {
    let Some(shim) = driver("shim navi31") else { return };
    let project = Project::new();
    let mut demo = project.command(&["demo", "--frames", "1", "--out", "demo"]);
    // The layer waits ten seconds for each submission of a device that never ends one.
    let out =
        demo.envs(shim.clone()).env_remove("SPGS_VALIDATION").env("XDG_CACHE_HOME", project.cache()).output().unwrap();
    let text = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(1), "{text}");
    let last = text.lines().last().unwrap();
    assert!(
        last.starts_with("spgs: ") && last.contains("computes nothing") && last.contains("SPGS_SELF_TEST=0"),
        "{text}"
    );
    assert!(!project.0.path().join("demo").exists(), "no picture");
    // Beside a device that works, that one is used, with a warning.
    let Some(lavapipe) = driver("lavapipe-backports") else { return };
    let of = |list: &[(String, String)], key: &str| {
        list.iter().find(|(k, _)| k == key).map(|(_, v)| v.clone()).unwrap_or_default()
    };
    let both = format!("{}:{}", of(&shim, "VK_DRIVER_FILES"), of(&lavapipe, "VK_DRIVER_FILES"));
    let render = ["render", "model.ply", "--cameras", "cameras.json", "--out", "pictures"];
    let mut command = project.command(&render);
    let out = command
        .envs(shim)
        .env_remove("SPGS_VALIDATION")
        .env("XDG_CACHE_HOME", project.cache())
        .env("VK_DRIVER_FILES", both)
        .output()
        .unwrap();
    let text = String::from_utf8(out.stderr).unwrap();
    assert!(out.status.success() && text.contains("warning") && text.contains("computes nothing"), "{text}");
}
