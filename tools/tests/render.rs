//! `spgs render --path` and `--video` from outside: which frames there are, what an encoder gets, and that a video is
//! there whole or not at all.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
#![cfg(unix)] // The encoder is a shell script.

use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use engine::file::picture;
use engine::scene::synthetic::moving_scene;
use serde_json::Value;

struct Project(tempfile::TempDir);

impl Project {
    /// `model.safetensors` that moves, `cameras.json` with three 24x16 frames, and `bin/` for a made-up encoder.
    fn new() -> Self {
        let project = Self(tempfile::tempdir().unwrap());
        engine::file::save(&project.path("model.safetensors"), &moving_scene(200, 4, 5, 2, false)).unwrap();
        let frame = |x: f64, time: f64| {
            let pose = [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 4.0], [0.0, 0.0, 0.0, 1.0]];
            serde_json::json!({ "file_path": "./none", "time": time, "transform_matrix": pose })
        };
        let frames = [frame(-0.5, 0.0), frame(0.0, 0.5), frame(0.5, 1.0)];
        let cameras = serde_json::json!({ "camera_angle_x": 0.8, "w": 24, "h": 16, "frames": frames });
        std::fs::write(project.path("cameras.json"), cameras.to_string()).unwrap();
        std::fs::create_dir(project.path("bin")).unwrap();
        project
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Puts a shell script named `ffmpeg` on the only `PATH` there is.
    fn encoder(&self, script: &str) {
        let path = self.path("bin/ffmpeg");
        std::fs::write(&path, format!("#!/bin/sh\n{script}\n")).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
    }

    fn render(&self, arguments: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_spgs"))
            .current_dir(self.0.path())
            .args(["render", "model.safetensors"])
            .args(arguments)
            .env("PATH", self.path("bin"))
            .output()
            .unwrap()
    }

    fn ok(&self, arguments: &[&str]) -> (Value, String) {
        let out = self.render(&[arguments, &["--json"]].concat());
        let errors = String::from_utf8(out.stderr).unwrap();
        assert!(out.status.success(), "{arguments:?}: {errors}");
        (serde_json::from_slice(&out.stdout).unwrap(), errors)
    }

    fn mistake(&self, arguments: &[&str], code: i32) -> String {
        let out = self.render(arguments);
        let text = String::from_utf8(out.stderr).unwrap();
        assert_eq!(out.status.code(), Some(code), "{arguments:?}: {text}");
        assert_eq!(text.lines().filter(|l| !l.starts_with("spgs: warning")).count(), 1, "{text}");
        text
    }

    /// Names in a folder, hidden ones too.
    fn names(&self, folder: &str) -> Vec<String> {
        let list = std::fs::read_dir(self.path(folder)).into_iter().flatten();
        let mut names: Vec<String> = list.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }
}

fn times(json: &Value) -> Vec<f64> {
    json["frames"].as_array().unwrap().iter().map(|f| f["time"].as_f64().unwrap()).collect()
}

fn bytes_of(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap()
}

#[test]
fn every_path_makes_the_frames_that_were_asked_for() {
    let p = Project::new();
    let (turn, _) = p.ok(&["--path", "turntable", "--frames", "4", "--width", "24", "--out", "turn"]);
    assert_eq!(p.names("turn"), ["00000.png", "00001.png", "00002.png", "00003.png"]);
    assert_eq!(turn["frames"][0]["height"], 18, "4:3 without cameras");
    assert_eq!(times(&turn), [0.0, 0.25, 0.5, 0.75]);
    let pictures: Vec<_> = (0..4).map(|i| bytes_of(&p.path(&format!("turn/0000{i}.png")))).collect();
    assert!(pictures.windows(2).all(|w| w[0] != w[1]), "the camera stands still");
    let (time, _) = p.ok(&[
        "--path",
        "time",
        "--cameras",
        "cameras.json",
        "--frame",
        "1",
        "--seconds",
        "0.5",
        "--fps",
        "10",
        "--out",
        "t",
    ]);
    assert_eq!(times(&time), [0.0, 0.25, 0.5, 0.75, 1.0]);
    // The middle frame of a sweep is the view of that camera at that time.
    p.ok(&["--cameras", "cameras.json", "--frame", "1", "--out", "one"]);
    assert_eq!(bytes_of(&p.path("t/00002.png")), bytes_of(&p.path("one/00001.png")));
    let (back, _) = p.ok(&["--path", "time", "--times", "1,0", "--frames", "2", "--width", "16", "--out", "back"]);
    assert_eq!(times(&back), [1.0, 0.0]);
    // Through the cameras, and through the same views as a recorded path: every view is met.
    let (through, _) = p.ok(&["--path", "cameras", "--cameras", "cameras.json", "--frames", "5", "--out", "through"]);
    assert_eq!(times(&through), [0.0, 0.25, 0.5, 0.75, 1.0]);
    p.ok(&["--path", "cameras.json", "--frames", "5", "--out", "recorded"]);
    for i in 0..5 {
        let name = format!("0000{i}.png");
        assert_eq!(bytes_of(&p.path("through").join(&name)), bytes_of(&p.path("recorded").join(&name)));
    }
    assert_eq!(bytes_of(&p.path("through/00002.png")), bytes_of(&p.path("one/00001.png")));
}

#[test]
fn motion_blur_and_supersampling_average_linear_values() {
    let p = Project::new();
    let common = ["--path", "time", "--cameras", "cameras.json", "--format", "exr"];
    let all = |extra: &[&str]| p.ok(&[&common[..], extra].concat());
    // A shutter that is open all the time, four sub-frames: the mean of the frames at their moments.
    all(&["--frames", "2", "--times", "0,1", "--motion-blur", "2", "--shutter", "0.5", "--out", "blur"]);
    for (name, moments) in [("00000", ["0", "0.125"]), ("00001", ["0.875", "1"])] {
        let mut sum = Vec::new();
        for moment in moments {
            p.ok(&["--cameras", "cameras.json", "--frame", "0", "--time", moment, "--format", "exr", "--out", "sharp"]);
            let image = picture::read(&p.path("sharp/00000.exr")).unwrap();
            sum.resize(image.rgba.len(), 0.0);
            sum.iter_mut().zip(&image.rgba).for_each(|(s, v)| *s += v / 2.0);
        }
        let blurred = picture::read(&p.path(&format!("blur/{name}.exr"))).unwrap();
        let worst = blurred.rgba.iter().zip(&sum).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst < 1e-5, "{name}: {worst}");
    }
    // Three times as wide and high, averaged.
    all(&["--frames", "1", "--supersample", "3", "--out", "smooth"]);
    all(&["--frames", "1", "--width", "72", "--height", "48", "--out", "large"]);
    let smooth = picture::read(&p.path("smooth/00000.exr")).unwrap();
    let large = picture::read(&p.path("large/00000.exr")).unwrap();
    assert_eq!([smooth.width, smooth.height], [24, 16]);
    let (x, y) = (11, 7);
    for c in 0..4 {
        let inside = (0..9).map(|i| large.rgba[4 * ((3 * y + i / 3) * 72 + 3 * x + i % 3) + c]);
        let mean = inside.sum::<f32>() / 9.0;
        assert!((smooth.rgba[4 * (y * 24 + x) + c] - mean).abs() < 1e-5);
    }
}

#[test]
fn an_encoder_gets_raw_frames_and_the_video_appears_whole() {
    let p = Project::new();
    p.encoder("echo \"$@\" > arguments\nfor last; do :; done\n/bin/cat > \"$last\"");
    let arguments =
        ["--path", "time", "--frames", "3", "--fps", "12.5", "--cameras", "cameras.json", "--video", "v/film.mp4"];
    let (json, errors) = p.ok(&arguments);
    assert!(errors.is_empty(), "{errors}");
    assert_eq!(json["video"], "v/film.mp4");
    assert!(json["frames"][0]["file"].is_null());
    assert_eq!(p.names("v"), ["film.mp4"], "and nothing unfinished");
    let raw = bytes_of(&p.path("v/film.mp4"));
    assert_eq!(raw.len(), 3 * 24 * 16 * 3);
    let said = std::fs::read_to_string(p.path("arguments")).unwrap();
    assert!(said.contains("-video_size 24x16") && said.contains("-framerate 12.5") && said.contains("rgb24"), "{said}");
    // The same pixels as the pictures; both when both are asked for.
    p.ok(&[&arguments[..], &["--out", "pictures"]].concat());
    let frame = picture::read(&p.path("pictures/00001.png")).unwrap();
    let expected: Vec<u8> =
        frame.rgba.chunks(4).flat_map(|c| [c[0], c[1], c[2]]).map(|v| (v * 255.0).round() as u8).collect();
    assert_eq!(&raw[24 * 16 * 3..2 * 24 * 16 * 3], &expected[..]);
}

#[test]
fn a_failing_encoder_leaves_no_video_and_says_why() {
    let p = Project::new();
    let arguments = ["--path", "time", "--frames", "40", "--cameras", "cameras.json", "--video", "film.mp4"];
    std::fs::write(p.path("film.mp4"), "the old film").unwrap();
    for script in [
        "echo 'no such codec' >&2; exit 1",
        "/usr/bin/head -c 100 > /dev/null; echo 'no such codec' >&2; exit 1",
        "for last; do :; done; /bin/cat > \"$last\"; echo 'no such codec' >&2; exit 3",
    ] {
        p.encoder(script);
        let line = p.mistake(&arguments, 3);
        assert!(line.contains("film.mp4") && line.contains("no such codec"), "{line}");
        assert_eq!(std::fs::read_to_string(p.path("film.mp4")).unwrap(), "the old film");
        let names = p.names(".");
        assert!(!names.iter().any(|n| n.contains("unfinished")), "{names:?}");
    }
    // One that writes nothing.
    p.encoder("/bin/cat > /dev/null");
    assert!(p.mistake(&arguments, 3).contains("film.mp4"));
}

#[test]
fn without_an_encoder_there_are_pictures_and_one_line() {
    let p = Project::new();
    let (json, errors) = p.ok(&["--path", "time", "--frames", "2", "--cameras", "cameras.json", "--video", "film.mp4"]);
    assert!(json["video"].is_null());
    assert_eq!(errors.lines().count(), 1, "{errors}");
    assert!(errors.contains("ffmpeg") && errors.contains("film.mp4"), "{errors}");
    assert_eq!(p.names("film"), ["00000.png", "00001.png"]);
    assert!(!p.path("film.mp4").exists());
}

#[test]
fn mistakes_are_said_before_anything_is_written() {
    let p = Project::new();
    let usage = [
        (&["--path", "turntable"][..], "--out"),
        (&["--out", "o"], "--cameras"),
        (&["--path", "cameras", "--out", "o"], "--cameras"),
        (&["--path", "time", "--frames", "0", "--out", "o"], "--frames"),
        (&["--path", "time", "--frames", "2", "--seconds", "1", "--out", "o"], "--seconds"),
        (&["--path", "time", "--seconds", "0", "--out", "o"], "--seconds"),
        (&["--path", "time", "--seconds", "1e6", "--fps", "1000", "--out", "o"], "--fps"),
        (&["--path", "time", "--fps", "nan", "--out", "o"], "--fps"),
        (&["--path", "time", "--times", "0", "--out", "o"], "--times"),
        (&["--path", "turntable", "--up", "0,0,0", "--out", "o"], "--up"),
        (&["--path", "time", "--frame", "7", "--out", "o"], "--frame"),
        (&["--path", "time", "--cameras", "cameras.json", "--frame", "7", "--out", "o"], "--frame"),
        (&["--path", "cameras.json", "--cameras", "cameras.json", "--out", "o"], "cameras"),
        (&["--path", "time", "--motion-blur", "0", "--out", "o"], "--motion-blur"),
        (&["--path", "time", "--shutter", "2", "--out", "o"], "--shutter"),
        (&["--path", "time", "--supersample", "17", "--out", "o"], "--supersample"),
        (&["--cameras", "cameras.json", "--frames", "3", "--out", "o"], "--path"),
        (&["--path", "time", "--video", "film"], "--video"),
        (&["--path", "time", "--video", "bin"], "--video"),
    ];
    for (arguments, what) in usage {
        let line = p.mistake(arguments, 2);
        assert!(line.contains(what), "{arguments:?}: {line}");
    }
    assert!(p.mistake(&["--path", "no/such.json", "--out", "o"], 3).contains("no/such.json"));
    // Larger than a picture may be.
    let large = ["--path", "time", "--frames", "1", "--width", "2000", "--supersample", "16", "--out", "large"];
    assert!(p.mistake(&large, 4).contains("16384"));
    assert!(!p.path("o").exists());
}
