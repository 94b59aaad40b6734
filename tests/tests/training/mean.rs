//! The mean of network F's weights: what is looked at has it, what is trained does not.

use engine::render::{RenderOptions, Renderer};
use engine::train::checkpoint::Checkpoint;
use engine::train::config::{Config, MotionConfig};
use engine::train::trainer::Trainer;

use crate::common::{PosedOptions, advance, config, gpu, load, posed, scene_of_resumed_run, trainer};

const MEAN: &str = "[schedule]\nscale = false\n[motion]\nnetwork_mean = 4";

fn weights(checkpoint: &Checkpoint, name: &str) -> Vec<f32> {
    checkpoint.saved.floats(&format!("network_f.{name}"), None).unwrap()
}

fn apart(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn the_mean_follows_the_weights_and_is_what_is_shown() {
    let posed = posed(&PosedOptions::default());
    let (_, data) = load(&posed);
    let gpu = gpu();
    let mut run = trainer(&gpu, &config(MEAN), &data).unwrap();
    // Motion begins; the mean starts from the first weights.
    while run.motion_at(&[0.0]).unwrap().is_none() {
        run.step().unwrap();
    }
    let begun = run.checkpoint().unwrap();
    let mut expected: Vec<f64> = weights(&begun, "mean").into_iter().map(f64::from).collect();
    for _ in 0..6 {
        run.step().unwrap();
        let now = weights(&run.checkpoint().unwrap(), "weights");
        expected.iter_mut().zip(&now).for_each(|(mean, w)| *mean += 0.25 * (f64::from(*w) - *mean));
    }
    let checkpoint = run.checkpoint().unwrap();
    let (mean, last) = (weights(&checkpoint, "mean"), weights(&checkpoint, "weights"));
    let expected: Vec<f32> = expected.into_iter().map(|v| v as f32).collect();
    assert!(apart(&mean, &expected) <= 1e-6, "{:e}", apart(&mean, &expected));
    assert!(apart(&mean, &last) > 1e-4, "the weights move on: {:e}", apart(&mean, &last));

    // The scene of a run, that of its checkpoint, and the poses that a model is baked from.
    let shown = run.scene().unwrap().deformation.network().unwrap().flatten();
    assert!(shown == mean);
    assert!(checkpoint.clone().into_scene().unwrap().deformation.network().unwrap().flatten() == mean);
    let poses = run.motion_at(&[0.3]).unwrap().unwrap().translation;
    let mut without = checkpoint.clone();
    without.saved.put_floats("network_f.mean", vec![last.len()], &last);
    let others = Trainer::resume(&gpu, &data, &without).unwrap().motion_at(&[0.3]).unwrap().unwrap().translation;
    assert!(poses != others);
    // What is trained goes on from the last weights: the same step, whatever the mean.
    let mut resumed = Trainer::resume(&gpu, &data, &without).unwrap();
    for run in [&mut run, &mut resumed] {
        run.step().unwrap();
    }
    let trained = [&run, &resumed].map(|run| weights(&run.checkpoint().unwrap(), "weights"));
    assert!(trained[0] == trained[1] && trained[0] != last);
}

#[test]
fn the_mean_goes_through_files_and_a_resumed_run() {
    assert!(scene_of_resumed_run(MEAN).deformation.network().is_some());
}

#[test]
fn a_checkpoint_without_one_starts_it_from_its_weights() {
    let posed = posed(&PosedOptions::default());
    let (_, data) = load(&posed);
    let gpu = gpu();
    let mut run = trainer(&gpu, &config(""), &data).unwrap();
    advance(&mut run, 23).unwrap();
    let mut before = run.checkpoint().unwrap();
    assert!(!before.saved.has("network_f.mean"), "off as in the paper");
    before.config = config(MEAN);
    let resumed = Trainer::resume(&gpu, &data, &before).unwrap().checkpoint().unwrap();
    assert!(weights(&resumed, "mean") == weights(&before, "weights"));
}

/// Network G is trained on what was shown.
#[test]
fn the_nonrigid_stage_moves_gaussians_by_the_mean() {
    let posed = posed(&PosedOptions::default());
    let (_, data) = load(&posed);
    let gpu = gpu();
    let config = config(MEAN);
    let mut rigid = trainer(&gpu, &config, &data).unwrap();
    advance(&mut rigid, 23).unwrap();
    let rigid = rigid.checkpoint().unwrap();
    let stage = Trainer::nonrigid(&gpu, &config, &data, &rigid).unwrap().checkpoint().unwrap();
    assert!(weights(&stage, "weights") == weights(&rigid, "mean"));
    assert!(weights(&rigid, "weights") != weights(&rigid, "mean"));
    // Also where this stage keeps none.
    let without = Config { motion: MotionConfig { network_mean: 0, ..config.motion.clone() }, ..config };
    let stage = Trainer::nonrigid(&gpu, &without, &data, &rigid).unwrap().checkpoint().unwrap();
    assert!(weights(&stage, "weights") == weights(&rigid, "mean"));
}

/// What evaluations draw has no network F: its poses are in a table of the times that are wanted.
#[test]
fn a_scene_at_given_times_shows_what_network_f_shows() {
    let posed = posed(&PosedOptions::default());
    let (_, data) = load(&posed);
    let gpu = gpu();
    let mut run = trainer(&gpu, &config(MEAN), &data).unwrap();
    assert!(run.scene_at([0.5]).unwrap().deformation.table().is_none(), "nothing moves yet");
    while run.motion_at(&[0.0]).unwrap().is_none() {
        run.step().unwrap();
    }
    let later = run.iteration() + 5;
    advance(&mut run, later).unwrap();
    let times = [0.75, 0.25, 0.75];
    let (with_network, with_table) = (run.scene().unwrap(), run.scene_at(times).unwrap());
    assert!(with_network.deformation.network().is_some() && with_table.deformation.network().is_none());
    assert_eq!(with_table.deformation.key_times(), [0.25, 0.75]);
    let alone = run.scene_at([0.25]).unwrap();
    let camera = &data.views[0].camera;
    let image =
        |scene, time| Renderer::new(&gpu, scene, &RenderOptions::default()).unwrap().render(camera, time).unwrap().rgba;
    for time in times {
        let (expected, found) = (image(&with_network, time), image(&with_table, time));
        assert!(apart(&expected, &found) < 1e-4, "time {time}: {:e}", apart(&expected, &found));
    }
    let (expected, found) = (image(&with_network, 0.25), image(&alone, 0.25));
    assert!(apart(&expected, &found) < 1e-4, "one time: {:e}", apart(&expected, &found));
    assert!(apart(&image(&with_network, 0.75), &expected) > 1e-3, "it moves");
}
