//! Capacity: frames that need exactly as much as there is, one more, twice as much, or more than can be.

use engine::Error;
use engine::render::{RenderOptions, Renderer};
use engine::scene::synthetic::random_scene;
use engine::scene::{Camera, Gaussians, Scene};
use glam::DVec3;
use tests_harness::compare;

fn camera(width: u32, height: u32) -> Camera {
    Camera::look_at(DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, DVec3::NEG_Y, 0.9, [width, height])
}

/// `n` Gaussians that each cover the whole image.
fn full_screen(n: usize) -> Scene {
    let mut gaussians = Gaussians { sh_degree: 0, ..Gaussians::default() };
    for i in 0..n {
        gaussians.mean.push([0.0, 0.0, (i % 200) as f32 * 0.01]);
        gaussians.log_scale.push([4.0; 3]);
        gaussians.rotation.push([1.0, 0.0, 0.0, 0.0]);
        gaussians.opacity_logit.push(-3.0);
        gaussians.sh.extend([0.3 * (i % 3) as f32, 0.2, 0.1 * (i % 5) as f32]);
    }
    Scene { gaussians, ..Scene::default() }
}

#[test]
fn growing_gives_the_same_image_as_enough_room() {
    let gpu = tests_harness::gpu();
    let camera = camera(160, 160);
    let with = |max_instances| RenderOptions { max_instances, ..RenderOptions::default() };
    // 500 Gaussians do not fit the first guess of a list; where no more than 30,000 instances are allowed on 100 tiles, lists lie one
    // behind the other, and those of 300 do not fit the first guess of all.
    for (n, max_instances, other) in [(500, None, Some(50_000)), (300, Some(30_000), None)] {
        let scene = full_screen(n);
        let mut renderer = Renderer::new(&gpu, &scene, &with(max_instances)).unwrap();
        let first = renderer.submit(&camera, 0.0).unwrap();
        assert_eq!(renderer.finish(first).unwrap(), None);
        assert_eq!(renderer.commands().unwrap().plan().contains("scan_tiles"), max_instances.is_some());
        let background = renderer.read(first).unwrap();
        assert!(background.rgba.chunks_exact(4).all(|p| p[..3] == [0.0; 3]), "more than the background");
        let (frame, statistics) = renderer.draw(&camera, 0.0).unwrap();
        assert_eq!((statistics.visible, statistics.instances), (n as u32, n as u64 * 100));
        let grown = renderer.read(frame).unwrap();
        let again = renderer.render(&camera, 0.0).unwrap();
        assert!(grown == again, "a frame after growing differs from the next");
        let mut renderer = Renderer::new(&gpu, &scene, &with(other)).unwrap();
        assert!(grown == renderer.render(&camera, 0.0).unwrap(), "where the lists lie shows");
        assert_eq!(renderer.commands().unwrap().plan().contains("scan_tiles"), other.is_some());
        compare::compare(&gpu, &scene, &camera, 0.0, Default::default()).assert_within_bounds("full-screen");
    }
}

#[test]
fn exactly_enough_and_one_too_few() {
    let gpu = tests_harness::gpu();
    let (scene, camera) = (random_scene(3000, 7, 1), camera(200, 120));
    let needed = {
        let mut renderer = Renderer::new(&gpu, &scene, &RenderOptions::default()).unwrap();
        renderer.draw(&camera, 0.0).unwrap().1.instances
    };
    let with = |max_instances| RenderOptions { max_instances: Some(max_instances), ..RenderOptions::default() };
    let mut exact = Renderer::new(&gpu, &scene, &with(needed)).unwrap();
    assert_eq!(exact.draw(&camera, 0.0).unwrap().1.instances, needed);
    let mut short = Renderer::new(&gpu, &scene, &with(needed - 1)).unwrap();
    match short.render(&camera, 0.0) {
        Err(Error::Limit { what, need, have }) => {
            assert_eq!((need, have), (needed.into(), (needed - 1).into()));
            assert!(what.contains("3000 Gaussians"), "{what}");
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn more_instances_than_32_bits_count_is_a_limit_with_the_true_number() {
    let gpu = tests_harness::gpu();
    // 2.2 million Gaussians, each on all 2,048 tiles of a wide, low image.
    let n = 2_200_000;
    let mut renderer = Renderer::new(&gpu, &full_screen(n), &RenderOptions::default()).unwrap();
    match renderer.render(&camera(16_384, 32), 0.0) {
        Err(Error::Limit { need, .. }) => assert_eq!(need, n as u128 * 2048),
        other => panic!("{:?}", other.map(|i| i.width)),
    }
}

#[test]
fn images_past_the_device_are_a_limit() {
    let gpu = tests_harness::gpu();
    let scene = random_scene(10, 1, 0);
    let mut renderer = Renderer::new(&gpu, &scene, &RenderOptions::default()).unwrap();
    for (width, height) in [(0, 1), (1, 0), (16_385, 1), (1, 16_385)] {
        let error = renderer.render(&camera(width.max(1), height.max(1)).resized(width, height), 0.0).unwrap_err();
        assert!(matches!(error, Error::Limit { .. } | Error::Usage { .. } | Error::NonFinite { .. }), "{error}");
    }
    let bytes = 16_384_u64 * 16_384 * 16;
    if bytes > gpu.info().capabilities.max_storage_buffer_range {
        let error = renderer.render(&camera(16_384, 16_384), 0.0).unwrap_err();
        assert!(matches!(error, Error::Limit { .. } | Error::OutOfMemory { .. }), "{error}");
    }
    // The renderer still works after each refusal.
    assert_eq!(renderer.render(&camera(17, 3), 0.0).unwrap().width, 17);
}

/// Lets one allocation of a first frame after another fail: those whose failure is an error. The others leave the right image.
fn failing_allocations(gpu: &tests_harness::TestGpu, scene: &Scene, max_instances: Option<u64>) -> Vec<u64> {
    let options = RenderOptions { max_instances, ..RenderOptions::default() };
    let frame = || Renderer::new(gpu, scene, &options).and_then(|mut r| r.render(&camera(64, 64), 0.0));
    let truth = frame().unwrap();
    let before = gpu.buffer_count();
    // More than there are: the failure that is asked for does not come then.
    let fails = |k: &u64| {
        gpu.inject_allocation_failure(*k);
        let result = frame();
        gpu.inject_allocation_failure(0);
        assert_eq!(gpu.buffer_count(), before, "allocation {k} leaked");
        match result {
            Err(Error::OutOfMemory { .. }) => true,
            Err(other) => panic!("allocation {k}: {other}"),
            Ok(image) => {
                assert!(image == truth);
                false
            }
        }
    };
    (1..100).filter(fails).collect()
}

#[test]
fn every_failing_allocation_is_an_error_without_leaks() {
    let gpu = tests_harness::gpu();
    let scene = random_scene(500, 3, 1);
    // Lists that lie one behind the other are as small as can be: each failure is an error.
    let failures = failing_allocations(&gpu, &scene, Some(8000));
    assert!(failures.len() > 20 && failures.iter().copied().eq(1..=failures.len() as u64), "{failures:?}");
    // Where each list has room of its own, smaller buffers are tried instead.
    let others = failing_allocations(&gpu, &scene, None);
    assert!((11..failures.len()).contains(&others.len()), "{others:?}");
    let failures = failures.len();
    println!("{failures} allocations failed one by one, each an OutOfMemory, nothing leaked");
}

#[test]
fn every_lost_submission_is_an_error() {
    let scene = random_scene(500, 3, 1);
    for k in 1..1000 {
        let gpu = tests_harness::gpu();
        gpu.inject_device_lost(k);
        let result =
            Renderer::new(&gpu, &scene, &RenderOptions::default()).and_then(|mut r| r.render(&camera(64, 64), 0.0));
        match result {
            Err(Error::DeviceLost { .. }) => {}
            Err(other) => panic!("submission {k}: {other}"),
            Ok(_) => {
                assert!(k > 5, "only {k} submissions");
                return;
            }
        }
    }
}
