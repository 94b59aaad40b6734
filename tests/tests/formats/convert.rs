//! `spgs convert` and `spgs inspect`, as a person runs them.

use std::path::Path;

use clap::Parser as _;
use engine::file;
use engine::reference::freeze;
use engine::scene::MotionSource;
use engine::scene::synthetic::moving_scene;
use tools::cli::args::{Cli, Command};
use tools::command::convert::Summary;

pub(crate) fn convert(args: &[&str]) -> engine::Result<()> {
    summary(args).map(|_| ())
}

pub(crate) fn summary(args: &[&str]) -> engine::Result<Summary> {
    let cli = Cli::try_parse_from(["spgs", "--quiet", "convert"].iter().chain(args)).unwrap();
    match &cli.command {
        Command::Convert(args) => tools::command::convert::convert(args, &cli.global),
        _ => unreachable!("the subcommand is convert"),
    }
}

pub(crate) fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn a_moving_scene_becomes_a_sequence_a_moment_and_a_table() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let scene = moving_scene(400, 5, 9, 3, true);
    file::save(&at("a.safetensors"), &scene).unwrap();
    let input = at("a.safetensors");

    convert(&[text(&input), text(&at("seq.ply")), "--times", "3", "--views", "1"]).unwrap();
    let keys = &scene.deformation.table().unwrap().times;
    let (start, end) = (f64::from(keys[0]), f64::from(keys[keys.len() - 1]));
    for (i, time) in [start, 0.5 * (start + end), end].into_iter().enumerate() {
        let written = file::load(&at(&format!("seq_{i:05}.ply"))).unwrap().scene;
        assert_eq!(written.gaussians, freeze(&scene, time, MotionSource::Auto).unwrap());
    }
    assert!(!at("seq.ply").exists());

    convert(&[text(&input), text(&at("moment.sog")), "--time", "0.3", "--views", "1"]).unwrap();
    assert_eq!(file::load(&at("moment.sog")).unwrap().scene.gaussians.len(), 400);

    // At rest, with all bits.
    convert(&[text(&input), text(&at("rest.ply")), "--views", "0"]).unwrap();
    assert_eq!(file::load(&at("rest.ply")).unwrap().scene.gaussians, scene.gaussians);

    let bake = ["--motion", "network", "--bake", "--bake-error", "0.5", "--views", "2", "--json"];
    convert(&[&[text(&input), text(&at("baked.safetensors"))], bake.as_slice()].concat()).unwrap();
    let baked = file::load(&at("baked.safetensors")).unwrap().scene;
    assert!(
        baked.deformation.network().is_none()
            && baked.deformation.table().is_some()
            && baked.deformation.association().is_none()
    );
    // At a time that is no key, the table is where the network is.
    let (a, b) =
        (freeze(&baked, 0.37, MotionSource::Auto).unwrap(), freeze(&scene, 0.37, MotionSource::Network).unwrap());
    let far = a.mean.as_flattened().iter().zip(b.mean.as_flattened()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(far < 0.01, "{far}");
}

#[test]
fn mistakes_are_named_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    file::save(&at("a.safetensors"), &moving_scene(20, 2, 3, 3, false)).unwrap();
    let input = at("a.safetensors");
    let message = |args: &[&str]| convert(args).unwrap_err().to_string();
    assert!(message(&[text(&input), text(&at("b.obj"))]).contains("expected .safetensors, .ply"));
    assert!(message(&[text(&input), text(&at("b.ply")), "--bake"]).contains("which holds motion"));
    assert!(message(&[text(&at("none.ply")), text(&at("b.ply"))]).contains("none.ply"));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    for bad in
        [&["--time", "0", "--times", "3"][..], &["--bake-error", "0.1"], &["--times", "0"], &["--bake", "--times", "2"]]
    {
        let all = [&["spgs", "convert", "a", "b.ply"], bad].concat();
        assert!(Cli::try_parse_from(all).is_err(), "{bad:?}");
    }
}

#[test]
fn a_level_of_detail_is_converted() {
    let Some(root) = tests_harness::data("splats/playbot_sog") else { return };
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("coarse.ply");
    convert(&[text(&root), text(&out), "--level", "4", "--views", "0"]).unwrap();
    assert_eq!(file::load(&out).unwrap().scene.gaussians.len(), 8406);
    // A description counts with what lies beside it.
    for name in ["lod-meta.json", "4_0/meta.json"] {
        let file = root.join(name);
        let bytes = |path: &Path| summary(&[text(path), text(&out), "--views", "0"]).unwrap().input_bytes;
        assert_eq!(bytes(&file), bytes(file.parent().unwrap()), "{name}");
    }
    let refused = convert(&[text(&root), text(&out), "--level", "5"]).unwrap_err();
    assert!(refused.to_string().contains("which lacks 5_0/meta.json") && refused.exit_code() == 2, "{refused}");
}
