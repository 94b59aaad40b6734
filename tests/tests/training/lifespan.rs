//! Gaussians that are seen for a while.

use engine::scene::Scene;
use engine::scene::parameter::{LIFESPAN, Optional};

use crate::common::{PosedOptions, posed, scene_of_resumed_run};
use crate::quality::psnr_from;

const OPTIONAL: &str = "[gaussians]\noptional = [\"lifespan\"]";

/// Lifespans go through density control, files and a resumed run.
#[test]
fn lifespans_are_split_saved_and_resumed() {
    let scene = scene_of_resumed_run(OPTIONAL);
    let lifespan = scene.gaussians.optional.get(LIFESPAN).unwrap();
    assert_eq!(lifespan.len(), 2 * scene.gaussians.len());
    assert!(lifespan.chunks(2).any(|l| l[0] != 0.5), "they are trained");
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
