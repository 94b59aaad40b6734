#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
use super::*;
use crate::gpu::GpuOptions;
use crate::scene::synthetic::Random;
use crate::train::status;
use crate::train::step::Step;

#[test]
fn layers_and_network_are_inverse() {
    for (size, weights) in [(DeformSize::PAPER, 501_254), (DeformSize { layers: 3, width: 64 }, 18_502)] {
        let made = DeformNetwork::init(3, size, false);
        assert_eq!(network(&layers(&made).unwrap(), size), made);
        let flat = made.flatten();
        assert_eq!(flat.len(), weights);
        assert_eq!(DeformNetwork::from_flat(&flat, size).unwrap(), made);
        assert!(DeformNetwork::from_flat(&flat[1..], size).is_err());
    }
    let mut wrong = DeformNetwork::init(3, DeformSize::PAPER, false);
    wrong.linear[5].inputs = 256;
    assert!(layers(&wrong).unwrap_err().to_string().contains("deform.linear.5"));
}

/// ‖a − b‖ / ‖b‖.
fn relative_l2(a: &[f32], b: &[f32]) -> f64 {
    let wide = |v: &f32| f64::from(*v);
    let distance: f64 = a.iter().zip(b).map(|(a, b)| (wide(a) - wide(b)).powi(2)).sum();
    (distance / b.iter().map(|b| wide(b).powi(2)).sum::<f64>()).sqrt()
}

/// Poses by the weights and by another mean of them, gradients of the weights, and of the rows before each ReLU.
fn pass(gpu: &Gpu, network: &NetworkF, mean: &DeformNetwork, rows: u32) -> [Vec<f32>; 4] {
    network.upload_mean(mean).unwrap();
    let mut random = Random::new(5);
    let mut given = |name: &str, count: u32| {
        let words: Vec<f32> = (0..count).map(|_| random.range(-1.0, 1.0) as f32).collect();
        Slice::from(gpu.buffer_with(name, bytemuck::cast_slice(&words)).unwrap())
    };
    let (position, planes) = (given("superpoint_position", 3 * rows), given("superpoint_gradient", 6 * rows));
    let buffer = |name: &str, words: &[u32]| gpu.buffer_with(name, bytemuck::cast_slice(words)).unwrap();
    let step = Step { time: 0.3, exact_time: 0.3, ..Step::with_usual_adam() };
    let step = Slice::from(gpu.buffer_with("step", bytemuck::bytes_of(&step)).unwrap());
    let [pose, mean_pose] =
        ["pose", "mean_pose"].map(|name| gpu.buffer(name, 32 * u64::from(rows), Memory::Device).unwrap());
    let (counters, status) = (buffer("counters", &[0; 8]), buffer("status", &status::clear()));
    let mut r = gpu.recorder("network F");
    network.record_mean(&mut r, rows, &step, &position, &Slice::from(&mean_pose)).unwrap();
    network.record_forward(&mut r, rows, &step, &position, &Slice::from(&pose)).unwrap();
    let from = Backward {
        step: &step,
        counters: &Slice::from(&counters),
        status: &Slice::from(&status),
        superpoint_gradient: &planes,
        plane_stride: rows,
    };
    network.record_backward(&mut r, rows, Output::Gradient, &from).unwrap();
    gpu.run(r).unwrap();
    let floats = |slice: Slice| bytemuck::pod_collect_to_vec(&gpu.download(slice).unwrap());
    let gradients = (0..network.size.layers).flat_map(|i| floats(network.activation_gradient(i, rows))).collect();
    let weights = network.download_gradient().unwrap().flatten();
    [floats(Slice::from(&pose)), floats(Slice::from(&mean_pose)), weights, gradients]
}

#[test]
fn all_layers_at_once_agree_with_layer_by_layer() {
    let gpu = Gpu::open(&GpuOptions { pipeline_cache: false, ..GpuOptions::default() }).unwrap();
    for (size, rows) in [(DeformSize::PAPER, 70), (DeformSize { layers: 2, width: 64 }, 5)] {
        let [weights, mean] = [3, 4].map(|seed| DeformNetwork::init(seed, size, false));
        let [chain, fused, again] = [Stage::Shuffle, Stage::Shared, Stage::Shared].map(|stage| {
            let network = NetworkF::new(&gpu, &weights, rows).unwrap().with_mean(10).unwrap();
            pass(&gpu, &network.with_stage(stage), &mean, rows)
        });
        let errors: Vec<f64> = fused.iter().zip(&chain).map(|(fused, chain)| relative_l2(fused, chain)).collect();
        assert!(errors.iter().all(|e| *e <= 1e-5), "{size:?}, {rows} superpoints: {errors:?}");
        let bits = |all: &[Vec<f32>; 4]| all.iter().flatten().map(|v| v.to_bits()).collect::<Vec<u32>>();
        assert!(bits(&fused) == bits(&again), "not the same bits every time");
        assert!(relative_l2(&fused[0], &fused[1]) > 0.1, "the mean is not the weights");
    }
}
