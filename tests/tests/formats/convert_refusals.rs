//! What `spgs convert` says of its input and refuses before it writes.

use std::fmt::Write as _;
use std::path::Path;

use engine::file::{self, durable};
use engine::scene::Scene;
use engine::scene::synthetic::{moving_scene, random_gaussians};

use crate::convert::{summary, text};

fn entries(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// A text PLY of two Gaussians with further properties, a further element and these normals.
fn with_more(normal: [f32; 3]) -> String {
    let names = "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 label";
    let mut out = "ply\nformat ascii 1.0\nelement vertex 2\n".to_owned();
    names.split(' ').for_each(|name| writeln!(out, "property float {name}").unwrap());
    out += "element face 1\nproperty list uchar int vertex_indices\nend_header\n";
    let [a, b, c] = normal;
    for x in 0..2 {
        writeln!(out, "{x} 0 1 {a} {b} {c} 1 1 1 3 -2 -2 -2 1 0 0 0 {x}").unwrap();
    }
    out + "3 0 1 0\n"
}

#[test]
fn what_is_not_read_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let dropped = |text_of: &str, out: &str| {
        std::fs::write(at("in.ply"), text_of).unwrap();
        summary(&[text(&at("in.ply")), text(&at(out)), "--views", "0"]).unwrap().dropped
    };
    for out in ["a.ply", "a.safetensors"] {
        let all = dropped(&with_more([0.0, 0.5, 0.0]), out);
        assert_eq!(all, ["element `face`", "normals", "property `label`"], "{out}");
        assert_eq!(dropped(&with_more([0.0; 3]), out), ["element `face`", "property `label`"], "{out}");
    }
    // What this program writes has normals, which are 0.
    let said = summary(&[text(&at("a.ply")), text(&at("b.ply")), "--views", "0"]).unwrap();
    assert_eq!(said.dropped, [""; 0]);
    assert!(said.lines().iter().any(|line| line == "left out: nothing"));
    let Some(path) = tests_harness::data("splats/fruit_drops_sh3_5k.ply") else { return };
    let said = summary(&[text(&path), text(&at("c.ply")), "--views", "0"]).unwrap();
    assert_eq!(said.dropped, ["property `transform`"]);
}

#[test]
fn the_input_is_counted_before_it_is_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let mut gaussians = random_gaussians(200, 4, 3);
    gaussians.mean[..7].fill([f32::NAN; 3]);
    file::ply::write(&path, &gaussians).unwrap();
    let before = std::fs::metadata(&path).unwrap().len();
    let said = summary(&[text(&path), text(&path), "--views", "0"]).unwrap();
    let after = std::fs::metadata(&path).unwrap().len();
    assert_eq!((said.input_bytes, said.outputs[0].bytes), (before, after));
    assert!(after < before);
    assert_eq!((said.gaussians, said.rejected), (200, 7));
    assert!(said.lines()[0].contains("200 Gaussians, 7 cannot be drawn"), "{}", said.lines()[0]);
}

#[test]
fn places_that_cannot_be_written_are_refused_first() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    file::save(&at("a.safetensors"), &moving_scene(20, 2, 3, 3, false)).unwrap();
    let input = at("a.safetensors");
    std::fs::create_dir(at("seq_00002.ply")).unwrap();
    let there = entries(folder.path());
    let refused = |args: &[&str], word: &str| {
        let error = summary(args).unwrap_err();
        assert!(error.to_string().contains(word) && error.exit_code() == 2, "{args:?}: {error}");
        assert_eq!(entries(folder.path()), there, "{args:?}");
    };
    // Before the model is read, which takes long for some.
    let none = at("none.ply");
    refused(&[text(&none), text(&at("a.safetensors/b.ply"))], "expected a folder");
    refused(&[text(&none), text(&at("a.safetensors/b/c.ply"))], "folder of the output");
    refused(&[text(&none), text(&at("seq_00002.ply"))], "found a directory");
    refused(&[text(&input), text(&at("seq.ply")), "--times", "3"], "seq_00002.ply: found a directory");
    refused(&[text(&input), text(&at("b.ply")), "--device", "99"], "99");
    refused(&[text(&input), text(&at("b.safetensors")), "--bake", "--device", "99"], "99");
    // A folder is made, and goes again when nothing comes of it.
    let deep = at("new/deep/b.ply");
    assert_eq!(summary(&[text(&none), text(&deep)]).unwrap_err().exit_code(), 3);
    assert_eq!(entries(folder.path()), there);
    summary(&[text(&input), text(&deep), "--views", "0"]).unwrap();
    assert_eq!(entries(&at("new/deep")), ["b.ply"]);
    durable::check_target(&deep).unwrap();
    assert_eq!(entries(&at("new/deep")), ["b.ply"], "looking leaves nothing");
}

#[test]
fn options_without_effect_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let still = Scene { gaussians: random_gaussians(9, 2, 1), ..Scene::default() };
    file::save(&at("still.safetensors"), &still).unwrap();
    let input = at("still.safetensors");
    for (out, option, word) in [
        ("b.safetensors", ["--motion", "network"], "network F"),
        ("b.safetensors", ["--motion", "table"], "a key-time table"),
        ("b.ply", ["--times", "2"], "a model that does not move"),
        ("b.ply", ["--spz-version", "4"], "expected a .spz file"),
        ("b.ply", ["--spz-version", "3"], "expected a .spz file"),
    ] {
        let error = summary(&[&[text(&input), text(&at(out))], &option[..]].concat()).unwrap_err();
        assert!(error.to_string().contains(word) && error.exit_code() == 2, "{option:?}: {error}");
    }
    assert_eq!(entries(folder.path()), ["still.safetensors"]);
    summary(&[text(&input), text(&at("b.spz")), "--spz-version", "4", "--views", "0"]).unwrap();
}

#[test]
fn what_is_missing_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let inspect = |path: &Path| {
        let args = tools::cli::args::InspectArgs { file: path.to_path_buf(), json: false };
        tools::command::inspect::run(&args).unwrap_err().to_string()
    };
    std::fs::create_dir(at("empty")).unwrap();
    let message = inspect(&at("empty"));
    assert!(message.contains("meta.json") && message.contains("transforms_train.json"), "{message}");

    file::save(&at("a.sog"), &Scene { gaussians: random_gaussians(9, 2, 1), ..Scene::default() }).unwrap();
    let mut all = zip::ZipArchive::new(std::fs::File::open(at("a.sog")).unwrap()).unwrap();
    let mut part = zip::ZipWriter::new(std::fs::File::create(at("b.sog")).unwrap());
    for i in 0..all.len() {
        let entry = all.by_index_raw(i).unwrap();
        if entry.name().unwrap() != "means_u.webp" {
            part.raw_copy_file(entry).unwrap();
        }
    }
    part.finish().unwrap();
    let message = inspect(&at("b.sog"));
    assert!(message.contains("found no entry `means_u.webp`"), "{message}");
}
