//! An object that moves by more than its size between photos is found, and followed.

use engine::distill::{OfPhotos, Refitted, refit};
use engine::render::RenderOptions;
use engine::scene::{Gaussians, Scene};
use engine::train::checkpoint::Checkpoint;
use engine::train::evaluate;
use engine::train::lost::LostObject;
use engine::train::trainer::Trainer;
use glam::{DMat3, DVec3};
use tests_harness::posed::is_of_stick;

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

fn scene(balls: usize) -> Posed {
    let sizes = vec![[96, 96]];
    posed(&PosedOptions { sizes, train: 30, test: 0, gaussians: 150, swing: 0.0, balls, ..PosedOptions::default() })
}

/// All of the scene's Gaussians but the ball's.
fn without_ball(posed: &Posed) -> Gaussians {
    posed.scene.gaussians.selected(&others(posed, 2))
}

/// Gaussians of the superpoints below this one.
fn others(posed: &Posed, below: u32) -> Vec<usize> {
    let superpoints = posed.scene.deformation.superpoint_of_gaussian();
    (0..superpoints.len()).filter(|&i| superpoints[i] < below).collect()
}

fn trainer(posed: &Posed, over: &str) -> Trainer {
    Trainer::new(&gpu(), &config(over), &load(posed).1, &without_ball(posed)).unwrap()
}

#[test]
fn a_ball_that_the_warm_up_loses_is_found_and_followed() {
    let posed = scene(1);
    let mut run = trainer(&posed, RUN);
    let before = run.gaussians();
    advance(&mut run, 3).unwrap();
    let LostObject { seen, photos, radius, path, gaussians, .. } = run.take_lost_object().unwrap();
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
    let posed = scene(0);
    let mut run = trainer(&posed, RUN);
    let before = run.gaussians();
    advance(&mut run, 4).unwrap();
    assert_eq!((run.take_lost_object(), run.gaussians()), (None, before));
}

#[test]
fn a_run_that_follows_a_path_is_resumed_with_the_same_bits() {
    let posed = scene(1);
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

/// Photos without alpha, and the last steps of a run whose model has no ball.
fn refitted(posed: &Posed, over: &str, student: &Scene) -> (Refitted, f64) {
    let (data, gpu) = (load(posed).0, gpu());
    let mut config = config(over);
    config.background = [1.0; 3];
    let found = refit(&gpu, student, &data.train, &config, OfPhotos::default(), &mut |_, _, _| {}, &mut |_| {});
    let found = found.unwrap().unwrap();
    let loader = engine::data::loader::ImageLoader::new(data.train.into(), 1 << 30, 0).unwrap();
    let indices: Vec<usize> = (0..loader.views().len()).collect();
    let options = RenderOptions { background: [1.0; 3], ..RenderOptions::default() };
    let scores = evaluate::evaluate(&gpu, &found.scene, &loader, &indices, &options, |_, _, _| Ok(())).unwrap();
    (found, evaluate::mean(&scores)[0])
}

/// The last steps of a run that looks for lost objects.
const LATE: &str = "iterations = 120\n[motion]\nlost_objects = true\n[refit]\niterations = 100\nerror = 0.02";

/// Two balls before what is opaque and stands still.
fn two_balls() -> Posed {
    let sizes = vec![[96, 96]];
    let options = PosedOptions { sizes, train: 40, test: 0, gaussians: 150, swing: 0.0, ..PosedOptions::default() };
    posed(&PosedOptions { balls: 2, opaque: true, ..options })
}

#[test]
fn two_balls_that_leave_nothing_empty_are_found_at_the_end() {
    let posed = two_balls();
    let kept = others(&posed, 1);
    let mut student = Scene { gaussians: posed.scene.gaussians.selected(&kept), ..posed.scene.clone() };
    student.deformation.superpoint_deformation_mut().unwrap().superpoints.of_gaussian = vec![0; kept.len()];
    let (found, with) = refitted(&posed, LATE, &student);
    let (lost, without) = refitted(&posed, &LATE.replace("true", "false"), &student);
    println!("{:?}, {with:.2} dB with the balls, {without:.2} dB without", found.lost_objects);
    assert_eq!((found.lost_objects.len(), lost.lost_objects.len()), (2, 0));
    for object in &found.lost_objects {
        assert!(object.seen > 25 && object.photos == 40, "{object}");
        assert!((0.1..0.4).contains(&object.radius) && (1.5..3.0).contains(&object.path), "{object}");
    }
    let superpoints = |found: &Refitted| found.scene.deformation.superpoint_count();
    assert_eq!(superpoints(&found), superpoints(&lost) + 2);
    assert!(with > without + 3.0, "with the balls {with:.2} dB, without {without:.2} dB");
    // Nothing more is found in what has them.
    assert_eq!(refitted(&posed, LATE, &found.scene).0.lost_objects, []);
}

/// Where network F found no motion at all, the last iterations are not lost: they train what stands still, and find what is missing.
#[test]
fn what_stands_still_learns_to_the_end_and_balls_are_found_in_it() {
    let posed = two_balls();
    let student = Scene { gaussians: posed.scene.gaussians.selected(&others(&posed, 1)), ..Scene::default() };
    let (found, with) = refitted(&posed, LATE, &student);
    let (still, without) = refitted(&posed, &LATE.replace("true", "false"), &student);
    println!("{:?}, {with:.2} dB with the balls, {without:.2} dB without", found.lost_objects);
    assert!(!still.scene.deformation.moves() && still.scene.gaussians != student.gaussians);
    assert_eq!(found.lost_objects.len(), 2);
    assert!(found.scene.deformation.moves());
    assert!(with > without + 3.0, "with the balls {with:.2} dB, without {without:.2} dB");
}

/// The hand is there, but of how it turns not all is known: it is small and round.
#[test]
fn a_stick_that_a_hand_swings_is_found_by_the_hand() {
    const LATE: &str = "iterations = 160\n[motion]\nlost_objects = true\n[refit]\niterations = 140\nerror = 0.02";
    let sizes = vec![[96, 96]];
    let options = PosedOptions { sizes, train: 60, test: 0, gaussians: 180, swing: 0.0, ..PosedOptions::default() };
    let posed = posed(&PosedOptions { stick: true, ..options });
    let superpoints = posed.scene.deformation.superpoint_of_gaussian();
    let of_hand: Vec<usize> = (0..superpoints.len()).filter(|&i| superpoints[i] == 2).collect();
    let stick: Vec<usize> = (0..of_hand.len()).filter(|&at| is_of_stick(at)).map(|at| of_hand[at]).collect();
    let kept: Vec<usize> = (0..superpoints.len()).filter(|i| !stick.contains(i)).collect();
    let mut student = Scene { gaussians: posed.scene.gaussians.selected(&kept), ..posed.scene.clone() };
    let moved = student.deformation.superpoint_deformation_mut().unwrap();
    moved.superpoints.of_gaussian = kept.iter().map(|&i| superpoints[i]).collect();
    let center = DVec3::from_array(posed.scene.gaussians.mean[of_hand[0]].map(f64::from));
    let table = moved.table.as_mut().unwrap();
    for (rotation, translation) in table.rotation.iter_mut().zip(&mut table.translation).skip(2).step_by(3) {
        let turn = |z: f32| DMat3::from_rotation_z(f64::from(z)) * center;
        let lost = turn(rotation[2]) - turn(0.7 * rotation[2]);
        rotation[2] *= 0.7;
        *translation = (DVec3::from_array(translation.map(f64::from)) + lost).as_vec3().to_array();
    }
    let (found, with) = refitted(&posed, LATE, &student);
    let (lost, without) = refitted(&posed, &LATE.replace("true", "false"), &student);
    println!("{:?}, {with:.2} dB with the stick, {without:.2} dB without", found.lost_objects);
    assert_eq!((found.lost_objects.len(), lost.lost_objects.len()), (1, 0));
    let object = found.lost_objects[0];
    assert!(object.attached_to.is_some() && object.seen > 45 && object.photos == 60, "{object}");
    assert!((0.2..0.35).contains(&object.radius) && object.path > 0.5, "{object}");
    assert!(with > without + 3.0, "with the stick {with:.2} dB, without {without:.2} dB");
    // Where nothing is missing nothing is found.
    assert_eq!(refitted(&posed, LATE, &posed.scene).0.lost_objects, []);
}
