//! `spgs distill`, as a person runs it: fields and networks become superpoints that the GPU draws alike.

use std::path::Path;

use clap::Parser as _;
use engine::data::camera_file;
use engine::file;
use engine::reference::place_scene;
use engine::scene::synthetic::{moving_scene, random_gaussians};
use engine::scene::{Camera, Deformation, MotionSource, Scene};
use glam::DVec3;
use tests_harness::data;
use tools::cli::args::{Cli, Command};
use tools::command::distill::Summary;

use crate::checkpoints::run_folder;
use crate::convert::text;

fn distill(args: &[&str]) -> engine::Result<Summary> {
    let cli = Cli::try_parse_from(["spgs", "--quiet", "distill"].iter().chain(args)).unwrap();
    match &cli.command {
        Command::Distill(args) => tools::command::distill::distill(args, &cli.global).map(|(_, summary)| summary),
        _ => unreachable!("the subcommand is distill"),
    }
}

fn names(folder: &Path) -> Vec<String> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// A teacher of network F alone.
fn network() -> Scene {
    let mut scene = moving_scene(400, 5, 5, 3, true);
    scene.deformation.superpoint_deformation_mut().unwrap().table = None;
    scene
}

#[test]
fn the_real_sample_becomes_superpoints() {
    let Some(path) = data("checkpoint_samples/deformable3dgs_deform_iter20000.pth") else { return };
    let bytes = std::fs::read(&path).unwrap();
    let run = run_folder(&random_gaussians(60, 8, 1), &[("deform/iteration_300/deform.pth", bytes)]);
    let out = run.path().join("student");
    let said = distill(&[text(run.path()), "--out", text(&out), "--error", "0.5", "--teacher-views", "3"]).unwrap();
    assert_eq!(names(&out), ["model.safetensors", "report.html", "report.json"]);
    let teacher = file::load(run.path()).unwrap().scene;
    let student = file::load(&out.join("model.safetensors")).unwrap().scene;
    assert!(matches!(student.deformation, Deformation::Superpoints(_)) && teacher.deformation.field().is_some());
    let m = &said.motion;
    assert!(m.size_change.is_some() && m.dropped.iter().any(|d| d.contains("changes of size")), "{m:?}");
    assert!(m.is_within() || m.chord_px > 0.05, "only a motion too quick for as many times is off: {m:?}");
    for time in [0.0, 0.21, 0.63, 1.0] {
        let [a, b] = [&teacher, &student].map(|s| place_scene(s, time, MotionSource::Auto).unwrap().mean);
        let worst = a.iter().zip(&b).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        // A scene is about 400 pixels wide.
        let extent = a.iter().map(|x| x.distance(a[0])).fold(0.0, f64::max);
        assert!(worst < 2.0 * m.error_px.largest / 200.0 * extent, "t {time}: {worst} of {extent}, {m:?}");
    }
    let images = said.images.as_ref().unwrap();
    assert!(images.views.len() == 3 && images.frame_ms.iter().all(|ms| *ms > 0.0), "{images:?}");
    assert!(student.metadata["distilled"].contains("bound_px"));
}

#[test]
fn a_student_looks_like_its_teacher() {
    let folder = tempfile::tempdir().unwrap();
    let [from, out] = ["a.safetensors", "out"].map(|name| folder.path().join(name));
    file::save(&from, &network()).unwrap();
    let said = distill(&[text(&from), "--out", text(&out), "--teacher-views", "4", "--json"]).unwrap();
    let m = &said.motion;
    assert!(m.is_within() && m.error_px.largest <= 0.25 && !m.capped && m.superpoints == [5, 5], "{m:?}");
    assert!(said.images.unwrap().psnr.is_none_or(|psnr| psnr > 40.0));
    let page = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert!(page.contains("within the bound of 0.25 px") && page.contains("absolute difference"), "{page}");
    let record: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(out.join("report.json")).unwrap()).unwrap();
    assert_eq!(record["kind"], "distill");
    assert_eq!(record["motion"]["superpoints"][1], 5);
    // A student again: the same parts.
    let again = folder.path().join("again");
    let said = distill(&[text(&out.join("model.safetensors")), "--out", text(&again), "--teacher-views", "0"]).unwrap();
    assert!(said.motion.superpoints == [5, 5] && said.motion.is_within(), "{:?}", said.motion);
    // Over what was there.
    distill(&[text(&from), "--out", text(&again), "--max-superpoints", "2", "--teacher-views", "0"]).unwrap();
    let said = std::fs::read_to_string(again.join("report.html")).unwrap();
    assert!(said.contains("above the bound") && said.contains("--max-superpoints allows 2"), "{said}");
}

#[test]
fn mistakes_write_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    file::save(&at("still.ply"), &Scene { gaussians: random_gaussians(9, 1, 0), ..Scene::default() }).unwrap();
    file::save(&at("a.safetensors"), &network()).unwrap();
    std::fs::write(at("file"), b"x").unwrap();
    let rejected = |args: &[&str], code: u8, word: &str| {
        let error = distill(args).unwrap_err();
        assert!(error.exit_code() == code && error.to_string().contains(word), "{error}");
        assert_eq!(names(folder.path()), ["a.safetensors", "file", "still.ply"], "{error}");
    };
    let out = at("new/out");
    rejected(&[text(&at("still.ply")), "--out", text(&out)], 2, "does not move");
    rejected(&[text(&at("none.ply")), "--out", text(&out)], 3, "none.ply");
    rejected(&[text(&at("a.safetensors")), "--out", text(&at("file"))], 2, "--out");
    rejected(&[text(&at("a.safetensors")), "--out", text(&at("file/out")), "--teacher-views", "0"], 2, "folder");
    rejected(&[text(&at("a.safetensors")), "--out", text(&out), "--motion", "table"], 2, "table");
    rejected(&[text(&at("a.safetensors")), "--out", text(&out), "--data", text(&at("none"))], 3, "none");
    assert!(Cli::try_parse_from(["spgs", "distill", "a", "--out", "b", "--error", "0"]).is_err());
}

#[test]
fn a_student_is_fine_tuned_on_its_teacher() {
    let folder = tempfile::tempdir().unwrap();
    let [from, cameras] = ["a.safetensors", "cameras.json"].map(|name| folder.path().join(name));
    file::save(&from, &network()).unwrap();
    let eye = |k: usize| DVec3::new(4.0 * (k as f64).cos(), 4.0 * (k as f64).sin(), 1.0);
    let look = |k: usize| Camera {
        name: format!("c{k}"),
        time: k as f64 / 3.0,
        ..Camera::look_at(eye(k), DVec3::ZERO, DVec3::Z, 0.8, [96, 96])
    };
    camera_file::write(&cameras, &(0..4).map(look).collect::<Vec<_>>()).unwrap();
    let run = |out: &Path, over: &[&str]| {
        let base = [text(&from), "--out", text(out), "--data", text(&cameras), "--teacher-views", "4", "--json"];
        distill(
            &[
                &base[..],
                &["--downscale", "2", "--max-superpoints", "1", "--error", "0.01", "--iterations", "60"],
                over,
            ]
            .concat(),
        )
    };
    let [one, two, other] = ["one", "two", "other"].map(|name| folder.path().join(name));
    let said = run(&one, &[]).unwrap();
    let t = said.tuning.as_ref().unwrap();
    assert!(t.iterations == 60 && t.images == [0, 60] && t.photo_psnr.is_none(), "{t:?}");
    assert_eq!(said.images.as_ref().unwrap().size, [48, 48]);
    let [before, after] = t.teacher_psnr.map(Option::unwrap);
    assert!(after != before && t.loss.iter().all(|l| *l > 0.0), "{before} to {after} dB, {t:?}");
    assert_eq!(said.images.as_ref().unwrap().psnr, Some(after), "images are those after it");
    assert!(t.displacement.error_px != said.motion.error_px && !t.within_bound, "{t:?}");
    let [record, page] = ["report.json", "report.html"].map(|name| std::fs::read_to_string(one.join(name)).unwrap());
    let record: serde_json::Value = serde_json::from_str(&record).unwrap();
    assert_eq!(record["tuning"]["within_bound"], false);
    assert!(page.contains("Fine-tuning") && page.contains("the bound of 0.01 px does not hold"), "{page}");
    run(&two, &[]).unwrap();
    run(&other, &["--seed", "3"]).unwrap();
    let bytes = |out: &Path| std::fs::read(out.join("model.safetensors")).unwrap();
    assert!(bytes(&one) == bytes(&two), "the same file twice");
    assert!(bytes(&one) != bytes(&other), "another seed");
    let none = folder.path().join("none");
    for on in ["photos", "both"] {
        let error = run(&none, &["--on", on]).unwrap_err();
        assert!([2, 3].contains(&error.exit_code()) && !none.exists(), "{error}");
    }
    assert!(Cli::try_parse_from(["spgs", "distill", "a", "--out", "b", "--on", "teacher"]).is_err());
    assert!(Cli::try_parse_from(["spgs", "distill", "a", "--out", "b", "--iterations", "0"]).is_err());
}
