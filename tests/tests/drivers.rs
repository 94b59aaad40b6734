//! What every driver has to give, whoever wrote it: the demo as the f64 reference shows it, and a training run that ends
//! where it ends on every other driver. `ci/test` runs this on each of its drivers.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::Path;

use engine::data::dataset::{self, DatasetOptions};
use engine::data::loader::ImageLoader;
use engine::image::difference;
use engine::reference::{self, ReferenceOptions};
use engine::render::{RenderOptions, Renderer};
use engine::scene::synthetic::{DEMO_BACKGROUND, demo_camera, demo_scene};
use engine::train::config::{Config, Preset};
use engine::train::trainer::{Trainer, TrainingData};
use engine::train::{evaluate, start};
use tests_harness::posed::{Posed, PosedOptions};

/// PSNR of the demo against the f64 reference, dB. Rounding alone costs about 100.
const DEMO_PSNR: f64 = 90.0;

#[test]
fn the_demo_is_what_the_f64_reference_shows() {
    let gpu = tests_harness::gpu();
    let scene = demo_scene();
    let options = RenderOptions { background: DEMO_BACKGROUND, ..RenderOptions::default() };
    let exact = ReferenceOptions { background: DEMO_BACKGROUND.map(f64::from), ..ReferenceOptions::default() };
    let mut renderer = Renderer::new(&gpu, &scene, &options).unwrap();
    let (size, times) = if tests_harness::small() { (200, vec![0.37]) } else { (800, vec![0.0, 0.37, 1.0]) };
    for time in times {
        let camera = demo_camera(time, size, size);
        let image = renderer.render(&camera, time).unwrap();
        let truth = reference::render(&scene, &camera, time, &exact).unwrap();
        let found = difference(truth.rgb.iter().copied(), image.rgb());
        println!("demo at {time}, {size}x{size}, on {}: {found:?}", gpu.info().driver);
        assert!(found.psnr >= DEMO_PSNR, "{}: {found:?}", gpu.info().driver);
    }
}

/// Every part of the method, gently: rounding grows from step to step, faster at high rates of learning, and a Gaussian
/// more or less is another scene. Density control therefore acts once, while devices agree to five digits.
const TRAINING: &str = "
iterations = 200
deterministic = true
[schedule]
scale = false
warm_up = 60
sh_degree_interval = 50
[gaussians]
sh_degree = 1
random_points = 1000
[motion]
superpoints = 8
neighbors = 3
association_slots = 4
network_layers = 3
network_width = 64
[learning_rate]
deform = 2e-4
[density]
from = 30
until = 50
interval = 40
opacity_reset_interval = 70
gradient_threshold = 4e-4
[log]
evaluate_interval = 0
checkpoint_interval = 0
";

/// PSNR over all views after [`TRAINING`], dB. A change of training that is meant changes it too: the failure tells the
/// new value. Twice the tolerance is how far two drivers may be apart.
const TRAINING_PSNR: f64 = 20.1728;
const TRAINING_TOLERANCE: f64 = 0.005;

#[test]
fn two_hundred_steps_end_where_they_end_on_other_drivers() {
    let gpu = tests_harness::gpu();
    let posed = Posed::by_reference(&PosedOptions {
        sizes: vec![[64, 40]],
        train: 10,
        test: 4,
        gaussians: 400,
        ..PosedOptions::default()
    });
    let config = Config::parse(TRAINING, Preset::Dnerf, Path::new("test")).unwrap();
    let data = dataset::load(posed.path(), &DatasetOptions::default()).unwrap();
    let training = TrainingData { views: data.train.clone().into(), extent: data.extent, is_static: data.is_static };
    let mut trainer = Trainer::new(&gpu, &config, &training, &start::first(&config, None).0).unwrap();
    while !trainer.is_done() {
        trainer.step().unwrap();
    }
    let views = data.train.into_iter().chain(data.test).collect::<Vec<_>>();
    let loader = ImageLoader::new(views.into(), 1 << 30, 0).unwrap();
    let indices: Vec<usize> = (0..loader.views().len()).collect();
    let (scene, options) = (trainer.scene().unwrap(), RenderOptions::default());
    let scores = evaluate::evaluate(&gpu, &scene, &loader, &indices, &options, |_, _, _| Ok(())).unwrap();
    let psnr = evaluate::mean(&scores)[0];
    println!("200 steps on {}: {psnr:.5} dB, {} Gaussians", gpu.info().driver, trainer.gaussians());
    assert!(
        (psnr - TRAINING_PSNR).abs() <= TRAINING_TOLERANCE,
        "{}: {psnr:.5} dB, expected {TRAINING_PSNR} ± {TRAINING_TOLERANCE}",
        gpu.info().driver
    );
}
