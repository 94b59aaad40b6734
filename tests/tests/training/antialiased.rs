//! Antialiased scenes: what is measured of each Gaussian.

use engine::scene::parameter::SMOOTHING;
use engine::train::trainer::Trainer;

use crate::common::{PosedOptions, config, gpu, load, posed, scene_of_resumed_run};

/// The smoothing goes through density control, files and a resumed run, and is √0.2 px of a photo.
#[test]
fn smoothing_is_measured_split_saved_and_resumed() {
    let scene = scene_of_resumed_run("[gaussians]\nantialiased = true");
    let smoothing = scene.gaussians.optional.get(SMOOTHING).unwrap();
    assert!(scene.gaussians.antialiased && smoothing.len() == scene.gaussians.len());
    let (_, data) = load(&posed(&PosedOptions::default()));
    let camera = &data.views[0].camera;
    let far = 2.0 * camera.position.length();
    let depth = |sigma: f32| f64::from(sigma) * camera.fx.max(camera.fy) / 0.2_f64.sqrt();
    let known: Vec<f64> = smoothing.iter().filter(|sigma| **sigma > 0.0).map(|sigma| depth(*sigma)).collect();
    assert!(2 * known.len() > smoothing.len(), "{} of {} are measured", known.len(), smoothing.len());
    assert!(known.iter().all(|z| (0.2..far).contains(z)), "depths {known:?}, cameras at {}", 0.5 * far);
}

/// As when a finished model is trained on: it has its smoothing in its scales.
#[test]
fn who_is_antialiased_stays_so_without_another_smoothing() {
    let posed = posed(&PosedOptions::default());
    let (_, data) = load(&posed);
    let mut first = posed.scene.gaussians.clone();
    first.antialiased = true;
    let gpu = gpu();
    let begun = Trainer::new(&gpu, &config(""), &data, &first).unwrap();
    let resumed = Trainer::resume(&gpu, &data, &begun.checkpoint().unwrap()).unwrap();
    for trainer in [begun, resumed] {
        let gaussians = trainer.scene().unwrap().gaussians;
        assert!(gaussians.antialiased && gaussians.optional == first.optional);
    }
}
