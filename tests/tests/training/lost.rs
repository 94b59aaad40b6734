//! An object that moves by more than its size between photos is found, and followed.

use engine::scene::Gaussians;
use engine::train::checkpoint::Checkpoint;
use engine::train::lost::LostObject;
use engine::train::trainer::Trainer;

use crate::common::{Posed, PosedOptions, advance, bytes, config, gpu, load, posed};
use crate::quality::psnr_from;

const RUN: &str = "
iterations = 40
[schedule]
warm_up = 3
[motion]
lost_objects = true
superpoints = 20
[density]
enabled = false
";

fn scene(ball: bool) -> Posed {
    let sizes = vec![[96, 96]];
    posed(&PosedOptions { sizes, train: 30, test: 0, gaussians: 150, swing: 0.0, ball, ..PosedOptions::default() })
}

/// All of the scene's Gaussians but the ball's.
fn without_ball(posed: &Posed) -> Gaussians {
    let superpoints = posed.scene.deformation.superpoint_of_gaussian();
    let others: Vec<usize> = (0..superpoints.len()).filter(|&i| superpoints[i] != 2).collect();
    posed.scene.gaussians.selected(&others)
}

fn trainer(posed: &Posed, over: &str) -> Trainer {
    Trainer::new(&gpu(), &config(over), &load(posed).1, &without_ball(posed)).unwrap()
}

#[test]
fn a_ball_that_the_warm_up_loses_is_found_and_followed() {
    let posed = scene(true);
    let mut run = trainer(&posed, RUN);
    let before = run.gaussians();
    advance(&mut run, 3).unwrap();
    let LostObject { seen, photos, radius, path, gaussians } = run.take_lost_object().unwrap();
    assert!(seen > 20 && photos == 30, "{seen} of {photos}");
    assert!((0.1..0.5).contains(&radius) && (1.5..3.0).contains(&path), "{radius} {path}");
    assert_eq!(before as usize + gaussians, run.gaussians() as usize);
    // Its Gaussians move as the ball does.
    let table = run.motion_at(&[0.0, 0.25, 0.5]).unwrap().unwrap();
    let farthest = |time: usize| {
        let of_time = &table.translation[time * 20..(time + 1) * 20];
        let [first, second] = [&table.translation[..20], of_time];
        let moved = |(a, b): (&[f32; 3], &[f32; 3])| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f32>().sqrt();
        first.iter().zip(second).map(moved).fold(0.0, f32::max)
    };
    assert!(farthest(1) > 1.0 && farthest(2) > 1.0, "{} {}", farthest(1), farthest(2));
    let followed = psnr_from(&posed, RUN, &without_ball(&posed));
    let lost = psnr_from(&posed, &RUN.replace("lost_objects = true", "lost_objects = false"), &without_ball(&posed));
    eprintln!("PSNR with the ball {followed:.2} dB, without {lost:.2} dB");
    assert!(followed > lost + 2.0, "with the ball {followed:.2} dB, without {lost:.2} dB");
}

#[test]
fn where_nothing_is_lost_nothing_is_found() {
    let posed = scene(false);
    let mut run = trainer(&posed, RUN);
    let before = run.gaussians();
    advance(&mut run, 4).unwrap();
    assert_eq!((run.take_lost_object(), run.gaussians()), (None, before));
}

#[test]
fn a_run_that_follows_a_path_is_resumed_with_the_same_bits() {
    let posed = scene(true);
    let data = load(&posed).1;
    let mut whole = trainer(&posed, RUN);
    advance(&mut whole, 6).unwrap();
    assert!(whole.take_lost_object().is_some());
    let folder = tempfile::tempdir().unwrap();
    let path = whole.checkpoint().unwrap().save(folder.path()).unwrap();
    let saved = Checkpoint::load(&path).unwrap();
    // Neither holds network F: it does not know where the path goes.
    let table =
        |scene: engine::scene::Scene| scene.deformation.superpoint_deformation().unwrap().table.clone().unwrap();
    assert_eq!(table(Checkpoint::load(&path).unwrap().into_scene().unwrap()), table(whole.scene().unwrap()));
    let mut resumed = Trainer::resume(&gpu(), &data, &saved).unwrap();
    for trainer in [&mut whole, &mut resumed] {
        advance(trainer, 12).unwrap();
    }
    assert!(bytes(&whole.checkpoint().unwrap()) == bytes(&resumed.checkpoint().unwrap()));
}
