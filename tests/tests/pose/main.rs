//! Scenes that follow photos: gradients against differences of the f64 reference, and what was disturbed comes back.

mod gauss_newton;
mod reseat;
mod trained;

use std::path::Path;

use clap::Parser as _;
use engine::data::camera_file;
use engine::data::dataset::View;
use engine::data::pixels::{ImageSource, MaskColour};
use engine::file::picture::{Alpha, write_png};
use engine::gpu::Gpu;
use engine::pose::{Bodies, Following, Options, Progress, Solve, apart_px, follow, project};
use engine::reference::{
    Blend64, DeformationAt, Gaussians64, Pose, ReferenceOptions, exp, exp_quaternion, render_deformed, table_poses,
};
use engine::render::{RenderOptions, Renderer};
use engine::scene::synthetic::{Random, moving_scene, random_scene};
use engine::scene::{Camera, Scene};
use engine::train::gradient::{GradientOptions, scene_gradients};
use engine::train::photo_loss::{PhotoLoss, PhotoLossOptions};
use glam::{DMat3, DQuat, DVec3};
use tests_harness::render_case::{RenderInput, test_camera};
use tools::cli::args::{Cli, Command};
use tools::command::pose::Summary;

const LOSS: PhotoLossOptions =
    PhotoLossOptions { background: [0.3, 0.1, 0.6], near: 0.2, lambda_dssim: 0.2, deterministic: true };
/// Largest relative difference of a gradient from the central difference.
const GRADIENT_BOUND: f64 = 1e-4;
/// Superpoints that make up this much of the first photo, pixels, are seen.
const SEEN_PX: f64 = 50.0;
/// Step of the differences, radians and world units: so small that no pixel enters or leaves a splat.
const STEP: f64 = 1e-8;

/// A scene, and a linear loss of its image in f64.
struct Case {
    scene: Scene,
    gaussians: Gaussians64,
    blend: Option<Blend64>,
    camera: Camera,
    poses: Vec<Pose>,
    gradient: Vec<f32>,
}

impl Case {
    fn new(degree: u32, neighbors: usize, seed: u64) -> Self {
        let input = RenderInput::random(120, degree, seed).moving(4, seed + 1);
        let scene = if neighbors > 0 { input.soft(neighbors, seed + 2).scene() } else { input.scene() };
        let camera = test_camera(41, 57);
        let mut random = Random::new(seed);
        let values = 4 * camera.width * camera.height;
        let gradient = (0..values).map(|k| if k % 4 == 3 { 0.0 } else { random.range(-1.0, 1.0) as f32 }).collect();
        // What the device is given, exactly.
        let round = |v: DVec3| v.as_vec3().as_dvec3();
        let poses = table_poses(scene.deformation.table().unwrap(), 0.375);
        let poses = poses.iter().map(|p| Pose { rotation: round(p.rotation), translation: round(p.translation) });
        Self {
            gaussians: Gaussians64::from(&scene.gaussians),
            blend: Blend64::of(&scene),
            poses: poses.collect(),
            camera,
            gradient,
            scene,
        }
    }

    fn loss(&self, camera: &Camera, poses: &[Pose]) -> f64 {
        let group = self.scene.deformation.superpoint_of_gaussian();
        let at = DeformationAt { group, poses: Some(poses), blend: self.blend.as_ref(), offsets: None, time: 0.375 };
        let options = ReferenceOptions { background: LOSS.background.map(f64::from), ..ReferenceOptions::default() };
        let image = render_deformed(&self.gaussians, &at, camera, &options).unwrap();
        let pairs = image.rgb.chunks_exact(3).zip(self.gradient.chunks_exact(4));
        pairs.map(|(c, g)| (0..3).map(|k| c[k] * f64::from(g[k])).sum::<f64>()).sum()
    }

    /// Central differences by three axes.
    fn differences(&self, at: impl Fn(DVec3) -> f64) -> DVec3 {
        DVec3::from_array(
            [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| (at(STEP * axis) - at(-STEP * axis)) / (2.0 * STEP)),
        )
    }
}

fn assert_close(found: [DVec3; 2], expected: [DVec3; 2], context: &str) {
    for (what, found, expected) in [("turn", found[0], expected[0]), ("shift", found[1], expected[1])] {
        let relative = found.distance(expected) / expected.length();
        assert!(relative <= GRADIENT_BOUND, "{context}, {what}: {found} for {expected}, {relative:.1e}");
    }
}

#[test]
fn gradients_are_those_of_differences_of_the_f64_reference() {
    let gpu = tests_harness::shared_gpu();
    for (degree, neighbors) in [(0, 0), (1, 0), (3, 0), (3, 3)] {
        let case = Case::new(degree, neighbors, 30 + u64::from(degree) + neighbors as u64);
        let mut loss = PhotoLoss::new(&gpu, &case.scene, LOSS).unwrap();
        let found = loss.pull_back(&case.gradient, &case.camera, &case.poses, true).unwrap();
        let context = format!("degree {degree}, K = {neighbors}");
        for (j, twist) in found.poses.iter().enumerate() {
            let center = DVec3::new(0.3, -0.2, 0.1 * j as f64);
            let at = |turn: DVec3, shift: DVec3| {
                let mut poses = case.poses.clone();
                let turned = exp_quaternion(turn);
                let rotation = (turned * exp_quaternion(poses[j].rotation)).to_scaled_axis();
                poses[j] = Pose { rotation, translation: center + turned * (poses[j].translation - center) + shift };
                case.loss(&case.camera, &poses)
            };
            let about = twist.about(center);
            let expected =
                [case.differences(|turn| at(turn, DVec3::ZERO)), case.differences(|shift| at(DVec3::ZERO, shift))];
            assert_close([about.rotation, about.translation], expected, &format!("{context}, superpoint {j}"));
        }
        let at = |turn: DVec3, shift: DVec3| {
            let rotation = case.camera.rotation * exp(turn).transpose();
            let camera = Camera { rotation, position: case.camera.position + shift, ..case.camera.clone() };
            case.loss(&camera, &case.poses)
        };
        let camera = found.camera.unwrap();
        let expected =
            [case.differences(|turn| at(turn, DVec3::ZERO)), case.differences(|shift| at(DVec3::ZERO, shift))];
        assert_close([camera.rotation, camera.position], expected, &format!("{context}, camera"));
    }
}

/// Superpoints that rock, with smooth colours, so that photos say where things are.
fn textured(n: usize, m: usize, seed: u64) -> Scene {
    let mut scene = moving_scene(n, m, 7, seed, false);
    let g = &mut scene.gaussians;
    let width = 3 * g.sh_coefficients();
    for (mean, sh) in g.mean.iter().zip(g.sh.chunks_exact_mut(width)) {
        let [x, y, z] = mean.map(f64::from);
        let waves = [(4.0 * x + 2.0 * y).sin(), (5.0 * y - 3.0 * z + 1.0).sin(), (4.0 * z + 3.0 * x + 2.0).sin()];
        (0..3).for_each(|c| sh[c] = 0.35 * sh[c] + 1.2 * waves[c] as f32);
    }
    g.log_scale.iter_mut().flatten().for_each(|s| *s += 0.35);
    scene
}

/// Eight superpoints with the motion of one.
fn moving_as_one() -> Scene {
    let mut scene = textured(4000, 8, 11);
    let motion = scene.deformation.table_mut().unwrap();
    for at in 0..motion.rotation.len() {
        (motion.rotation[at], motion.translation[at]) = (motion.rotation[at / 8 * 8], motion.translation[at / 8 * 8]);
    }
    scene
}

fn cameras(count: usize, size: [u32; 2]) -> Vec<Camera> {
    let camera = |k: usize| {
        let angle = 2.1 * k as f64;
        let eye = DVec3::new(4.0 * angle.cos(), 4.0 * angle.sin(), 1.2);
        Camera { name: format!("photo {k}"), ..Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.75, size) }
    };
    (0..count).map(camera).collect()
}

/// Photos of a scene at a time, as files.
fn photos(gpu: &Gpu, scene: &Scene, cameras: &[Camera], time: f64, folder: &Path) -> Vec<View> {
    let mut renderer = Renderer::new(gpu, scene, &RenderOptions::default()).unwrap();
    let view = |(k, camera): (usize, &Camera)| {
        let path = folder.join(format!("{time}_{k}.png"));
        write_png(&path, &renderer.render(camera, time).unwrap(), Alpha::Drop).unwrap();
        let size = [camera.width, camera.height];
        let image = ImageSource { path, stored: size, size, lens: None, mask: None, used: None };
        View { name: camera.name.clone(), camera: Camera { time, ..camera.clone() }, time, image }
    };
    cameras.iter().enumerate().map(view).collect()
}

fn run(gpu: &Gpu, scene: &Scene, views: &[View], options: &Options, start: Option<&[Pose]>) -> Following {
    follow(gpu, scene, views, options, start, &mut |_: &Progress| true).unwrap().unwrap()
}

/// How much of a photo each Gaussian makes up, pixels.
fn shares(gpu: &Gpu, scene: &Scene, camera: &Camera, time: f64) -> Vec<f64> {
    let options = GradientOptions { near: 0.2, background: [0.0; 3] };
    let ones = vec![1.0; 4 * camera.width as usize * camera.height as usize];
    let found = scene_gradients(gpu, scene, camera, time, &options, &ones).unwrap();
    let of_band_0 = found.sh.chunks_exact(3 * scene.gaussians.sh_coefficients());
    of_band_0.map(|sh| f64::from(sh[..3].iter().fold(0.0_f32, |a, b| a.max(*b))) / 0.2821).collect()
}

/// Root mean square distance of what is seen of each superpoint from where it belongs, pixels.
fn errors_px(scene: &Scene, shares: &[f64], found: &[Pose], truth: &[Pose], camera: &Camera) -> Vec<f64> {
    let mut sums = vec![(0.0, 1e-9); truth.len()];
    let s = scene.deformation.superpoint_deformation().unwrap();
    for (i, mean) in scene.gaussians.mean.iter().enumerate() {
        let x = DVec3::from_array(mean.map(f64::from));
        for (j, _) in s.slots(i) {
            let at = |p: &Pose| project(camera, exp(p.rotation) * x + p.translation);
            let ([a, b], [c, d]) = (at(&found[j]).unwrap(), at(&truth[j]).unwrap());
            let square = (a - c).powi(2) + (b - d).powi(2);
            sums[j] = (sums[j].0 + shares[i] * square, sums[j].1 + shares[i]);
        }
    }
    sums.iter().map(|(sum, n)| (sum / n).sqrt()).collect()
}

/// Each superpoint turned by 5° and moved by 2 % of the scene (2.5 units), any way.
fn disturbed(scene: &Scene, poses: &[Pose], seed: u64) -> Vec<Pose> {
    disturbed_by(scene, poses, 5.0, 0.02 * 2.5, seed)
}

/// Each superpoint turned by some degrees and moved by some world units, any way.
fn disturbed_by(scene: &Scene, poses: &[Pose], degrees: f64, shift: f64, seed: u64) -> Vec<Pose> {
    let (bodies, mut random) = (Bodies::new(scene), Random::new(seed));
    let moved: Vec<_> = bodies
        .stands(poses)
        .iter()
        .map(|s| s.moved(random.direction() * degrees.to_radians(), random.direction() * shift))
        .collect();
    bodies.poses(&moved, poses)
}

#[test]
fn disturbed_superpoints_come_back() {
    let gpu = tests_harness::shared_gpu();
    let folder = tempfile::tempdir().unwrap();
    let scene = textured(4000, 8, 11);
    let time = 0.41;
    let truth = table_poses(scene.deformation.table().unwrap(), time);
    let start = disturbed(&scene, &truth, 5);
    for count in [1, 3] {
        let cameras = cameras(count, [128, 128]);
        let views = photos(&gpu, &scene, &cameras, time, folder.path());
        let options = Options { deterministic: true, ..Options::default() };
        let found = run(&gpu, &scene, &views, &options, Some(&start));
        let table = found.scene.deformation.table().unwrap();
        assert_eq!(table.times.len(), 8);
        let poses = table_poses(table, time);
        let shares = shares(&gpu, &scene, &cameras[0], time);
        let before = errors_px(&scene, &shares, &start, &truth, &cameras[0]);
        let after = errors_px(&scene, &shares, &poses, &truth, &cameras[0]);
        let mut seen_px = vec![0.0; truth.len()];
        let s = scene.deformation.superpoint_deformation().unwrap();
        shares.iter().enumerate().for_each(|(i, share)| s.slots(i).for_each(|(j, w)| seen_px[j] += w * share));
        println!("{count} views, seen {seen_px:.0?} px\nbefore {before:.3?}\nafter  {after:.3?}");
        assert!(found.moments[0].is_new_key);
        let seen: Vec<f64> = (0..truth.len()).filter(|&j| seen_px[j] >= SEEN_PX).map(|j| after[j]).collect();
        assert!(seen.len() >= 5, "{seen_px:.0?}");
        assert!(seen.iter().all(|px| *px <= 0.1), "{seen:.3?}");
    }
}

/// A search that is too short to settle leaves what fits already as it is.
#[test]
fn what_fits_no_better_stays_as_it_was() {
    let gpu = tests_harness::shared_gpu();
    let folder = tempfile::tempdir().unwrap();
    let mut scene = textured(2000, 8, 11);
    let (time, cameras) = (0.41, cameras(1, [64, 64]));
    let truth = table_poses(scene.deformation.table().unwrap(), time);
    let views = photos(&gpu, &scene, &cameras, time, folder.path());
    // Other colours than the photos': these do not fit, and other places do not count.
    scene.gaussians.sh.iter_mut().step_by(7).for_each(|sh| *sh += 0.15);
    let options =
        Options { deterministic: true, iterations: 3, rounds: 0, coupling: 0.0, probes: 0, ..Options::default() };
    let found = run(&gpu, &scene, &views, &options, None);
    let (moment, photo) = (&found.moments[0], &found.moments[0].photos[0]);
    assert!(!moment.is_better && photo.psnr == photo.psnr_before && photo.psnr > 25.0, "{photo:?}");
    let kept = table_poses(found.scene.deformation.table().unwrap(), time);
    let apart = |(a, b): (&Pose, &Pose)| a.translation.distance(b.translation) + a.rotation.distance(b.rotation);
    assert!(kept.iter().zip(&truth).map(apart).fold(0.0, f64::max) < 1e-5);
    let found = run(&gpu, &scene, &views, &options, Some(&disturbed(&scene, &truth, 5)));
    assert!(found.moments[0].is_better);
}

#[test]
fn turned_cameras_come_back_and_those_out_of_reach_are_named() {
    let gpu = tests_harness::shared_gpu();
    let folder = tempfile::tempdir().unwrap();
    let scene = textured(2000, 8, 12);
    let time = 0.3;
    let truth = cameras(1, [96, 96]).remove(0);
    let views = photos(&gpu, &scene, std::slice::from_ref(&truth), time, folder.path());
    let points: Vec<DVec3> = scene.gaussians.mean.iter().map(|m| DVec3::from_array(m.map(f64::from))).collect();
    for degrees in [1.0, 2.0, 70.0] {
        let turn = DQuat::from_axis_angle(DVec3::new(0.3, 0.5, 0.8).normalize(), f64::to_radians(degrees));
        let mut view = views[0].clone();
        // Its place around the scene, itself around another axis.
        let own = DQuat::from_axis_angle(DVec3::new(-0.6, 0.2, 0.5).normalize(), f64::to_radians(degrees));
        view.camera.position = turn * truth.position;
        view.camera.rotation = truth.rotation * DMat3::from_quat(own);
        let options = Options { solve: Solve::Camera, deterministic: true, ..Options::default() };
        let found = run(&gpu, &scene, std::slice::from_ref(&view), &options, None);
        let report = found.moments[0].photos[0].camera.clone().unwrap();
        let before = apart_px(&view.camera, &truth, &points);
        let after = apart_px(&found.cameras[0], &truth, &points);
        println!("{degrees}°: {before:.3?} px → {after:.4?} px, {report:?}");
        assert_eq!(found.scene, scene, "the model stays");
        if degrees < 10.0 {
            assert!(after.is_some_and(|px| px <= 0.1) && report.verdict.is_found());
        } else {
            assert!(!report.verdict.is_found());
        }
    }
}

/// A square that shows the scene moved by some pixels, and that a mask leaves out, moves no camera.
#[test]
fn what_a_mask_leaves_out_moves_no_camera() {
    let gpu = tests_harness::shared_gpu();
    let folder = tempfile::tempdir().unwrap();
    let scene = textured(2000, 8, 12);
    let truth = cameras(1, [96, 96]).remove(0);
    let mut view = photos(&gpu, &scene, std::slice::from_ref(&truth), 0.3, folder.path()).remove(0);
    let points: Vec<DVec3> = scene.gaussians.mean.iter().map(|m| DVec3::from_array(m.map(f64::from))).collect();
    let is_square = |x: u32, y: u32| (24..66).contains(&x) && (34..68).contains(&y);
    let before = image::open(&view.image.path).unwrap().into_rgb8();
    let mut photo = before.clone();
    for (x, y, pixel) in photo.enumerate_pixels_mut().filter(|(x, y, _)| is_square(*x, *y)) {
        *pixel = *before.get_pixel(x + 3, y);
    }
    photo.save(&view.image.path).unwrap();
    let mask = folder.path().join("mask.png");
    image::GrayImage::from_fn(96, 96, |x, y| image::Luma([if is_square(x, y) { 0 } else { 255 }])).save(&mask).unwrap();
    let turn = DQuat::from_axis_angle(DVec3::new(0.3, 0.5, 0.8).normalize(), 1.0_f64.to_radians());
    view.camera.position = turn * truth.position;
    let options = Options { solve: Solve::Camera, deterministic: true, ..Options::default() };
    let mut off_px = |used: Option<MaskColour>| {
        view.image.mask = used.map(|_| mask.clone());
        view.image.used = used;
        let found = run(&gpu, &scene, std::slice::from_ref(&view), &options, None);
        apart_px(&found.cameras[0], &truth, &points).unwrap()
    };
    let (seen, masked) = (off_px(None), off_px(Some(MaskColour::White)));
    println!("{seen:.4} px with the square, {masked:.4} px without it");
    assert!(masked <= 0.1 && seen > 5.0 * masked, "{seen} {masked}");
}

#[test]
fn what_no_pixel_sees_follows_its_neighbours() {
    let gpu = tests_harness::shared_gpu();
    let folder = tempfile::tempdir().unwrap();
    // What training has seen of the others says where the hidden one is.
    let scene = moving_as_one();
    let (time, cameras) = (0.41, cameras(1, [128, 128]));
    let truth = table_poses(scene.deformation.table().unwrap(), time);
    let start = disturbed(&scene, &truth, 5);
    let views = photos(&gpu, &scene, &cameras, time, folder.path());
    let found = run(&gpu, &scene, &views, &Options { deterministic: true, ..Options::default() }, Some(&start));
    let poses = table_poses(found.scene.deformation.table().unwrap(), time);
    let all = vec![1.0; scene.gaussians.len()];
    let before = errors_px(&scene, &all, &start, &truth, &cameras[0]);
    let after = errors_px(&scene, &all, &poses, &truth, &cameras[0]);
    let hidden = (0..8).filter(|&j| !found.moments[0].superpoints[j].seen).count();
    println!("{hidden} hidden\nbefore {before:.3?}\nafter  {after:.3?}");
    assert!(hidden > 0 && after.iter().all(|px| *px <= 0.1), "{after:.3?}");
}

#[test]
fn superpoints_and_cameras_together_show_the_photos() {
    let gpu = tests_harness::shared_gpu();
    let folder = tempfile::tempdir().unwrap();
    let scene = textured(2000, 8, 11);
    let (time, cameras) = (0.41, cameras(3, [96, 96]));
    let truth = table_poses(scene.deformation.table().unwrap(), time);
    let start = disturbed(&scene, &truth, 5);
    let mut views = photos(&gpu, &scene, &cameras, time, folder.path());
    for (k, view) in views.iter_mut().enumerate() {
        let turn = DQuat::from_axis_angle(DVec3::new(0.3, 0.5 - k as f64, 0.8).normalize(), 1.0_f64.to_radians());
        view.camera.position = turn * view.camera.position;
    }
    let options = Options { solve: Solve::Both, deterministic: true, ..Options::default() };
    let found = run(&gpu, &scene, &views, &options, Some(&start));
    let poses = table_poses(found.scene.deformation.table().unwrap(), time);
    // Where the scene is in the world is nobody's to say; where it is in the photos is.
    let shares = shares(&gpu, &scene, &cameras[0], time);
    let s = scene.deformation.superpoint_deformation().unwrap();
    let (mut sum, mut all) = (0.0, 0.0);
    for (i, mean) in scene.gaussians.mean.iter().enumerate() {
        let x = DVec3::from_array(mean.map(f64::from));
        let j = s.superpoints.of_gaussian[i] as usize;
        let at = |p: &Pose, camera: &Camera| project(camera, exp(p.rotation) * x + p.translation).unwrap();
        let ([a, b], [c, d]) = (at(&poses[j], &found.cameras[0]), at(&truth[j], &cameras[0]));
        sum += shares[i] * ((a - c).powi(2) + (b - d).powi(2));
        all += shares[i];
    }
    let px = (sum / all).sqrt();
    println!("{px:.4} px off; {:?}", found.moments[0].photos);
    assert!(px <= 0.1, "{px}");
}

fn cli(args: &[&str]) -> engine::Result<Option<Summary>> {
    let cli = Cli::try_parse_from(["spgs", "--quiet", "pose"].iter().chain(args)).unwrap();
    match &cli.command {
        Command::Pose(args) => tools::command::pose::pose(args, &cli.global),
        _ => unreachable!("the subcommand is pose"),
    }
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

#[test]
fn the_command_writes_all_files_or_none() {
    let gpu = tests_harness::shared_gpu();
    let folder = tempfile::tempdir().unwrap();
    let [data, out] = ["data", "out"].map(|name| folder.path().join(name));
    [&data, &out].into_iter().for_each(|folder| std::fs::create_dir(folder).unwrap());
    let at = |name: &str| out.join(name).display().to_string();
    let scene = textured(500, 4, 17);
    engine::file::save(&out.join("model.safetensors"), &scene).unwrap();
    engine::file::save(&out.join("still.ply"), &random_scene(50, 3, 1)).unwrap();
    let seen = cameras(2, [64, 48]);
    let views = [photos(&gpu, &scene, &seen[..1], 0.3, &data), photos(&gpu, &scene, &seen[1..], 0.6, &data)].concat();
    let named = |v: &View| Camera { name: v.image.path.display().to_string(), ..v.camera.clone() };
    camera_file::write(&data.join("transforms.json"), &views.iter().map(named).collect::<Vec<_>>()).unwrap();
    let images = data.display().to_string();
    let (model, still) = (at("model.safetensors"), at("still.ply"));
    let first = names(&out);
    let rejected = |rest: &[&str], code: u8, word: &str| {
        let error = cli(&[&["--split", "all", "--iterations", "4"], rest].concat()).unwrap_err();
        assert!(error.exit_code() == code && error.to_string().contains(word), "{error}");
        assert_eq!(names(&out), first, "{error}");
    };
    let new = at("new.safetensors");
    rejected(&[&model, "--images", &images, "--solve", "both", "--out", &at("new.ply")], 2, "safetensors");
    rejected(&[&still, "--images", &images, "--solve", "superpoints", "--out", &new], 2, "stands still");
    rejected(&[&model, "--images", &at("none"), "--solve", "camera", "--out", &new], 3, "none");
    rejected(&[&model, "--images", &images, "--solve", "camera", "--from", "7", "--out", &new], 2, "between");
    rejected(&[&model, "--images", &images, "--solve", "camera", "--downscale", "4", "--out", &new], 2, "16x12");
    rejected(&[&model, "--images", &images, "--solve", "camera", "--out", &at("no/new.json")], 2, "folder");
    let common = ["--images", &images, "--split", "all", "--iterations", "12", "--deterministic"];
    let done = cli(&[&[model.as_str(), "--solve", "both", "--out", &new][..], &common].concat()).unwrap().unwrap();
    assert_eq!((done.key_times, done.moments.len()), ([7, 9], 2));
    assert_eq!(done.moments[0].superpoints.len(), 4);
    assert_eq!(engine::file::load(Path::new(&new)).unwrap().scene.deformation.key_times().len(), 9);
    let written = std::fs::read_to_string(at("new.pose.json")).unwrap();
    assert!(written.contains("across_px") && written.contains("not_checked"), "{written}");
    assert_eq!(engine::data::load_cameras(Path::new(&at("new.cameras.json")), None, None).unwrap().cameras.len(), 2);
    let alone = at("cameras.json");
    cli(&[&[still.as_str(), "--solve", "camera", "--out", &alone][..], &common].concat()).unwrap().unwrap();
    let mut all: Vec<String> =
        ["new.safetensors", "new.cameras.json", "new.pose.json", "new.pose.html", "cameras.json"]
            .map(String::from)
            .to_vec();
    let page = std::fs::read_to_string(at("new.pose.html")).unwrap();
    assert_eq!(page.matches("<svg").count(), 2, "charts");
    let mut found = done.moments.iter().flat_map(|m| &m.photos);
    assert!(found.all(|p| page.contains(&format!("<td>{}</td>", p.name))) && page.contains("not checked"), "{page}");
    all.extend(first.clone());
    all.sort();
    assert_eq!(names(&out), all);
    let stopped = follow(&gpu, &scene, &views, &Options::default(), None, &mut |p: &Progress| p.iteration < 3).unwrap();
    assert!(stopped.is_none(), "the watcher wants an end");
}

#[test]
fn the_same_bits_twice() {
    let gpu = tests_harness::shared_gpu();
    let folder = tempfile::tempdir().unwrap();
    let scene = textured(800, 5, 13);
    let views = photos(&gpu, &scene, &cameras(2, [64, 48]), 0.55, folder.path());
    let start = disturbed(&scene, &table_poses(scene.deformation.table().unwrap(), 0.55), 3);
    let options = Options { solve: Solve::Both, deterministic: true, iterations: 40, probes: 2, ..Options::default() };
    let [one, two] = [0, 1].map(|_| run(&gpu, &scene, &views, &options, Some(&start)));
    assert_eq!(one, two);
    let bits = |f: &Following| -> Vec<u32> {
        f.scene.deformation.table().unwrap().rotation.as_flattened().iter().map(|v| v.to_bits()).collect()
    };
    assert_eq!(bits(&one), bits(&two));
}
