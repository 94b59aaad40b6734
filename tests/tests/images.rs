//! Whole frames against the f64 reference: synthetic scenes, the oracle and trained models.

use engine::image::difference;
use engine::render::{MOST_BESIDE, RenderOptions, Renderer};
use engine::scene::synthetic::{demo_camera, demo_scene, moving_scene, random_scene};
use engine::scene::{Camera, MotionSource};
use glam::DVec3;
use tests_harness::compare::{MIN_PSNR, compare};

fn camera(width: u32, height: u32) -> Camera {
    Camera::look_at(DVec3::new(0.3, -1.0, -4.5), DVec3::ZERO, DVec3::NEG_Y, 0.8, [width, height])
}

#[test]
fn random_scenes_of_every_sh_degree() {
    let gpu = tests_harness::shared_gpu();
    for degree in 0..=3 {
        let scene = random_scene(4000, u64::from(degree) + 1, degree);
        let c = compare(&gpu, &scene, &camera(200, 150), 0.0, MotionSource::Auto);
        c.assert_within_bounds(&format!("random SH {degree}"));
    }
}

#[test]
fn moving_scenes_by_table_and_by_network() {
    let gpu = tests_harness::shared_gpu();
    let scene = moving_scene(3000, 40, 6, 5, true);
    for (name, motion) in [("table", MotionSource::Table), ("network", MotionSource::Network)] {
        for time in [0.0, 0.37, 1.0] {
            let c = compare(&gpu, &scene, &camera(160, 120), time, motion);
            c.assert_within_bounds(&format!("moving by {name} at {time}"));
        }
    }
}

#[test]
fn demo_scene_within_bounds() {
    let gpu = tests_harness::shared_gpu();
    for time in [0.0, 0.4] {
        let c = compare(&gpu, &demo_scene(), &demo_camera(time, 320, 240), time, MotionSource::Auto);
        c.assert_within_bounds(&format!("demo at {time}"));
    }
}

#[test]
fn crops_equal_the_whole() {
    let gpu = tests_harness::shared_gpu();
    // Small splats: a large one beyond the edge of a crop meets the tangent clamp there, but not in the whole image.
    let mut scene = random_scene(2000, 13, 2);
    for scale in scene.gaussians.log_scale.iter_mut().flatten() {
        *scale = scale.min(-4.5);
    }
    let whole_camera = camera(96, 64);
    let whole = compare(&gpu, &scene, &whole_camera, 0.0, MotionSource::Auto).image;
    for (x0, y0) in [(0, 0), (48, 0), (0, 32), (48, 32)] {
        let crop = Camera {
            width: 48,
            height: 32,
            cx: whole_camera.cx - f64::from(x0),
            cy: whole_camera.cy - f64::from(y0),
            ..whole_camera.clone()
        };
        let part = compare(&gpu, &scene, &crop, 0.0, MotionSource::Auto).image;
        let mut worst = 0.0_f32;
        for y in 0..32_usize {
            for x in 0..48 * 4_usize {
                let full = whole.rgba[(y + y0 as usize) * 96 * 4 + x0 as usize * 4 + x];
                worst = worst.max((full - part.rgba[y * 48 * 4 + x]).abs());
            }
        }
        assert!(worst < 1e-3, "crop at {x0},{y0} differs by {worst}");
    }
}

#[test]
fn oracle_files() {
    let Some(folder) = tests_harness::data("oracle") else { return };
    let gpu = tests_harness::shared_gpu();
    let mut seen = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if !path.file_name().unwrap().to_string_lossy().starts_with("gaussians") {
            continue;
        }
        let case = tools::dev::oracle::case::load(&path).unwrap();
        let truth = tools::dev::oracle::case::reference_difference(&case).unwrap();
        let (scene, view, background, near) = tools::dev::oracle::case::as_scene(&case);
        let options = RenderOptions { background, near, ..RenderOptions::default() };
        let image = Renderer::new(&gpu, &scene, &options).unwrap().render(&view, 0.0).unwrap();
        let rgb = image.rgba.chunks_exact(4).flat_map(|p| [f64::from(p[0]), f64::from(p[1]), f64::from(p[2])]);
        let device = difference(case.image.iter().copied(), rgb);
        println!("{}: reference {truth:?}, device {device:?}", path.display());
        assert!(truth.psnr >= 90.0 && truth.max <= 1e-12, "{truth:?}");
        assert!(device.psnr >= MIN_PSNR, "{device:?}");
        seen += 1;
    }
    assert!(seen >= 3, "only {seen} oracle files");
}

#[test]
fn trained_models() {
    let Some(folder) = tests_harness::data("splats") else { return };
    let gpu = tests_harness::shared_gpu();
    for name in ["inria_sh3_9k.ply", "fruit_drops_sh3_5k.ply"] {
        let loaded = engine::file::load(&folder.join(name)).unwrap();
        let g = &loaded.scene.gaussians;
        let n = g.len() as f64;
        let centre = g.mean.iter().fold(DVec3::ZERO, |s, m| s + DVec3::from(m.map(f64::from))) / n;
        let spread =
            (g.mean.iter().map(|m| (DVec3::from(m.map(f64::from)) - centre).length_squared()).sum::<f64>() / n).sqrt();
        let eye = centre + DVec3::new(0.6, -0.4, -2.2) * spread;
        let view = Camera::look_at(eye, centre, DVec3::NEG_Y, 0.9, [320, 240]);
        compare(&gpu, &loaded.scene, &view, 0.0, MotionSource::Auto).assert_within_bounds(name);
    }
}

#[test]
fn frames_side_by_side_are_those_drawn_alone() {
    let gpu = tests_harness::shared_gpu();
    let (left, right) = (camera(160, 120), Camera { position: DVec3::new(0.4, -1.0, -4.5), ..camera(160, 120) });
    let cases = [
        ("static", random_scene(3000, 5, 1), MotionSource::Auto),
        ("table", moving_scene(3000, 40, 6, 5, true), MotionSource::Table),
        ("network", moving_scene(300, 40, 6, 5, true), MotionSource::Network),
    ];
    for (name, scene, motion) in cases {
        let options = RenderOptions { depth: true, motion, ..RenderOptions::default() };
        let mut renderer = Renderer::new(&gpu, &scene, &options).unwrap();
        let alone = [(&left, 0.2), (&right, 0.9)].map(|(c, t)| renderer.render(c, t).unwrap());
        assert!(alone[0] != alone[1]);
        // Two pairs in flight, then four at once and a frame alone: whose buffers are whose.
        let first = renderer.submit_beside([(&left, 0.2), (&right, 0.9)]).unwrap();
        let second = renderer.submit_beside([(&right, 0.9), (&left, 0.2)]).unwrap();
        for (frames, expected) in [(first, [0, 1]), (second, [1, 0])] {
            for (frame, k) in frames.into_iter().zip(expected) {
                assert!(renderer.finish(frame).unwrap().is_some(), "{name}");
                assert!(renderer.read(frame).unwrap() == alone[k], "{name}: {frame:?} is not image {k}");
            }
        }
        let four = renderer.submit_beside([(&right, 0.9), (&left, 0.2), (&right, 0.9), (&left, 0.2)]).unwrap();
        for (frame, k) in four.into_iter().zip([1, 0, 1, 0]) {
            assert!(renderer.finish(frame).unwrap().is_some(), "{name}");
            assert!(renderer.read(frame).unwrap() == alone[k], "{name}: {frame:?} of four is not image {k}");
        }
        assert!(renderer.render(&right, 0.9).unwrap() == alone[1], "{name}: after those side by side");
    }
}

#[test]
fn frames_side_by_side_need_one_size_and_grow_as_a_frame_does() {
    let gpu = tests_harness::shared_gpu();
    let mut scene = random_scene(2000, 5, 1);
    scene.gaussians.log_scale.iter_mut().flatten().for_each(|s| *s += 1.5);
    let (small, large) = (camera(64, 64), camera(160, 160));
    let mut renderer = Renderer::new(&gpu, &scene, &RenderOptions::default()).unwrap();
    let error = renderer.submit_beside([(&small, 0.0), (&large, 0.0)]).unwrap_err().to_string();
    assert!(error.contains("size of an image"), "{error}");
    let error = renderer.submit_beside([(&small, 0.0); MOST_BESIDE + 1]).unwrap_err().to_string();
    assert!(error.contains("frames side by side: found 5, expected 1 to 4"), "{error}");
    let frames = renderer.submit_beside([(&large, 0.0); 2]).unwrap();
    assert!(frames.iter().all(|frame| renderer.finish(*frame).unwrap().is_none()), "there was room for all");
    let expected = renderer.render(&large, 0.0).unwrap();
    let [_, frame] = renderer.submit_beside([(&large, 0.0); 2]).unwrap();
    assert!(renderer.finish(frame).unwrap().is_some());
    assert!(renderer.read(frame).unwrap() == expected);
    assert!(renderer.finish(frames[0]).is_err(), "its buffers are gone");
}
