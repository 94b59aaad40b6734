//! Key poses of a table that are trained themselves, as `spgs distill --iterations` does.

use engine::data::pixels::Pixels;
use engine::distill::{Lessons, TuneOptions, Tuned, tune};
use engine::gpu::Gpu;
use engine::metrics::psnr::psnr_8bit;
use engine::reference::place_scene;
use engine::render::{RenderOptions, Renderer};
use engine::scene::synthetic::{Random, moving_scene, random_blend};
use engine::scene::{Camera, MotionSource, Scene};
use engine::train::bake::Views;
use glam::DVec3;

use crate::common::gpu;

fn cameras() -> Vec<Camera> {
    let camera = |k: usize| {
        let angle = std::f64::consts::TAU * k as f64 / 8.0;
        let eye = DVec3::new(4.0 * angle.cos(), 4.0 * angle.sin(), 1.2);
        Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.75, [64, 64])
    };
    (0..8).map(camera).collect()
}

/// Large Gaussians of different colours that move with six superpoints.
fn teacher(soft: bool) -> Scene {
    let mut scene = moving_scene(400, 6, 4, 21, false);
    scene.gaussians.log_scale.iter_mut().flatten().for_each(|s| *s += 0.4);
    if soft {
        let blend = random_blend(400, 6, 3, 2);
        let superpoints = scene.deformation.superpoint_deformation_mut().unwrap();
        superpoints.superpoints.of_gaussian = blend.of_gaussian();
        superpoints.blend = Some(blend);
    }
    scene
}

/// The teacher with every key pose moved.
fn disturbed(teacher: &Scene) -> Scene {
    let (mut scene, mut random) = (teacher.clone(), Random::new(4));
    for t in &mut scene.deformation.table_mut().unwrap().translation {
        let by = 0.05 * random.direction();
        *t = (DVec3::from_array(t.map(f64::from)) + by).as_vec3().to_array();
    }
    scene
}

fn tuned(gpu: &Gpu, teacher: &Scene, student: &Scene, iterations: u64, seed: u64) -> engine::Result<Tuned> {
    let mut renderer = Renderer::new(gpu, teacher, &RenderOptions::default()).unwrap();
    let mut draw = |camera: &Camera| Ok(Pixels::opaque(&renderer.render(camera, camera.time)?));
    let lessons = Lessons {
        transients: None,
        photos: Vec::new(),
        cameras: cameras(),
        times: teacher.time_range(),
        draw: &mut draw,
        exposures: None,
    };
    let views = Views { cameras: cameras(), near: 0.2, everywhere: true };
    let (background, rate_px) = ([0.0; 3], Some([0.05, 0.005]));
    let options = TuneOptions { iterations, seed, background, near: 0.2, rate_px, deterministic: true };
    let mut steps = 0;
    let found = tune(gpu, student, &views, lessons, &options, &mut |done| {
        steps += 1;
        assert_eq!(done.iteration, steps);
    })?;
    assert_eq!(steps, iterations);
    Ok(found)
}

/// Mean distance of the Gaussians from where the teacher has them, and PSNR against it.
fn off(gpu: &Gpu, teacher: &Scene, student: &Scene) -> (f64, f64) {
    let (mut distance, mut psnr) = (0.0, 0.0);
    let [mut a, mut b] = [teacher, student].map(|s| Renderer::new(gpu, s, &RenderOptions::default()).unwrap());
    for (k, camera) in cameras().iter().enumerate() {
        let time = (k as f64 + 0.5) / 8.0;
        let [one, two] = [teacher, student].map(|s| place_scene(s, time, MotionSource::Auto).unwrap().mean);
        distance += one.iter().zip(&two).map(|(a, b)| a.distance(*b)).sum::<f64>() / one.len() as f64;
        psnr += psnr_8bit(&a.render(camera, time).unwrap(), &b.render(camera, time).unwrap()).unwrap();
    }
    (distance / 8.0, psnr / 8.0)
}

#[test]
fn key_poses_find_the_way_back() {
    let gpu = gpu();
    for soft in [false, true] {
        let teacher = teacher(soft);
        let student = disturbed(&teacher);
        let found = tuned(&gpu, &teacher, &student, 300, 1).unwrap();
        let [(far, low), (near, high)] = [&student, &found.scene].map(|s| off(&gpu, &teacher, s));
        println!("soft {soft}: {far:.4} to {near:.4}, {low:.2} to {high:.2} dB, loss {:?}", found.loss);
        assert!(near < 0.6 * far && high > low + 4.0, "soft {soft}: {far} to {near}, {low} to {high} dB");
        assert!(found.loss[1] < 0.7 * found.loss[0] && found.images == [0, 256], "{:?}", found.loss);
        found.scene.deformation.check(found.scene.gaussians.len()).unwrap();
        assert_eq!(found.scene.deformation.key_times(), teacher.deformation.key_times());
        let of = |s: &Scene| s.deformation.superpoint_of_gaussian().to_vec();
        assert_eq!(of(&found.scene), of(&teacher), "Gaussians stay with their superpoints");
    }
}

#[test]
fn the_same_seed_gives_the_same_bits() {
    let gpu = gpu();
    let teacher = teacher(false);
    let student = disturbed(&teacher);
    let [a, b, other] = [(20, 7), (20, 7), (20, 8)].map(|(n, seed)| tuned(&gpu, &teacher, &student, n, seed).unwrap());
    assert!(a.scene == b.scene && a.loss == b.loss, "twice the same");
    assert!(a.scene != other.scene, "another seed looks elsewhere");
}

#[test]
fn what_cannot_be_trained_is_rejected() {
    let gpu = gpu();
    let teacher = teacher(false);
    let word = |found: engine::Result<Tuned>| found.unwrap_err().to_string();
    assert!(word(tuned(&gpu, &teacher, &teacher, 0, 0)).contains("fine-tuning"));
    // A model that stands still is trained as it is.
    let still = Scene { gaussians: teacher.gaussians.clone(), ..Scene::default() };
    let found = tuned(&gpu, &teacher, &still, 5, 0).unwrap();
    assert!(!found.scene.deformation.moves() && found.scene.gaussians != still.gaussians);
}
