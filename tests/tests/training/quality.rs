//! What training is for.

use engine::scene::{Deformation, Gaussians};
use engine::train::evaluate;
use engine::train::trainer::Trainer;

use crate::common::{Posed, PosedOptions, advance, config, config_file, gpu, load, log, newest, posed, succeed, train};

/// PSNR over the training views after a run from the scene's own Gaussians, so that what is left to learn is how they move.
fn psnr(posed: &Posed, over: &str) -> f64 {
    psnr_from(posed, over, &posed.scene.gaussians)
}

/// PSNR over the training views after a run from these Gaussians.
pub fn psnr_from(posed: &Posed, over: &str, first: &Gaussians) -> f64 {
    let (dataset, data) = load(posed);
    let gpu = gpu();
    let config = config(over);
    let mut trainer = Trainer::new(&gpu, &config, &data, first).unwrap();
    advance(&mut trainer, config.iterations).unwrap();
    let loader = engine::data::loader::ImageLoader::new(dataset.train.into(), 1 << 30, 0).unwrap();
    let indices: Vec<usize> = (0..loader.views().len()).collect();
    let scene = trainer.scene().unwrap();
    let options = engine::render::RenderOptions::default();
    let scores = evaluate::evaluate(&gpu, &scene, &loader, &indices, &options, |_, _, _| Ok(())).unwrap();
    evaluate::mean(&scores)[0]
}

const LEARN: &str = "
iterations = 300
[schedule]
warm_up = 10
[density]
enabled = false
[learning_rate]
mean_iterations = 320
deform = 2e-3
deform_iterations = 320
[motion]
network_layers = 8
network_width = 256
";

#[test]
fn motion_is_learnt() {
    let options = PosedOptions { train: 12, test: 0, superpoints: 2, swing: 0.5, ..PosedOptions::default() };
    let posed = posed(&options);
    let moving = psnr(&posed, LEARN);
    let still = psnr(&posed, &format!("{LEARN}\n[motion]\nenabled = false"));
    eprintln!("PSNR with motion {moving:.2} dB, without {still:.2} dB");
    assert!(moving > still + 1.5, "with motion {moving:.2} dB, without {still:.2} dB");
}

#[test]
fn a_static_data_set_trains_without_motion() {
    let posed = posed(&PosedOptions { moving: false, ..PosedOptions::default() });
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let config = config_file(folder.path(), "");
    succeed(train(&posed, &out, &["--config", config.to_str().unwrap()]));
    let scene = engine::file::load(&out.join("model.safetensors")).unwrap().scene;
    assert_eq!(scene.deformation, Deformation::None);
    let model = std::fs::read(out.join("model.safetensors")).unwrap();
    for text in ["superpoint", "motion.", "deform", "association"] {
        let header = u64::from_le_bytes(model[..8].try_into().unwrap()) as usize;
        let header: serde_json::Value = serde_json::from_slice(&model[8..8 + header]).unwrap();
        let names: Vec<&String> = header.as_object().unwrap().keys().collect();
        assert!(!names.iter().any(|n| n.contains(text)), "{text}: {names:?}");
    }
    assert!(log(&out).iter().all(|l| l["superpoints"].as_u64().unwrap_or(0) == 0));
    assert!(!newest(&out).is_empty());
}
