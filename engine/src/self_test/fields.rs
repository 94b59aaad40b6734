//! Deformation fields: encoded centres that move control nodes, and planes of features.

use super::frame::{BACKGROUND, SEED, scene, watched_frames};
use crate::error::Result;
use crate::gpu::Gpu;
use crate::render::RenderOptions;
use crate::scene::field::{
    ControlNodes, DeformationField, FIELD_TIME_NETWORK, FIELD_TIME_OCTAVES, FieldInput, FieldPlane, FieldPlanes,
};
use crate::scene::synthetic::Random;
use crate::scene::{Linear, Scene};

/// Width of the hidden layers.
const WIDTH: usize = 24;
const NODES: usize = 7;
const NEIGHBORS: usize = 3;
const CHANNELS: usize = 4;
/// Values along x, y, z and t.
const PLANE_SIZE: [usize; 4] = [5, 7, 4, 3];

/// Frames of each kind of field, each dispatch against its twin.
pub(super) fn test(gpu: &Gpu) -> Result<()> {
    let mut random = Random::new(SEED);
    let scene = scene();
    let gaussians = scene.gaussians.len();
    for field in [of_nodes(&mut random, gaussians), of_planes(&mut random)] {
        let options = RenderOptions { background: BACKGROUND, ..RenderOptions::default() };
        watched_frames(gpu, &Scene { deformation: field.into(), ..scene.clone() }, &options)?;
    }
    Ok(())
}

fn values(random: &mut Random, count: usize, bound: f64) -> Vec<f32> {
    (0..count).map(|_| random.range(-bound, bound) as f32).collect()
}

fn linear(random: &mut Random, inputs: usize, outputs: usize) -> Linear {
    let bound = 1.0 / (inputs as f64).sqrt();
    let weight = values(random, inputs * outputs, bound);
    Linear { inputs, outputs, weight, bias: values(random, outputs, bound) }
}

/// Encoded centres and time, and nodes that turn what is around them (SC-GS).
fn of_nodes(random: &mut Random, gaussians: usize) -> DeformationField {
    let [hidden, outputs] = FIELD_TIME_NETWORK;
    let time = [linear(random, 1 + 2 * FIELD_TIME_OCTAVES[1], hidden), linear(random, hidden, outputs)];
    let input = FieldInput::Waves { octaves: 10, time: Some(time) };
    let layers = vec![linear(random, input.width(), WIDTH), linear(random, WIDTH, WIDTH)];
    let nodes = ControlNodes {
        position: (0..NODES).map(|_| random.normal3().as_vec3().to_array()).collect(),
        neighbors: NEIGHBORS,
        neighbor: (0..gaussians * NEIGHBORS).map(|_| random.below(NODES) as u32).collect(),
        weight: vec![1.0 / NEIGHBORS as f32; gaussians * NEIGHBORS],
        share: vec![0.75; gaussians],
    };
    DeformationField { input, layers, head: linear(random, WIDTH, 14), nodes: Some(nodes) }
}

/// Planes at one resolution (4D-GS).
fn of_planes(random: &mut Random) -> DeformationField {
    let [x, y, z, t] = PLANE_SIZE;
    let plane = |random: &mut Random, width: usize, height: usize| {
        let values = values(random, CHANNELS * width * height, 0.3).iter().map(|v| 1.0 + v).collect();
        FieldPlane { height, width, values }
    };
    let scale = [[x, y], [x, z], [x, t], [y, z], [y, t], [z, t]].map(|[w, h]| plane(random, w, h));
    let bounds = [[1.5, 1.4, 1.3], [-1.2, -1.6, -1.5]];
    let input = FieldInput::Planes(FieldPlanes { bounds, channels: CHANNELS, scales: vec![scale] });
    let layers = vec![linear(random, input.width(), WIDTH)];
    DeformationField { input, layers, head: linear(random, WIDTH, 10), nodes: None }
}
