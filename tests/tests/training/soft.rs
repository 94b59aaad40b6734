//! Soft superpoints: several move a Gaussian together.

use engine::train::trainer::Trainer;

use crate::common::{PosedOptions, advance, config, gpu, load, posed, scene_of_resumed_run, trainer};

const SOFT: &str = "[motion]\nblend = 3";

/// Weights go through density control, files and a resumed run.
#[test]
fn weights_are_trained_saved_and_resumed() {
    let scene = scene_of_resumed_run(SOFT);
    let blend = scene.deformation.blend().expect("the model is soft");
    assert_eq!((blend.neighbors, blend.len()), (3, scene.gaussians.len()));
    assert_eq!(blend.of_gaussian(), scene.deformation.superpoint_of_gaussian());
    assert!(blend.weight.iter().any(|w| (w - 1.0 / 3.0).abs() > 0.02), "they are trained");
}

#[test]
fn network_g_follows_them() {
    let posed = posed(&PosedOptions::default());
    let (_, data) = load(&posed);
    let gpu = gpu();
    let config = config(SOFT);
    let mut rigid = trainer(&gpu, &config, &data).unwrap();
    advance(&mut rigid, 23).unwrap();
    let mut stage = Trainer::nonrigid(&gpu, &config, &data, &rigid.checkpoint().unwrap()).unwrap();
    let until = stage.iteration() + 6;
    advance(&mut stage, until).unwrap();
    let scene = stage.scene().unwrap();
    assert!(scene.deformation.blend().is_some() && scene.deformation.nonrigid().is_some());
}

#[test]
fn a_form_that_cannot_be_is_rejected() {
    let text = "[motion]\nblend = 2\n[loss]\nprop_loss = \"paper\"";
    let path = std::path::Path::new("a.toml");
    let preset = engine::train::config::Preset::default();
    let error = engine::train::config::Config::parse(text, preset, path).unwrap_err().to_string();
    assert!(error.contains("loss.prop_loss") && error.contains("motion.blend"), "{error}");
    let error = engine::train::config::Config::parse("[motion]\nblend = 5", preset, path).unwrap_err().to_string();
    assert!(error.contains("motion.blend") && error.contains("1 to 4"), "{error}");
}
