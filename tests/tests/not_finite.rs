//! Networks whose numbers overflow on the way: the pictures lack what they move, and say so; nothing is drawn at a place that a
//! dead neuron made up.

use engine::render::{FieldEvaluator, RenderOptions, Renderer};
use engine::scene::field::FieldInput;
use engine::scene::synthetic::{moving_scene, random_gaussians};
use engine::scene::{
    Camera, DeformNetwork, DeformSize, DeformationField, Linear, MotionSource, NonrigidNetwork, Scene,
};
use glam::DVec3;

/// Every weight stays finite, but neuron 0 of the second layer overflows, and the third layer multiplies it by 0.
fn overflow(layers: &mut [Linear]) {
    layers[0].bias[0] = 3e38;
    let inputs = layers[1].inputs;
    layers[1].weight.iter_mut().step_by(inputs).for_each(|w| *w = 0.0);
    layers[1].weight[0] = 10.0;
    let inputs = layers[2].inputs;
    layers[2].weight.iter_mut().step_by(inputs).for_each(|w| *w = 0.0);
}

fn camera() -> Camera {
    Camera::look_at(DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, -DVec3::Y, 0.8, [96, 64])
}

/// Gaussians that are drawn and that are refused, at time 0.4.
fn drawn(scene: &Scene, motion: MotionSource) -> [u32; 2] {
    let gpu = tests_harness::shared_gpu();
    let mut renderer = Renderer::new(&gpu, scene, &RenderOptions { motion, ..RenderOptions::default() }).unwrap();
    let (_, statistics) = renderer.draw(&camera(), 0.4).unwrap();
    [statistics.visible, statistics.rejected]
}

fn field() -> DeformationField {
    let mut seed = 7_u32;
    let mut layer = |inputs: usize, outputs: usize| {
        let mut next = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            ((seed >> 8) as f32 / (1 << 24) as f32 - 0.5) / (inputs as f32).sqrt()
        };
        let weight = (0..inputs * outputs).map(|_| next()).collect();
        Linear { inputs, outputs, weight, bias: (0..outputs).map(|_| next()).collect() }
    };
    let input = FieldInput::Waves { octaves: 10, time: None };
    let widths = [input.width(), 32, 32, 32, 32];
    let layers = widths.windows(2).map(|w| layer(w[0], w[1])).collect();
    DeformationField { input, layers, head: layer(32, 10), nodes: None }
}

#[test]
fn network_f() {
    let mut scene = moving_scene(300, 12, 5, 3, true);
    scene.deformation.superpoint_deformation_mut().unwrap().network =
        Some(DeformNetwork::init(4, DeformSize::PAPER, false));
    let [visible, refused] = drawn(&scene, MotionSource::Network);
    assert!(visible > 100 && refused == 0, "{visible} drawn, {refused} refused");
    overflow(&mut scene.deformation.network_mut().unwrap().linear);
    assert_eq!(drawn(&scene, MotionSource::Network), [0, 300]);
}

#[test]
fn network_g() {
    let mut scene = moving_scene(300, 12, 5, 3, false);
    scene.deformation = scene.deformation.with_nonrigid(NonrigidNetwork::init(4)).unwrap();
    let [visible, refused] = drawn(&scene, MotionSource::Table);
    assert!(visible > 100 && refused == 0, "{visible} drawn, {refused} refused");
    overflow(&mut scene.deformation.nonrigid_mut().unwrap().linear);
    assert_eq!(drawn(&scene, MotionSource::Table), [0, 300]);
}

#[test]
fn deformation_field() {
    let mut scene = Scene { gaussians: random_gaussians(300, 3, 1), deformation: field().into(), ..Scene::default() };
    let [visible, refused] = drawn(&scene, MotionSource::Auto);
    assert!(visible > 100 && refused == 0, "{visible} drawn, {refused} refused");
    overflow(&mut scene.deformation.field_mut().unwrap().layers);
    assert_eq!(drawn(&scene, MotionSource::Auto), [0, 300]);
    let gpu = tests_harness::shared_gpu();
    let offsets = FieldEvaluator::new(&gpu, &scene).unwrap().offsets(0.4).unwrap();
    assert!(offsets.iter().all(|o| o.mean.iter().chain(&o.rotation).chain(&o.scale).all(|v| v.is_nan())));
}
