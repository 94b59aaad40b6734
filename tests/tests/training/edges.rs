//! Data sets and settings at the edge of what makes sense.

use engine::file;
use engine::render::{RenderOptions, Renderer};
use engine::train::export::export;
use engine::train::trainer::Trainer;

use crate::common::{
    PosedOptions, advance, bytes, checkpoints, config, config_file, gpu, load, log, outcome, posed, spgs, succeed,
    train, trainer,
};

fn small() -> PosedOptions {
    PosedOptions { train: 3, test: 1, ..PosedOptions::default() }
}

/// Steps through every part of the method; stops half-way and goes on from the checkpoint, which must give the same bits.
fn runs(options: &PosedOptions, over: &str) -> Trainer {
    let posed = posed(options);
    let (_, data) = load(&posed);
    let gpu = gpu();
    let short = "iterations = 12\n[schedule]\nwarm_up = 4\nsh_degree_interval = 4\n[density]\nfrom = 2\nuntil = 11\ninterval = 3\nopacity_reset_interval = 7\n";
    let base = config(&format!("{short}{over}"));
    let mut whole = trainer(&gpu, &base, &data).unwrap();
    advance(&mut whole, 8).unwrap();
    let half = whole.checkpoint().unwrap();
    advance(&mut whole, 12).unwrap();
    let mut resumed = Trainer::resume(&gpu, &data, &half).unwrap();
    advance(&mut resumed, 12).unwrap();
    assert!(bytes(&resumed.checkpoint().unwrap()) == bytes(&whole.checkpoint().unwrap()), "resumed at 8: other bits");
    // What comes out can be written, read and drawn.
    let cameras: Vec<_> = data.views.iter().map(|v| v.camera.clone()).collect();
    let scene = export(&gpu, &whole, &cameras).unwrap().scene;
    let path = posed.path().join("model.safetensors");
    file::save(&path, &scene).unwrap();
    let loaded = file::load(&path).unwrap().scene;
    let image = Renderer::new(&gpu, &loaded, &RenderOptions::default()).unwrap().render(&cameras[0], 0.0).unwrap();
    assert!(image.rgba.iter().all(|v| v.is_finite()));
    whole
}

#[test]
fn one_image() {
    let trainer = runs(&PosedOptions { train: 1, test: 0, ..small() }, "");
    assert!(trainer.scene().unwrap().deformation.superpoints().is_none(), "one image has one time: nothing can move");
}

#[test]
fn one_superpoint() {
    let trainer = runs(&small(), "[motion]\nsuperpoints = 1");
    assert_eq!(trainer.scene().unwrap().deformation.superpoint_count(), 1);
}

#[test]
fn more_neighbours_than_superpoints() {
    runs(&small(), "[motion]\nsuperpoints = 2\nneighbors = 5\nassociation_slots = 6");
}

#[test]
fn more_superpoints_than_gaussians() {
    let trainer =
        runs(&small(), "[gaussians]\nrandom_points = 5\n[motion]\nsuperpoints = 64\n[density]\nenabled = false");
    assert!(trainer.scene().unwrap().deformation.superpoint_count() <= 5);
}

#[test]
fn images_of_one_pixel() {
    runs(&PosedOptions { sizes: vec![[1, 1]], ..small() }, "");
}

#[test]
fn images_of_different_sizes() {
    runs(&PosedOptions { sizes: vec![[32, 24], [17, 40], [1, 1]], ..small() }, "");
}

#[test]
fn pruned_to_fewer_gaussians_than_superpoints_and_resumed() {
    // Opacity 0.1 at the start: most Gaussians are below 0.1 after a few steps.
    let over = "[gaussians]\nrandom_points = 40\n[motion]\nsuperpoints = 36\n[density]\nmin_opacity = 0.1\ngradient_threshold = 1e9\nuntil = 9\nfrom = 4";
    let trainer = runs(&small(), over);
    let n = trainer.gaussians();
    assert!(n > 0 && n < 36, "{n} Gaussians are left");
}

#[test]
fn all_pruned() {
    let over = "[density]\nmin_opacity = 0.999\ngradient_threshold = 1e9";
    let trainer = runs(&small(), over);
    assert_eq!(trainer.gaussians(), 0);
    let posed = posed(&small());
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let file = config_file(
        folder.path(),
        "background = [0.25, 0.5, 0.75]\niterations = 20\n[density]\nmin_opacity = 0.999\ngradient_threshold = 1e9\n[schedule]\nwarm_up = 8",
    );
    succeed(train(&posed, &out, &["--config", file.to_str().unwrap()]));
    let last = log(&out).iter().rfind(|l| l["loss"].is_number()).unwrap().clone();
    assert_eq!((last["gaussians"].as_u64(), last["iteration"].as_u64()), (Some(0), Some(20)), "{last}");
    let image = image::open(out.join("images/00000_rendered.png")).unwrap().to_rgb8();
    assert!(image.pixels().all(|p| p.0 == [64, 128, 191]), "images are the background");
    assert_eq!(file::load(&out.join("model.safetensors")).unwrap().scene.gaussians.len(), 0);
}

#[test]
fn a_picture_that_goes_missing_is_named() {
    let posed = posed(&small());
    let (_, data) = load(&posed);
    std::fs::remove_file(posed.path().join("train/r_001.png")).unwrap();
    let gpu = gpu();
    let mut trainer = trainer(&gpu, &config(""), &data).unwrap();
    let error = advance(&mut trainer, 3).unwrap_err();
    assert!(error.exit_code() == 3 && error.to_string().contains("r_001.png"), "{error}");
}

#[test]
fn wrong_use_is_one_clear_error() {
    let posed = posed(&small());
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let (code, text) = outcome(train(&posed, &out, &["--resume"]));
    assert!(code == 2 && text.contains("no checkpoint in") && text.contains("run/checkpoints"), "{code} {text}");
    let (code, text) = outcome(train(&posed, &out, &["--nonrigid"]));
    assert!(code == 2 && text.contains("no checkpoint in"), "{code} {text}");
    let wrong = folder.path().join("wrong.toml");
    std::fs::write(&wrong, "iterations = 9\n[motion]\nsuperpoint = 3\n").unwrap();
    let (code, text) = outcome(train(&posed, &out, &["--config", wrong.to_str().unwrap()]));
    assert!(code == 3 && text.contains("superpoint") && text.contains("line 3"), "{code} {text}");
    std::fs::write(&wrong, "[motion]\nneighbors = 99\n").unwrap();
    let (code, text) = outcome(train(&posed, &out, &["--config", wrong.to_str().unwrap()]));
    assert!(code == 2 && text.contains("motion.neighbors"), "{code} {text}");
    assert!(checkpoints(&out).is_empty());
}

#[test]
fn the_printed_configuration_is_the_one_for_the_data() {
    let posed = posed(&PosedOptions::default());
    let print = |data: &std::path::Path, more: &[&str]| {
        succeed(spgs(&[&["train", data.to_str().unwrap(), "--print-config"][..], more].concat()))
    };
    let has =
        |text: &str, lines: [&str; 3]| assert!(lines.iter().all(|line| text.contains(line)), "{lines:?} in {text}");
    let (best, paper) = (print(posed.path(), &[]), print(posed.path(), &["--preset", "paper"]));
    has(&best, ["preset = \"dnerf\"", "method = \"best\"", "coarse_to_fine = 17000"]);
    has(&paper, ["preset = \"dnerf\"", "method = \"paper\"", "coarse_to_fine = 0"]);
    let still = self::posed(&PosedOptions { moving: false, ..PosedOptions::default() });
    for [until, text] in [["25000", &best], ["15000", &paper]] {
        has(text, ["method", "[density]", &format!("until = {until}\n")]);
    }
    for text in [print(posed.path(), &["--no-motion"]), print(still.path(), &[])] {
        has(&text, ["method = \"best\"", "until = 15000\n", "unseen_interval = 5000\n"]);
    }
    if let Some(capture) = tests_harness::data("nerfies_capture1") {
        has(&print(&capture, &[]), ["preset = \"hypernerf\"", "method = \"best\"", "coarse_to_fine = 0"]);
        has(
            &print(&capture, &[]),
            ["interval = 100\nopacity_reset_interval = 6000", "max_extent = 0.0", "max_radius_px = 0.0"],
        );
    }
}

#[test]
fn photos_of_several_sizes_grow() {
    let options = PosedOptions { sizes: vec![[64, 56], [50, 90]], ..small() };
    let trainer = runs(&options, "[schedule]\nwarm_up = 4\ncoarse_to_fine = 9\n");
    assert_eq!(trainer.iteration(), 12);
}

#[test]
fn what_is_shown_of_a_run_is_as_wide_as_the_pixels_of_its_photos() {
    let posed = posed(&PosedOptions { sizes: vec![[64, 56]], ..PosedOptions::default() });
    let (_, data) = load(&posed);
    let mut trainer = trainer(&gpu(), &config("[schedule]\ncoarse_to_fine = 9\n"), &data).unwrap();
    for (iteration, is_wider) in [(9, true), (10, false)] {
        advance(&mut trainer, iteration).unwrap();
        let shown = trainer.scene().unwrap().gaussians.log_scale;
        let trained = trainer.checkpoint().unwrap().parameters.gaussians.log_scale;
        let wider = shown.iter().zip(&trained).filter(|(a, b)| (0..3).all(|k| a[k] > b[k])).count();
        assert_eq!(wider, if is_wider { shown.len() } else { 0 }, "after {iteration} iterations");
        assert!(is_wider || shown == trained);
    }
}
