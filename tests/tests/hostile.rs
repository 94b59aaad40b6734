//! Poison in every parameter slot, alone and at random: no hang, no NaN in the image, the bad Gaussian refused and
//! counted, the rest equal to the f64 reference.

use engine::Error;
use engine::gpu::Gpu;
use engine::render::{RenderOptions, Renderer};
use engine::scene::synthetic::{Random, random_scene};
use engine::scene::{Camera, Rejected, Scene};
use glam::DVec3;
use tests_harness::compare::compare;
use tools::bench::hard_cases::poison::{POISON, camera, poison, slots};

const SIZES: [[u32; 2]; 12] = [
    [1, 1],
    [1, 17],
    [17, 1],
    [15, 15],
    [16, 16],
    [17, 17],
    [33, 9],
    [64, 64],
    [65, 63],
    [128, 1],
    [257, 3],
    [100, 80],
];

/// Renders on both sides; the refused Gaussians must be counted on the device as on the host.
fn check(gpu: &Gpu, scene: &Scene, size: [u32; 2], what: &str) {
    let c = compare(gpu, scene, &camera(size), 0.0, Default::default());
    assert!(c.color.psnr >= 65.0, "{what}: {:?}", c.color);
    let mut rejected = Rejected::default();
    let g = &scene.gaussians;
    let refused = (0..g.len()).filter(|&i| !g.is_valid(i, &mut rejected)).count();
    let mut renderer = Renderer::new(gpu, scene, &RenderOptions::default()).unwrap();
    let statistics = renderer.draw(&camera(size), 0.0).unwrap().1;
    assert_eq!(renderer.rejected().total(), refused, "{what}");
    assert!(statistics.rejected as usize >= refused, "{what}: device counted {} of {refused}", statistics.rejected);
}

#[test]
fn every_slot_times_every_value() {
    let gpu = tests_harness::shared_gpu();
    let base = random_scene(8, 21, 1);
    for slot in 0..slots(&base.gaussians) {
        for value in POISON {
            let mut scene = base.clone();
            poison(&mut scene.gaussians, 3, slot, value);
            check(&gpu, &scene, [33, 17], &format!("slot {slot} = {value:e}"));
        }
    }
}

#[test]
fn random_poisoned_scenes() {
    let seed = std::env::var("SEED").ok().and_then(|s| s.parse().ok()).unwrap_or(1);
    println!("SEED={seed}");
    let gpu = tests_harness::shared_gpu();
    let mut random = Random::new(seed);
    for round in 0..200 {
        let n = 1 + random.below(256);
        let mut scene = random_scene(n, seed * 1000 + round, (round % 4) as u32);
        let rate = random.range(0.0, 0.95);
        let slots = slots(&scene.gaussians);
        for i in 0..n {
            if random.uniform() < rate {
                poison(&mut scene.gaussians, i, random.below(slots), POISON[random.below(POISON.len())]);
            }
        }
        check(&gpu, &scene, SIZES[random.below(SIZES.len())], &format!("SEED={seed} round {round}"));
    }
}

#[test]
fn senseless_cameras_are_errors() {
    let gpu = tests_harness::shared_gpu();
    let mut renderer = Renderer::new(&gpu, &random_scene(10, 1, 0), &RenderOptions::default()).unwrap();
    let good = camera([16, 16]);
    let nan = f64::NAN;
    let mut bad = vec![
        Camera { fx: nan, ..good.clone() },
        Camera { fy: 0.0, ..good.clone() },
        Camera { fx: -10.0, ..good.clone() },
        Camera { cx: f64::INFINITY, ..good.clone() },
        Camera { position: DVec3::new(0.0, nan, 0.0), ..good.clone() },
        Camera { position: DVec3::splat(1e300), ..good.clone() },
    ];
    bad.push(Camera { rotation: good.rotation * nan, ..good.clone() });
    for camera in bad {
        let error = renderer.render(&camera, 0.0).unwrap_err();
        assert!(matches!(error, Error::NonFinite { .. } | Error::Usage { .. }), "{error}");
    }
    for time in [nan, f64::INFINITY, -f64::INFINITY] {
        assert!(renderer.render(&good, time).is_err(), "time {time}");
    }
    assert!(renderer.render(&good, 0.0).is_ok());
}
