//! The kernels of deformation fields against their twins, and fields in chunks.

use engine::render::FieldEvaluator;
use engine::render::field::field_nodes::{FIELD_NODES, FieldNodesBuffers, FieldNodesConstants, FieldNodesPush};
use engine::render::field::field_offset::{FIELD_OFFSET, FieldOffsetBuffers, FieldOffsetConstants, FieldOffsetPush};
use engine::render::field::field_planes::{FIELD_PLANES, FieldPlanesBuffers, FieldPlanesPush, pack_planes};
use engine::render::field::field_waves::{FIELD_WAVES, FieldWavesBuffers, FieldWavesConstants, FieldWavesPush};
use engine::render::frame::Frame;
use engine::scene::field::{ControlNodes, DeformationField, FIELD_TIME_NETWORK, FieldInput, FieldPlane, FieldPlanes};
use engine::scene::synthetic::random_gaussians;
use engine::scene::{Linear, Scene};
use tests_harness::KernelCase;
use tests_harness::render_case::{Random, RenderInput, test_camera};

const COUNTS: [usize; 5] = [1, 63, 64, 257, 600];

fn words(values: &[f32]) -> Vec<u32> {
    values.iter().map(|v| v.to_bits()).collect()
}

fn random(r: &mut Random, count: usize, bound: f32) -> Vec<f32> {
    (0..count).map(|_| r.range(-bound, bound)).collect()
}

fn input(count: usize) -> (RenderInput, Vec<u32>) {
    let input = RenderInput::random(count, 0, count as u64);
    let mut frame: Frame = input.frame(&test_camera(8, 8));
    frame.time = 0.42;
    (input, bytemuck::cast_slice(&[frame]).to_vec())
}

#[test]
fn waves_match_their_twin() {
    let gpu = tests_harness::shared_gpu();
    let mut r = Random(3);
    let [hidden, outputs] = FIELD_TIME_NETWORK;
    let network = random(&mut r, hidden * 14 + outputs * (hidden + 1), 0.2);
    for count in COUNTS {
        let (input, frame) = input(count);
        for time_network in [0, 1] {
            for (first_row, octaves) in [(0, 10), (count / 2, 3)] {
                let elements = 3 + 6 * octaves + FieldInput::time_width(time_network == 1);
                let (rows, columns) = (count - first_row, elements.next_multiple_of(4));
                let push = FieldWavesPush { first_row: first_row as u32, rows: rows as u32, points: count as u32 };
                let buffers = FieldWavesBuffers {
                    frame: frame.clone(),
                    point: words(&input.mean),
                    parameter: (time_network == 1).then(|| words(&network)),
                    encoding: vec![0; rows * columns],
                };
                let constants = FieldWavesConstants { time_network, octaves: octaves as u32 };
                let groups = rows.div_ceil(64) as u32;
                let case = KernelCase { kernel: &FIELD_WAVES, constants, push, buffers, groups };
                case.check(&gpu, &format!("N = {count} from {first_row}, network {time_network}"));
            }
        }
    }
}

fn some_planes(r: &mut Random, channels: usize) -> FieldPlanes {
    let mut plane = |width: usize, height: usize| FieldPlane {
        height,
        width,
        values: random(r, channels * width * height, 0.3).iter().map(|v| 1.0 + v).collect(),
    };
    // Sizes of 1 have no neighbour.
    let scales = vec![
        [plane(5, 7), plane(5, 4), plane(5, 3), plane(7, 4), plane(7, 3), plane(4, 3)],
        [plane(9, 1), plane(9, 6), plane(9, 2), plane(1, 6), plane(1, 2), plane(6, 2)],
    ];
    FieldPlanes { bounds: [[1.5, 1.4, 1.3], [-1.2, -1.6, -1.5]], channels, scales }
}

#[test]
fn planes_match_their_twin() {
    let gpu = tests_harness::shared_gpu();
    let mut r = Random(5);
    for channels in [1, 3, 16] {
        let planes = some_planes(&mut r, channels);
        let (values, sizes) = pack_planes(&planes);
        for count in COUNTS {
            let (input, frame) = input(count);
            let first_row = count / 3;
            let rows = count - first_row;
            let push = FieldPlanesPush {
                first_row: first_row as u32,
                rows: rows as u32,
                points: count as u32,
                ..FieldPlanesPush::of(&planes)
            };
            let items = rows * (channels * planes.scales.len()).next_multiple_of(4);
            let buffers = FieldPlanesBuffers {
                frame: frame.clone(),
                point: words(&input.mean),
                plane: words(&values),
                plane_size: sizes.clone(),
                encoding: vec![0; items],
            };
            let groups = items.div_ceil(256) as u32;
            let case = KernelCase { kernel: &FIELD_PLANES, constants: (), push, buffers, groups };
            case.check(&gpu, &format!("N = {count}, {channels} channels"));
        }
    }
}

#[test]
fn offsets_match_their_twin_under_every_rule() {
    let gpu = tests_harness::shared_gpu();
    let mut r = Random(7);
    for count in COUNTS {
        let (input, frame) = input(count);
        for (rule, outputs) in [(0, 10), (1, 13), (2, 10)] {
            let first_row = count / 4;
            let rows = count - first_row;
            let mut head = random(&mut r, rows * outputs, 0.4);
            // A screw without an axis.
            head[..3].fill(0.0);
            let push = FieldOffsetPush { first_row: first_row as u32, rows: rows as u32, outputs: outputs as u32 };
            let buffers = FieldOffsetBuffers {
                frame: frame.clone(),
                head_output: words(&head),
                mean: words(&input.mean),
                log_scale: words(&input.log_scale),
                rotation: words(&input.rotation),
                // What other chunks write stays.
                nonrigid_offset: vec![7_u32; 10 * count],
            };
            let (constants, groups) = (FieldOffsetConstants { rule }, rows.div_ceil(256) as u32);
            let case = KernelCase { kernel: &FIELD_OFFSET, constants, push, buffers, groups };
            case.check(&gpu, &format!("N = {count}, rule {rule}"));
        }
    }
}

#[test]
fn nodes_match_their_twin() {
    let gpu = tests_harness::shared_gpu();
    let mut r = Random(9);
    let (nodes, neighbors) = (11, 3);
    for count in COUNTS {
        let (input, frame) = input(count);
        for turn in [0, 1] {
            let outputs = 10 + 4 * turn as usize;
            let push = FieldNodesPush { nodes: nodes as u32, neighbors: neighbors as u32, outputs: outputs as u32 };
            let buffers = FieldNodesBuffers {
                frame: frame.clone(),
                head_output: words(&random(&mut r, nodes * outputs, 0.3)),
                mean: words(&input.mean),
                rotation: words(&input.rotation),
                node_position: words(&random(&mut r, 3 * nodes, 1.0)),
                node_neighbor: (0..count * neighbors).map(|e| (e * 7 % nodes) as u32).collect(),
                node_weight: words(&random(&mut r, count * neighbors, 0.5)),
                node_share: words(&random(&mut r, count, 1.0)),
                nonrigid_offset: vec![0; 10 * count],
            };
            let (constants, groups) = (FieldNodesConstants { turn }, count.div_ceil(256) as u32);
            let case = KernelCase { kernel: &FIELD_NODES, constants, push, buffers, groups };
            case.check(&gpu, &format!("N = {count}, turn {turn}"));
        }
    }
}

fn linear(r: &mut Random, inputs: usize, outputs: usize) -> Linear {
    let bound = 1.0 / (inputs as f32).sqrt();
    Linear { inputs, outputs, weight: random(r, inputs * outputs, bound), bias: random(r, outputs, bound) }
}

/// A field whose layer `skip` sees the input again, with layers so wide that a chunk holds 16,000 points.
fn field(skip: usize, wide: usize) -> DeformationField {
    let mut r = Random(skip as u64 + 1);
    let input = FieldInput::Waves { octaves: 10, time: None };
    let seen = input.width();
    let widths = [wide, 8, 8, 8];
    let inputs = |i: usize| match i {
        0 => seen,
        _ if i == skip => seen + widths[i - 1],
        _ => widths[i - 1],
    };
    let layers = (0..4).map(|i| linear(&mut r, inputs(i), widths[i])).collect();
    DeformationField { input, layers, head: linear(&mut r, if skip == 4 { seen + 8 } else { 8 }, 10), nodes: None }
}

#[test]
fn chunks_change_nothing() {
    if tests_harness::small() {
        println!("chunks are the host's: the device's own tests have them");
        return;
    }
    let gpu = tests_harness::shared_gpu();
    let g = random_gaussians(17_000, 5, 0);
    let scene = Scene { gaussians: g.clone(), deformation: field(2, 480).into(), ..Scene::default() };
    let all = FieldEvaluator::new(&gpu, &scene).unwrap().offsets(0.3).unwrap();
    // The same Gaussians few at a time, from both sides of the border between chunks.
    for first in [0, 16_040, 16_960] {
        let part = g.selected(&(first..first + 40).collect::<Vec<_>>());
        let part = Scene { gaussians: part, ..scene.clone() };
        let few = FieldEvaluator::new(&gpu, &part).unwrap().offsets(0.3).unwrap();
        for (i, offset) in few.iter().enumerate() {
            let other = all[first + i];
            let far = (0..3).map(|a| (offset.mean[a] - other.mean[a]).abs()).fold(0.0, f64::max);
            assert!(far < 1e-6 && offset.mean != [0.0; 3], "Gaussian {}: {offset:?} {other:?}", first + i);
        }
    }
}

#[test]
fn every_layer_can_see_the_input_again() {
    let gpu = tests_harness::shared_gpu();
    let g = random_gaussians(70, 5, 0);
    for skip in [1, 4, 2, 3, 9].into_iter().take(if tests_harness::small() { 2 } else { 5 }) {
        let field = field(skip, 24);
        assert_eq!(field.skip_layer(), (skip < 5).then_some(skip));
        let scene = Scene { gaussians: g.clone(), deformation: field.clone().into(), ..Scene::default() };
        let device = FieldEvaluator::new(&gpu, &scene).unwrap().offsets(0.7).unwrap();
        let truth = engine::reference::field_offsets(&field, &g, 0.7);
        for (a, b) in device.iter().zip(&truth) {
            let far = (0..4).map(|c| (a.rotation[c] - b.rotation[c]).abs()).fold(0.0, f64::max);
            assert!(far < 1e-4, "skip {skip}: {a:?} {b:?}");
        }
    }
}

#[test]
fn a_field_of_a_scene_without_gaussians_is_nothing() {
    let gpu = tests_harness::shared_gpu();
    let nodes = ControlNodes { position: vec![[0.0; 3]; 3], neighbors: 3, ..ControlNodes::default() };
    for nodes in [None, Some(nodes)] {
        let field = DeformationField { nodes, ..field(2, 16) };
        let gaussians = random_gaussians(0, 1, 0);
        let scene = Scene { gaussians, deformation: field.into(), ..Scene::default() };
        assert!(FieldEvaluator::new(&gpu, &scene).unwrap().offsets(0.5).unwrap().is_empty());
    }
}
