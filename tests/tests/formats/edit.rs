//! `spgs edit`, as a person runs it, and its result on the GPU.

use std::path::Path;

use clap::Parser as _;
use engine::file;
use engine::scene::synthetic::{moving_scene, random_scene};
use engine::scene::{Camera, MotionSource};
use glam::DVec3;
use tools::cli::args::{Cli, Command};
use tools::command::edit::Summary;

use super::convert::text;

fn edit(args: &[&str]) -> engine::Result<Summary> {
    let cli = Cli::try_parse_from(["spgs", "--quiet", "edit"].iter().chain(args)).unwrap();
    match &cli.command {
        Command::Edit(args) => tools::command::edit::edit(args, &cli.global),
        _ => unreachable!("the subcommand is edit"),
    }
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

const SCRIPT: &str = "# a part of it, seen from the front\n\
                      camera eye 0.3,-1,-4.5 target 0,0,0 up 0,-1,0 size 160,120 time 0.4\n\
                      select click 80,60 similar 30px\n\
                      rotate z 30 pivot center frame part\n\
                      duplicate; move 0.5,0,0 during 0.2..0.5\n\
                      select all; rotate y 40; scale 0.9; time reverse\n\
                      merge \"MORE\" at 0,-1,0 time 0.25+0.5t";

#[test]
fn a_script_and_its_list_make_the_same_file_which_the_gpu_draws() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    file::save(&at("in.safetensors"), &moving_scene(1500, 8, 7, 4, true)).unwrap();
    file::save(&at("more.safetensors"), &moving_scene(400, 3, 4, 5, false)).unwrap();
    let script = SCRIPT.replace("MORE", text(&at("more.safetensors")));
    std::fs::write(at("script.txt"), &script).unwrap();

    let dry = edit(&[text(&at("in.safetensors")), "--script", text(&at("script.txt")), "--dry-run"]).unwrap();
    assert_eq!(names(folder.path()), ["in.safetensors", "more.safetensors", "script.txt"]);
    let done = edit(&[text(&at("in.safetensors")), text(&at("out.safetensors")), "--script", text(&at("script.txt"))])
        .unwrap();
    assert_eq!(dry.steps, done.steps);
    assert!(done.steps.iter().any(|s| s.touched.keys_added > 0 && s.touched.error_px.is_some_and(|px| px <= 0.1)));
    assert_eq!(done.gaussians[1], 1500 + 400 + done.steps[4].touched.gaussians);

    edit(&[text(&at("in.safetensors")), text(&at("again.safetensors")), "--script", text(&at("out.edits.toml"))])
        .unwrap();
    let [one, two] = ["out.safetensors", "again.safetensors"].map(|name| std::fs::read(at(name)).unwrap());
    assert!(one == two, "the list makes another file");
    let [one, two] = ["out.edits.toml", "again.edits.toml"].map(|name| std::fs::read_to_string(at(name)).unwrap());
    assert_eq!(one, two);

    let scene = file::load(&at("out.safetensors")).unwrap().scene;
    assert!(scene.metadata["edits"].contains("select click 80,60 similar 30px\nrotate z 30"));
    let gpu = tests_harness::gpu();
    let camera = Camera::look_at(DVec3::new(0.3, -1.0, -4.5), DVec3::ZERO, DVec3::NEG_Y, 0.8, [160, 120]);
    for time in [0.0, 0.4] {
        let c = tests_harness::compare::compare(&gpu, &scene, &camera, time, MotionSource::Auto);
        c.assert_within_bounds(&format!("edited, at {time}"));
    }
}

#[test]
fn mistakes_leave_no_file_and_say_where_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    file::save(&at("in.ply"), &random_scene(50, 4, 1)).unwrap();
    std::fs::write(at("bad.txt"), "select all\n  move 1,0,0\nselect sphere 0,0 1\n").unwrap();
    std::fs::write(at("bad.edits.toml"), "format = \"spgs edits\"\nversion = 1\nbound_px = oops\n").unwrap();
    std::fs::write(at("no_text.txt"), [0x73, 0xff, 0x00]).unwrap();
    let (input, output) = (at("in.ply"), at("out.safetensors"));
    let rejected = |rest: &[&str], code: u8, words: &[&str]| {
        let error = edit(&[&[text(&input), text(&output)], rest].concat()).unwrap_err();
        assert_eq!(error.exit_code(), code, "{error}");
        words.iter().for_each(|word| assert!(error.to_string().contains(word), "{error}"));
        assert_eq!(names(folder.path()), ["bad.edits.toml", "bad.txt", "in.ply", "no_text.txt"], "{error}");
    };
    rejected(&["--script", text(&at("bad.txt"))], 3, &["bad.txt", "line 3, column 15", "`0,0`", "x,y,z"]);
    rejected(&["--script", text(&at("bad.edits.toml"))], 3, &["bad.edits.toml", "line 3, column 12"]);
    rejected(&["--script", text(&at("no_text.txt"))], 3, &["no_text.txt", "byte 1"]);
    rejected(&["--script", text(&at("none.txt"))], 3, &["none.txt", "open"]);
    rejected(&["-e", "select all; frob"], 2, &["-e: line 1, column 13", "`frob`"]);
    rejected(&["-e", "select all; move 1,0,0; time reverse"], 2, &["-e: line 1, column 25", "nothing moves"]);
    rejected(&["-e", "delete"], 2, &["column 1 (`delete`)", "select"]);
    rejected(&["-e", "select click 3,3 view 0"], 2, &["without cameras", "--data"]);
    rejected(&["-e", "merge nothing.ply"], 3, &["-e: line 1, column 1", "`merge nothing.ply`", "nothing.ply: open"]);
    rejected(&["-e", "select all", "--data", text(&at("none"))], 3, &["none"]);
    let plain = edit(&[text(&input), text(&at("plain.ply")), "-e", "select all; scale 0.5 pivot origin"]).unwrap();
    assert!(plain.dropped.is_empty() && at("plain.ply").exists() && at("plain.edits.toml").exists());
    let moving = folder.path().join("moving.safetensors");
    file::save(&moving, &moving_scene(50, 2, 3, 1, false)).unwrap();
    let error = edit(&[text(&moving), text(&at("moving.ply")), "-e", "select all; scale 0.5"]).unwrap_err();
    assert!(error.to_string().contains("--time") && !at("moving.ply").exists(), "{error}");
    let error = edit(&[text(&input), text(&at("out.xyz")), "-e", "select all"]).unwrap_err();
    assert!(error.to_string().contains(".xyz") && error.exit_code() == 2, "{error}");
    let error = edit(&[text(&input), text(&at("no/folder.ply")), "-e", "select all"]).unwrap_err();
    assert!(error.to_string().contains("folder"), "{error}");
}
