//! Scenes with each kind of deformation field.

use engine::scene::field::{
    ControlNodes, DeformationField, FIELD_TIME_NETWORK, FIELD_TIME_OCTAVES, FieldInput, FieldPlane, FieldPlanes,
};
use engine::scene::synthetic::random_scene;
use engine::scene::{Linear, Scene};

fn linear(inputs: usize, outputs: usize) -> Linear {
    Linear { inputs, outputs, weight: vec![0.0; inputs * outputs], bias: vec![0.0; outputs] }
}

fn waves(octaves: usize, with_network: bool) -> FieldInput {
    let [hidden, outputs] = FIELD_TIME_NETWORK;
    let network = [linear(1 + 2 * FIELD_TIME_OCTAVES[1], hidden), linear(hidden, outputs)];
    FieldInput::Waves { octaves, time: with_network.then_some(network) }
}

fn planes() -> FieldInput {
    let plane = || FieldPlane { height: 2, width: 2, values: vec![1.0; 4 * 4] };
    FieldInput::Planes(FieldPlanes {
        bounds: [[2.0; 3], [-2.0; 3]],
        channels: 4,
        scales: vec![std::array::from_fn(|_| plane())],
    })
}

fn nodes(gaussians: usize) -> ControlNodes {
    ControlNodes {
        position: vec![[0.0; 3], [1.0; 3]],
        neighbors: 2,
        neighbor: vec![1; 2 * gaussians],
        weight: vec![0.5; 2 * gaussians],
        share: vec![1.0; gaussians],
    }
}

/// A field of two layers, the second of which sees the input again.
fn field(input: FieldInput, outputs: usize, nodes: Option<ControlNodes>) -> DeformationField {
    let (width, hidden) = (input.width(), 32);
    let layers = vec![linear(width, hidden), linear(width + hidden, hidden)];
    DeformationField { input, layers, head: linear(hidden, outputs), nodes }
}

/// One scene per kind: encodings with and without a network of time and of fewer octaves, screws, planes, control nodes that
/// move and that turn.
pub(super) fn scenes(gaussians: usize) -> Vec<Scene> {
    let all = [
        field(waves(10, true), 10, None),
        field(waves(10, false), 10, None),
        field(waves(6, true), 10, None),
        field(waves(10, true), 13, None),
        field(planes(), 10, None),
        field(waves(10, true), 10, Some(nodes(gaussians))),
        field(waves(10, true), 14, Some(nodes(gaussians))),
    ];
    let scene = |field: DeformationField| Scene { deformation: field.into(), ..random_scene(gaussians, 1, 3) };
    all.into_iter().map(scene).collect()
}
