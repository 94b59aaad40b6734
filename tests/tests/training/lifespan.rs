//! Gaussians that are seen for a while.

use engine::scene::Scene;
use engine::scene::parameter::{LIFESPAN, Optional};
use engine::train::checkpoint::Checkpoint;
use engine::train::trainer::Trainer;

use crate::common::{PosedOptions, advance, bytes, config, gpu, load, posed, trainer};
use crate::quality::psnr_from;

const OPTIONAL: &str = "[gaussians]\noptional = [\"lifespan\"]";

/// Lifespans go through density control, files and a resumed run.
#[test]
fn lifespans_are_split_saved_and_resumed() {
    let posed = posed(&PosedOptions::default());
    let (_, data) = load(&posed);
    let gpu = gpu();
    let mut whole = trainer(&gpu, &config(OPTIONAL), &data).unwrap();
    let before = whole.gaussians();
    advance(&mut whole, 23).unwrap();
    assert_ne!(whole.gaussians(), before, "density control ran");
    let folder = tempfile::tempdir().unwrap();
    let saved = Checkpoint::load(&whole.checkpoint().unwrap().save(folder.path()).unwrap()).unwrap();
    let mut resumed = Trainer::resume(&gpu, &data, &saved).unwrap();
    for trainer in [&mut whole, &mut resumed] {
        advance(trainer, 40).unwrap();
    }
    assert!(bytes(&whole.checkpoint().unwrap()) == bytes(&resumed.checkpoint().unwrap()));
    let scene = whole.scene().unwrap();
    let lifespan = scene.gaussians.optional.get(LIFESPAN).unwrap();
    assert_eq!(lifespan.len(), 2 * scene.gaussians.len());
    assert!(lifespan.chunks(2).any(|l| l[0] != 0.5), "they are trained");
    let path = folder.path().join("model.safetensors");
    engine::file::model::write(&path, &scene).unwrap();
    assert_eq!(engine::file::model::read(&path).unwrap().0, scene);
}

#[test]
fn what_comes_and_goes_is_learnt() {
    let options = PosedOptions { train: 12, test: 0, swing: 0.0, comes_and_goes: true, ..PosedOptions::default() };
    let posed = posed(&options);
    let gaussians = engine::scene::Gaussians { optional: Optional::default(), ..posed.scene.gaussians.clone() };
    let first = Scene { gaussians, ..Scene::default() };
    let learn = "iterations = 300\n[motion]\nenabled = false\n[density]\nenabled = false\n[learning_rate]\nmean_iterations = 320";
    let rates = "[learning_rate.optional]\nlifespan = 0.02";
    let without = psnr_from(&posed, learn, &first.gaussians);
    let with = psnr_from(&posed, &format!("{learn}\n{OPTIONAL}\n{rates}"), &first.gaussians);
    eprintln!("PSNR with lifespans {with:.2} dB, without {without:.2} dB");
    assert!(with > without + 2.0, "with lifespans {with:.2} dB, without {without:.2} dB");
}
