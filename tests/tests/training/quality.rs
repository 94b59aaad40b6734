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

#[test]
fn what_no_photo_shows_goes_and_what_they_show_stays() {
    let posed = posed(&PosedOptions { moving: false, test: 0, ..PosedOptions::default() });
    let (_, data) = load(&posed);
    let (mut first, hidden) = (posed.scene.gaussians.clone(), 7);
    let far = (0..hidden).map(|i| [1000.0 + i as f32, 0.0, 0.0]);
    first.mean.extend(far);
    first.log_scale.extend_from_within(..hidden);
    first.rotation.extend_from_within(..hidden);
    first.opacity_logit.extend_from_within(..hidden);
    let one = first.sh.len() / posed.scene.gaussians.len();
    first.sh.extend_from_within(..hidden * one);
    let after = |share: f64| {
        let density =
            format!("from = 0\nuntil = 2\ngradient_threshold = 1e9\nunseen_interval = 2\nunseen_share = {share}");
        let config = config(&format!("[density]\nmin_opacity = 1e-6\nmax_extent = 1e9\n{density}"));
        let mut trainer = Trainer::new(&gpu(), &config, &data, &first).unwrap();
        advance(&mut trainer, 2).unwrap();
        let change = trainer.take_density_change().unwrap();
        assert_eq!(change.before - change.unseen, change.after);
        let mean = trainer.scene().unwrap().gaussians.mean;
        (change.unseen as usize, mean.iter().filter(|m| m[0] > 900.0).count(), mean.len())
    };
    let seen = posed.scene.gaussians.len();
    assert_eq!(after(0.0), (0, hidden, seen + hidden));
    let (gone, left, count) = after(0.01);
    assert_eq!((left, count), (0, seen + hidden - gone));
    assert!(gone >= hidden && gone - hidden < seen / 4, "{gone} of {} are gone", seen + hidden);
}
