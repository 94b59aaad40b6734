//! Every kernel against its twin; poison; determinism.

use super::case::*;
use engine::gpu::Slice;
use engine::train::adam;
use engine::train::association::association_init::{ASSOCIATION_INIT, AssociationInitBuffers, AssociationInitPush};
use engine::train::association::{NEW_LOGIT, NO_SUPERPOINT};
use engine::train::farthest_point::*;
use engine::train::property_loss::PropertyLoss;
use engine::train::property_loss::property_total::{PROPERTY_TOTAL, PropertyTotalBuffers};
use engine::train::step::bias_corrections;
use tests_harness::{KernelCase, shared_gpu};

#[test]
fn every_kernel_agrees_with_its_twin() {
    let gpu = shared_gpu();
    // Each shape is another set of pipelines, which is what this costs.
    let shapes = [(700, 40, 5, 8), (257, 3, 3, 16), (64, 1, 1, 1), (1, 1, 1, 4), (300, 300, 7, 7)];
    for (n, m, k, slots) in shapes.into_iter().take(if tests_harness::small() { 1 } else { 5 }) {
        for form in [PropertyLoss::Code, PropertyLoss::Paper] {
            let case = Case::new(n, m, k, slots, n as u64);
            let after = case.chain(&gpu, form, 0);
            assert_ne!(after, case.rows(5)[1], "logits did not move");
        }
    }
}

#[test]
fn soft_superpoints_agree_with_their_twins() {
    let gpu = shared_gpu();
    let shapes = [(700, 40, 4, 8), (257, 3, 3, 16), (64, 40, 2, 2), (1, 2, 2, 4)];
    for (n, m, k, slots) in shapes.into_iter().take(if tests_harness::small() { 2 } else { 4 }) {
        let case = Case::new(n, m, k, slots, n as u64);
        assert_ne!(case.soft_chain(&gpu, 0), case.rows(5)[1], "logits did not move");
    }
}

#[test]
fn a_failed_forward_pass_changes_nothing() {
    let case = Case::new(300, 20, 5, 8, 3);
    for form in [PropertyLoss::Code, PropertyLoss::Paper] {
        assert_eq!(case.chain(&shared_gpu(), form, 1), case.rows(5)[1]);
    }
}

#[test]
fn equal_distances_go_to_the_lowest_index() {
    let gpu = shared_gpu();
    let mut case = Case::new(200, 24, 5, 8, 11);
    // Superpoints in groups of four at the same place; Gaussians on a lattice, many at equal distance.
    case.position = (0..24).map(|j| [(j / 4) as f32, 0.0, 0.0]).collect();
    case.mean = (0..200).map(|i| [(i % 11) as f32 * 0.5, (i / 11) as f32, 0.0]).collect();
    case.chain(&gpu, PropertyLoss::Code, 0);
}

#[test]
fn poison_never_reaches_a_parameter() {
    let gpu = shared_gpu();
    let poison = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e38, -1e38, 1e-42, 0.0];
    for (round, bad) in poison.into_iter().take(if tests_harness::small() { 3 } else { 7 }).enumerate() {
        let mut case = Case::new(300, 20, 5, 8, round as u64);
        case.mean[17][round % 3] = bad;
        case.mean[280] = [bad; 3];
        case.pose[3][round % 2][1] = bad;
        case.position[7][2] = bad;
        for form in [PropertyLoss::Code, PropertyLoss::Paper] {
            let state = DeviceStep::new(&gpu, &case, form);
            for _ in 0..3 {
                state.run(&gpu);
            }
            for (name, slice) in [
                ("logit", Slice::from(&state.state.rows().logit)),
                ("moment 1", Slice::from(&state.state.rows().moment_1)),
                ("moment 2", Slice::from(&state.state.rows().moment_2)),
                ("gradient", Slice::from(&state.state.gradient)),
            ] {
                let bytes = slice.bytes.min(if name == "gradient" { 4 * 6 * 20 } else { u64::MAX });
                let values: Vec<f32> =
                    bytemuck::pod_collect_to_vec(&gpu.download(slice.buffer.slice(0, bytes)).unwrap());
                assert!(values.iter().all(|v| v.is_finite()), "{name} with {bad} in {form:?}");
            }
            let position: Vec<f32> = bytemuck::pod_collect_to_vec(&gpu.download(&state.state.position).unwrap());
            let rotten = position[..60].iter().enumerate().find(|(i, v)| !v.is_finite() && *i != 23);
            assert_eq!(rotten, None, "centres with {bad} in {form:?}");
        }
    }
}

#[test]
fn one_round_agrees_with_its_twin_even_on_poison() {
    let gpu = shared_gpu();
    for n in [1_usize, 300, 2500] {
        let mut rng = Rng(n as u64);
        let mut mean: Vec<[f32; 3]> = (0..n).map(|_| rng.vector()).collect();
        mean[n / 2][1] = f32::NAN;
        mean[n / 3] = [1e38, -1e38, f32::INFINITY];
        let groups = n.div_ceil(1024);
        let candidates: Vec<u32> = (0..5).flat_map(|_| [rng.signed().abs().to_bits(), rng.next() % n as u32]).collect();
        let push = FarthestPointPush { points: n as u32, round: 2, candidates: 5 };
        let buffers = FarthestPointBuffers {
            mean: bits(planes(&mean)),
            candidates_in: candidates,
            distance_to: bits((0..n).map(|i| [f32::MAX, 0.3, -1.0][i % 3])),
            candidates_out: vec![0; 2 * groups],
            chosen: vec![0; 3],
            superpoint_position: vec![0; 9],
        };
        let case = KernelCase { kernel: &FARTHEST_POINT, constants: (), push, buffers, groups: groups as u32 };
        case.check(&gpu, &format!("{n} points"));
    }
}

#[test]
fn totals_of_the_losses_agree_with_their_twin() {
    let gpu = shared_gpu();
    for n in [1_usize, 256, 257, 70_000] {
        let mut rng = Rng(n as u64);
        let case = Case::new(n, 3, 3, 4, 1);
        let partial = bits((0..4 * n.div_ceil(256)).map(|_| rng.signed().abs()));
        let buffers =
            PropertyTotalBuffers { step: case.step_words(), loss_partial: partial, property_loss: vec![0; 4] };
        let case = KernelCase { kernel: &PROPERTY_TOTAL, constants: (), push: (), buffers, groups: 1 };
        case.check(&gpu, &format!("{n} Gaussians"));
    }
}

#[test]
fn first_assignments_agree_with_their_twin() {
    let gpu = shared_gpu();
    for (n, m, k, slots) in [(700_usize, 40_u32, 5_u32, 8_u32), (257, 3, 3, 16), (1, 1, 1, 1)] {
        for (logit, paper) in [(1.0, 0), (0.9, 1)] {
            let case = Case::new(n, m as usize, k, slots, 9);
            let mut rng = Rng(n as u64);
            let row = |first: u32| (0..slots).map(move |s| if s < k { (first + s) % m } else { NO_SUPERPOINT });
            let neighbor: Vec<u32> = (0..n).flat_map(|_| row(rng.next() % m)).collect();
            let buffers = AssociationInitBuffers {
                step: case.step_words(),
                neighbor: neighbor.clone(),
                chosen: (0..m).map(|_| rng.next() % n as u32).collect(),
                logit: vec![NEW_LOGIT.to_bits(); n * slots as usize],
                superpoint_of_gaussian: vec![0; n],
            };
            let push = AssociationInitPush { logit, paper };
            // One workgroup too many, as a folded grid has.
            let groups = case.groups() + 1;
            let case = KernelCase { kernel: &ASSOCIATION_INIT, constants: case.constants(), push, buffers, groups };
            let done = case.check(&gpu, &format!("{n} Gaussians, paper {paper}"));
            let first: Vec<u32> = neighbor.iter().step_by(slots as usize).copied().collect();
            assert_eq!(done.superpoint_of_gaussian, first);
            let set = done.logit.iter().filter(|l| **l == logit.to_bits()).count();
            assert!(if paper == 0 { set == n } else { (1..=m as usize).contains(&set) }, "{set} logits set");
        }
    }
}

#[test]
fn the_step_is_bit_identical_each_time() {
    let gpu = shared_gpu();
    for form in [PropertyLoss::Code, PropertyLoss::Paper] {
        let results: Vec<_> = (0..2)
            .map(|_| {
                let case = Case::new(3000, 40, 5, 8, 2);
                let device = DeviceStep::new(&gpu, &case, form);
                (0..3).for_each(|_| device.run(&gpu));
                let rows = device.state.rows();
                [&rows.logit, &rows.moment_1, &rows.moment_2]
                    .map(|b| download(&gpu, b, 3000 * 8))
                    .into_iter()
                    .chain([download(&gpu, &device.state.position, 120), download(&gpu, &device.state.gradient, 240)])
                    .collect::<Vec<_>>()
            })
            .collect();
        assert_eq!(results[0], results[1]);
    }
}

#[test]
fn adam_of_the_twin_is_the_one_of_the_test() {
    let step = Case::new(1, 1, 1, 1, 1).step;
    let mut moments = [0.0; 2];
    let bias = bias_corrections(0.9, 0.999, 1);
    let value = adam::update(&step, 0.5, 1e-3, &mut moments, 1e-2, bias);
    assert!((value - 0.49).abs() < 1e-6, "{value}");
}
