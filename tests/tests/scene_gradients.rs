//! Gradients of whole images, from blending to parameters, on the device against the f64 reference.

use engine::confidence::{Confidence, Contributions, Evidence, PRIOR_ERROR};
use engine::reference::gradient::image::{Gradients, image_gradients};
use engine::reference::gradient::splats::Upstream;
use engine::reference::{Blend64, DeformationAt, Gaussians64, ReferenceOptions, table_poses};
use engine::render::{RenderOptions, Renderer};
use engine::scene::synthetic::random_scene;
use engine::scene::{Camera, Scene};
use engine::train::gradient::{GradientOptions, SceneGradients, scene_gradients};
use glam::DVec3;
use tests_harness::gradient::assert_gradients_close;
use tests_harness::render_case::{Random, RenderInput, test_camera};
use tools::bench::hard_cases::poison::{POISON, camera, poison, slots};

const BACKGROUND: [f32; 3] = [0.3, 0.1, 0.6];
/// Between the keys at 0 and 1.
const TIME: f64 = 0.375;

fn random_gradient(camera: &Camera, seed: u64) -> Vec<f32> {
    let mut r = Random(seed);
    (0..4 * camera.width * camera.height).map(|_| r.range(-1.0, 1.0)).collect()
}

fn truth(scene: &Scene, camera: &Camera, gradient: &[f32]) -> Gradients {
    let gaussians = Gaussians64::from(&scene.gaussians);
    let poses = scene.deformation.table().map(|motion| table_poses(motion, TIME));
    let group = scene.deformation.superpoint_of_gaussian();
    let blend = Blend64::of(scene);
    let deformation =
        DeformationAt { group, poses: poses.as_deref(), blend: blend.as_ref(), offsets: None, time: TIME };
    let color: Vec<f64> = gradient.chunks_exact(4).flat_map(|g| [g[0], g[1], g[2]]).map(f64::from).collect();
    let alpha: Vec<f64> = gradient.chunks_exact(4).map(|g| g[3].into()).collect();
    let options = ReferenceOptions { background: BACKGROUND.map(f64::from), ..ReferenceOptions::default() };
    let upstream = Upstream { color: &color, alpha: Some(&alpha) };
    image_gradients(&gaussians, &deformation, camera, &options, &upstream).unwrap()
}

fn narrow<'a>(values: impl IntoIterator<Item = &'a f64>) -> Vec<f32> {
    values.into_iter().map(|&x| x as f32).collect()
}

fn assert_close(found: &SceneGradients, truth: &Gradients, context: &str) {
    let close = |what: &str, gpu: &[f32], truth: Vec<f32>| {
        assert_gradients_close(gpu, &truth, &format!("{context}: {what}"));
    };
    close("mean", found.mean.as_flattened(), narrow(truth.mean.as_flattened()));
    close("rotation", found.rotation.as_flattened(), narrow(truth.rotation.as_flattened()));
    close("log_scale", found.log_scale.as_flattened(), narrow(truth.log_scale.as_flattened()));
    close("opacity_logit", &found.opacity_logit, narrow(&truth.opacity_logit));
    close("sh", &found.sh, narrow(&truth.sh));
    close("mean2d", found.mean2d.as_flattened(), narrow(truth.mean2d.as_flattened()));
    if !found.pose.is_empty() {
        let row = |g: &engine::reference::gradient::project::OneGradient| {
            g.pose(0).omega.to_array().into_iter().chain(g.pose(0).translation.to_array())
        };
        let each: Vec<f64> = truth.each.iter().flat_map(row).collect();
        close("pose", found.pose.as_flattened(), narrow(&each));
    }
}

/// Of soft superpoints: poses by slot, and weights less what moving the canonical centre along would do to all of them.
fn assert_blend_close(found: &SceneGradients, truth: &Gradients, scene: &Scene, context: &str) {
    let slots = scene.deformation.blend().unwrap().neighbors;
    assert_eq!((found.pose.len(), found.blend.len()), (0, truth.each.len() * slots), "{context}");
    let row = |(i, slot): (usize, usize)| {
        let one = &truth.each[i];
        let mean = DVec3::from_array(scene.gaussians.mean[i].map(f64::from));
        let common: f64 = one.poses.iter().map(|pose| pose.translation.dot(mean)).sum();
        let pose = one.pose(slot);
        let weight = if one.poses.is_empty() { 0.0 } else { pose.weight - common };
        (pose.omega.to_array(), pose.translation.to_array(), weight)
    };
    let rows: Vec<_> = (0..found.blend.len()).map(|at| row((at / slots, at % slots))).collect();
    let part = |first: usize, count: usize| -> Vec<f32> {
        found.blend.iter().flat_map(|row| row[first..first + count].to_vec()).collect()
    };
    let omega: Vec<f64> = rows.iter().flat_map(|r| r.0).collect();
    let translation: Vec<f64> = rows.iter().flat_map(|r| r.1).collect();
    let weight: Vec<f64> = rows.iter().map(|r| r.2).collect();
    assert_gradients_close(&part(0, 3), &narrow(&omega), &format!("{context}: rotation of slots"));
    assert_gradients_close(&part(3, 3), &narrow(&translation), &format!("{context}: translation of slots"));
    assert_gradients_close(&part(6, 1), &narrow(&weight), &format!("{context}: weights"));
}

#[test]
fn gradients_of_soft_superpoints_agree_with_the_reference() {
    let gpu = tests_harness::shared_gpu();
    let options = GradientOptions { near: 0.2, background: BACKGROUND };
    for neighbors in 2..=4 {
        let scene = RenderInput::random(250, 1, 70).moving(6, 3).soft(neighbors, 4).scene();
        let camera = test_camera(41, 57);
        let gradient = random_gradient(&camera, 5);
        let found = scene_gradients(&gpu, &scene, &camera, TIME, &options, &gradient).unwrap();
        let (truth, context) = (truth(&scene, &camera, &gradient), format!("K = {neighbors}"));
        assert_close(&found, &truth, &context);
        assert_blend_close(&found, &truth, &scene, &context);
    }
}

#[test]
fn gradients_agree_with_the_reference() {
    let gpu = tests_harness::shared_gpu();
    let options = GradientOptions { near: 0.2, background: BACKGROUND };
    for degree in 0..4 {
        let still = RenderInput::random(250, degree, 60 + u64::from(degree));
        let moving = still.clone().moving(6, 3);
        for (what, input, size) in [("static", still, [64, 48]), ("moving", moving, [41, 57])] {
            let (scene, camera) = (input.scene(), test_camera(size[0], size[1]));
            let gradient = random_gradient(&camera, degree.into());
            let found = scene_gradients(&gpu, &scene, &camera, TIME, &options, &gradient).unwrap();
            let context = format!("{what}, degree {degree}");
            assert_close(&found, &truth(&scene, &camera, &gradient), &context);
            let again = scene_gradients(&gpu, &scene, &camera, TIME, &options, &gradient).unwrap();
            assert!(found == again, "{context}: other bits on the second run");
        }
    }
}

/// What Gaussians make up of an image is dL/dcolour: that of the f64 reference, where no colour is clamped.
#[test]
fn contributions_are_those_of_the_reference() {
    let gpu = tests_harness::shared_gpu();
    let options = RenderOptions { background: BACKGROUND, ..RenderOptions::default() };
    let still = RenderInput::random(250, 0, 60);
    let moving = still.clone().moving(6, 3);
    let mut large = RenderInput::random(40, 0, 5);
    large.log_scale.fill(0.0);
    let soft = moving.clone().soft(3, 4);
    for (what, input) in [("static", still), ("moving", moving), ("soft", soft), ("large splats", large)] {
        let (mut scene, camera) = (input.scene(), test_camera(97, 60));
        scene.gaussians.sh.iter_mut().for_each(|c| *c = c.abs());
        let gradient: Vec<f32> =
            random_gradient(&camera, 4).chunks_exact(4).flat_map(|g| [g[0], g[1], g[2], 0.0]).collect();
        let weight: Vec<[f32; 3]> = gradient.chunks_exact(4).map(|g| [g[0], g[1], g[2]]).collect();
        let mut of = Contributions::new(&gpu, &scene, &options).unwrap();
        let found = of.of_view(&camera, TIME, &weight).unwrap();
        let expected: Vec<f32> =
            truth(&scene, &camera, &gradient).sh.iter().map(|g| (g / 0.282_094_79) as f32).collect();
        assert_gradients_close(found.as_flattened(), &expected, what);
        assert_eq!(of.of_view(&camera, TIME, &weight).unwrap(), found, "{what}: other bits on the second run");
        let refused = of.of_view(&camera, TIME, &weight[1..]).unwrap_err();
        assert!(refused.to_string().contains("5820"), "{refused}");
    }
}

/// Where photos show something else the error is expected, in the amount that it has; what no photo shows is unknown.
#[test]
fn errors_are_expected_where_photos_differ() {
    let gpu = tests_harness::shared_gpu();
    let options = RenderOptions::default();
    let mut scene = random_scene(3, 5, 0);
    let g = &mut scene.gaussians;
    (g.mean[0], g.mean[1], g.mean[2]) = ([-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -40.0]);
    g.log_scale.fill([-1.2; 3]);
    g.opacity_logit.fill(5.0);
    g.sh.fill(0.0);
    let camera = Camera::look_at(DVec3::new(0.0, 0.0, -5.0), DVec3::ZERO, DVec3::NEG_Y, 0.9, [64, 48]);
    let rendered = Renderer::new(&gpu, &scene, &options).unwrap().render(&camera, 0.0).unwrap();
    // The photo is darker by 0.2 on one side.
    let mut photo = rendered.clone();
    for (i, pixel) in photo.rgba.chunks_exact_mut(4).enumerate() {
        let darker = if i % 64 < 32 { 0.2 } else { 0.0 };
        pixel[..3].iter_mut().for_each(|c| *c -= darker);
    }
    let mut evidence = Evidence::new(3);
    let mut of = Contributions::new(&gpu, &scene, &options).unwrap();
    evidence.add(&mut of, &camera, 0.0, [&rendered, &photo]).unwrap();
    let seen: f64 = rendered.rgba.chunks_exact(4).map(|p| f64::from(p[3])).sum();
    assert!((evidence.visibility.iter().sum::<f64>() - seen).abs() < 1e-3 * seen, "{evidence:?}, {seen}");
    assert_eq!((evidence.visibility[2], evidence.error[2]), (0.0, 0.0));
    let mut drawn = Confidence::new(&gpu, &scene, &options, &evidence).unwrap();
    let expected = drawn.render(&camera, 0.0).unwrap();
    let at = |x: usize| expected.error[24 * 64 + x];
    let side = if scene_side(&camera, -1.0) < 32.0 { [-1.0, 1.0] } else { [1.0, -1.0] };
    let [dark, same] = side.map(|x| at(scene_side(&camera, x) as usize));
    assert!((dark - 0.2).abs() < 0.03 && same < 0.02, "{dark} {same}");
    // From behind, the Gaussian that nobody saw.
    let behind = Camera::look_at(DVec3::new(0.0, 0.0, -35.0), DVec3::Z * -40.0, DVec3::NEG_Y, 0.9, [64, 48]);
    let unknown = drawn.render(&behind, 0.0).unwrap().error[24 * 64 + 32];
    assert!((f64::from(unknown) - PRIOR_ERROR).abs() < 0.02, "{unknown}");
    let other = Confidence::new(&gpu, &scene, &options, &Evidence::new(2)).unwrap_err();
    assert!(other.to_string().contains("2 Gaussians"), "{other}");
}

/// Column of a point on the x axis.
fn scene_side(camera: &Camera, x: f64) -> f64 {
    let p = camera.rotation * (DVec3::X * x - camera.position);
    camera.fx * p.x / p.z + camera.cx
}

#[test]
fn a_view_that_needs_more_room_gets_it() {
    let gpu = tests_harness::shared_gpu();
    let mut input = RenderInput::random(40, 0, 5);
    input.log_scale.fill(0.0);
    let (scene, camera) = (input.scene(), test_camera(256, 192));
    let gradient = random_gradient(&camera, 1);
    let options = GradientOptions { near: 0.2, background: BACKGROUND };
    let found = scene_gradients(&gpu, &scene, &camera, 0.0, &options, &gradient).unwrap();
    assert_close(&found, &truth(&scene, &camera, &gradient), "large splats");
}

#[test]
fn an_image_gradient_of_another_size_is_refused() {
    let gpu = tests_harness::shared_gpu();
    let scene = RenderInput::random(5, 0, 5).scene();
    let options = GradientOptions { near: 0.2, background: BACKGROUND };
    let refused = scene_gradients(&gpu, &scene, &test_camera(8, 8), 0.0, &options, &[0.0; 12]);
    assert!(refused.unwrap_err().to_string().contains("256 values"));
}

/// Everything that is not finite in the gradients.
fn not_finite(g: &SceneGradients) -> Option<&'static str> {
    let parts: [(&str, &[f32]); 8] = [
        ("mean", g.mean.as_flattened()),
        ("rotation", g.rotation.as_flattened()),
        ("log_scale", g.log_scale.as_flattened()),
        ("opacity_logit", &g.opacity_logit),
        ("sh", &g.sh),
        ("mean2d", g.mean2d.as_flattened()),
        ("pose", g.pose.as_flattened()),
        ("blend", g.blend.as_flattened()),
    ];
    parts.into_iter().find(|(_, values)| values.iter().any(|v| !v.is_finite())).map(|(name, _)| name)
}

/// The gradients of the Gaussians `kept`.
fn of(g: &SceneGradients, kept: &[usize], sh_row: usize) -> SceneGradients {
    SceneGradients {
        mean: kept.iter().map(|&i| g.mean[i]).collect(),
        rotation: kept.iter().map(|&i| g.rotation[i]).collect(),
        log_scale: kept.iter().map(|&i| g.log_scale[i]).collect(),
        opacity_logit: kept.iter().map(|&i| g.opacity_logit[i]).collect(),
        sh: kept.iter().flat_map(|&i| g.sh[i * sh_row..(i + 1) * sh_row].iter().copied()).collect(),
        optional: g.optional.selected(kept),
        mean2d: kept.iter().map(|&i| g.mean2d[i]).collect(),
        pose: Vec::new(),
        blend: Vec::new(),
    }
}

/// A thousand scenes with unusable and extreme numbers in random parameters: no gradient is ever NaN or infinite. In every
/// fourth all of them are NaN; the other Gaussians then get the gradients, bit for bit, that they get without the bad ones.
#[test]
fn a_thousand_poisoned_scenes_have_finite_gradients() {
    let gpu = tests_harness::shared_gpu();
    let options = GradientOptions { near: 0.2, background: BACKGROUND };
    let mut random = engine::scene::synthetic::Random::new(77);
    for round in 0..1000_u64 {
        let n = 1 + random.below(40);
        let mut scene = random_scene(n, 5000 + round, (round % 4) as u32);
        let camera = camera([24, 20]);
        let gradient = random_gradient(&camera, round);
        let only_nan = round % 4 == 0;
        let mut kept = Vec::new();
        for i in 0..n {
            if random.uniform() < 0.4 {
                let value = if only_nan { f32::NAN } else { POISON[random.below(POISON.len())] };
                let slot = random.below(slots(&scene.gaussians));
                poison(&mut scene.gaussians, i, slot, value);
            } else {
                kept.push(i);
            }
        }
        let found = scene_gradients(&gpu, &scene, &camera, 0.0, &options, &gradient).unwrap();
        assert_eq!(not_finite(&found), None, "round {round}");
        if only_nan && !kept.is_empty() {
            let rest = Scene { gaussians: scene.gaussians.selected(&kept), ..scene.clone() };
            let alone = scene_gradients(&gpu, &rest, &camera, 0.0, &options, &gradient).unwrap();
            let row = scene.gaussians.sh_coefficients() * 3;
            assert_eq!(of(&found, &kept, row), of(&alone, &(0..kept.len()).collect::<Vec<_>>(), row), "round {round}");
        }
    }
}
