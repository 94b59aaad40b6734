//! Metrics against the values of independent implementations, and the kernels of LPIPS against twins and f64.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::path::{Path, PathBuf};

use engine::file::{picture, tensors};
use engine::gpu::product::{Stage, product_groups};
use engine::metrics::lpips::{
    self, ConvPush, DifferencePush, LPIPS_CONV, LPIPS_DIFFERENCE, LPIPS_POOL, Lpips, Network, PoolPush, Range, Weights,
    WeightsFile,
};
use engine::metrics::{self, Planes};
use serde_json::Value;
use tests_harness::render_case::Random;
use tests_harness::{KernelCase, procedural_lpips};

fn planes(path: &Path) -> Planes {
    Planes::quantised(&picture::read(path).unwrap()).unwrap()
}

fn oracle() -> Option<(PathBuf, Value)> {
    let folder = tests_harness::data("oracle/metrics")?;
    let text = std::fs::read(folder.join("metrics.json")).unwrap();
    Some((folder, serde_json::from_slice(&text).unwrap()))
}

fn pair(folder: &Path, pair: &Value) -> [Planes; 2] {
    ["reference", "test"].map(|k| planes(&folder.join(pair[k].as_str().unwrap())))
}

fn check(pair: &Value, key: &str, ours: f64, bound: f64) {
    let truth = pair[key].as_f64().unwrap();
    println!("{} {key}: {ours} (theirs {truth}, {:+.1e})", pair["test"], ours - truth);
    assert!((ours - truth).abs() <= bound, "{key}: {ours}, expected {truth}");
}

#[test]
fn published_implementations_agree() {
    let Some((folder, oracle)) = oracle() else { return };
    let pairs = oracle["pairs"].as_array().unwrap();
    assert!(!pairs.is_empty());
    for p in pairs {
        let [reference, test] = pair(&folder, p);
        let begin = std::time::Instant::now();
        let (scores, _) = metrics::score(&reference, &test, None).unwrap();
        println!("{:?} for {} pixels", begin.elapsed(), reference.pixels());
        check(p, "psnr", scores.psnr, 1e-6);
        check(p, "ssim_zero_padded", scores.ssim, 1e-5);
        check(p, "ssim_valid", scores.ssim_valid.unwrap(), 1e-5);
        check(p, "ms_ssim", scores.ms_ssim.unwrap(), 1e-5);
        check(p, "flip_ldr", scores.flip, 1e-3);
    }
}

fn weights(network: Network, names: &[String]) -> Weights {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("weights.safetensors");
    procedural_lpips::write(&path, network, names);
    WeightsFile::read(&path).unwrap().get(network).unwrap().clone()
}

fn oracle_weights(oracle: &Value, network: Network) -> Weights {
    let names = oracle["lpips_tensors"][network.name()].as_array().unwrap();
    weights(network, &names.iter().map(|n| n.as_str().unwrap().to_owned()).collect::<Vec<_>>())
}

fn lpips_agrees(network: Network, of_pair: impl Fn(usize) -> bool) {
    let Some((folder, oracle)) = oracle() else { return };
    let gpu = tests_harness::gpu();
    let lpips = Lpips::new(&gpu, &oracle_weights(&oracle, network)).unwrap();
    let key = format!("lpips_{}", network.name());
    for (i, p) in oracle["pairs"].as_array().unwrap().iter().enumerate().filter(|(i, _)| of_pair(*i)) {
        let [reference, test] = pair(&folder, p);
        let begin = std::time::Instant::now();
        let ours = lpips.distance(&reference, &test, Range::default()).unwrap();
        println!("pair {i}, {:?}", begin.elapsed());
        check(p, &key, ours, 1e-3);
    }
}

#[test]
fn lpips_alex_agrees_with_the_package() {
    lpips_agrees(Network::Alex, |_| true);
}

#[test]
fn lpips_vgg_agrees_with_the_package_on_the_smallest_pair() {
    lpips_agrees(Network::Vgg, |i| i == 2);
}

#[test]
#[ignore = "minutes on software Vulkan: 0.2 and 0.7 Tflop"]
fn lpips_vgg_agrees_with_the_package_on_the_large_pairs() {
    lpips_agrees(Network::Vgg, |i| i != 2);
}

fn noise(size: [usize; 2], seed: u64) -> Planes {
    let mut r = Random(seed);
    let mut plane = || (0..size[0] * size[1]).map(|_| f64::from(r.range(0.0, 1.0))).collect();
    Planes { width: size[0], height: size[1], rgb: [plane(), plane(), plane()] }
}

#[test]
fn device_and_f64_agree_whatever_the_bands() {
    let gpu = tests_harness::gpu();
    for (network, size) in [(Network::Alex, [37, 33]), (Network::Vgg, [17, 21])] {
        let weights = weights(network, &procedural_lpips::names(network));
        let (a, b) = (noise(size, 1), noise(size, 2));
        for range in [Range::MinusOneToOne, Range::ZeroToOne] {
            let truth = lpips::lpips(&weights, &a, &b, range).unwrap();
            let mut device = Lpips::new(&gpu, &weights).unwrap();
            // Everything at once; a few rows at a time; two rows at a time.
            let all: Vec<f64> = [1 << 26, 64 * 4 * size[0] * 11, 1]
                .into_iter()
                .map(|bytes| {
                    device.set_band_bytes(bytes);
                    device.distance(&a, &b, range).unwrap()
                })
                .collect();
            println!("{network:?} {range:?}: {truth}, {all:?}");
            assert!(truth > 0.01 && all.iter().all(|d| (d - truth).abs() < 1e-5 * truth), "{truth}, {all:?}");
            assert_eq!(device.distance(&a, &a, range).unwrap(), 0.0);
        }
    }
    let tiny = noise([20, 20], 3);
    let alex = Lpips::new(&gpu, &weights(Network::Alex, &procedural_lpips::names(Network::Alex))).unwrap();
    assert!(alex.distance(&tiny, &tiny, Range::default()).is_err());
}

fn floats(r: &mut Random, count: u32, bound: f32) -> Vec<u32> {
    (0..count).map(|_| r.range(-bound, bound).to_bits()).collect()
}

#[test]
fn convolutions_match_their_twin() {
    let gpu = tests_harness::gpu();
    let mut r = Random(5);
    // inputs, outputs, window, stride, pad, width, height, first and end row of the output, first of its channels
    for [inputs, outputs, side, stride, pad, width, height, first, end, first_output] in [
        [3_u32, 64, 11, 4, 2, 40, 35, 0, 8, 0],
        [4, 33, 5, 1, 2, 9, 7, 0, 7, 0],
        [5, 64, 3, 1, 1, 37, 20, 6, 13, 32],
        [2, 16, 3, 1, 1, 1, 2, 0, 2, 3],
    ] {
        // The input holds just the rows that the windows reach.
        let in_first = (first * stride).saturating_sub(pad);
        let in_end = ((end - 1) * stride + side - pad).min(height);
        let push = ConvPush {
            inputs,
            outputs,
            in_width: width,
            in_height: height,
            in_first_row: in_first,
            in_rows: in_end - in_first,
            out_width: (width + 2 * pad - side) / stride + 1,
            out_first_row: first,
            out_rows: end - first,
            first_output,
            output_count: outputs - first_output,
        };
        let depth = inputs * side * side;
        let pixels = push.out_width * push.out_rows;
        for stage in [Stage::Shuffle, Stage::Shared] {
            let case = KernelCase {
                kernel: &LPIPS_CONV,
                spec: vec![stage as u32, side, stride, pad],
                push: bytemuck::bytes_of(&push).to_vec(),
                buffers: vec![
                    floats(&mut r, inputs * push.in_rows * width, 1.0),
                    floats(&mut r, outputs * (depth + 1), 1.0 / (depth as f32).sqrt()),
                    vec![0; (outputs * pixels) as usize],
                ],
                groups: product_groups(stage, gpu.subgroup_size_of(&LPIPS_CONV), push.output_count, pixels, 1) as u32,
            };
            case.run(&gpu).assert_equal(&LPIPS_CONV, &format!("{push:?}, window {side}, {stage:?}"));
        }
    }
}

#[test]
fn pools_and_differences_match_their_twins() {
    let gpu = tests_harness::gpu();
    let mut r = Random(6);
    for (kernel, width, rows) in [(2, 11, 6), (3, 11, 9)] {
        let (out_width, out_rows) = ((width - kernel) / 2 + 1, (rows - kernel) / 2 + 1);
        let push = PoolPush {
            channels: 7,
            in_width: width,
            in_rows: rows,
            out_width,
            out_height: out_rows + 5,
            out_first_row: 2,
            out_rows,
        };
        let case = KernelCase {
            kernel: &LPIPS_POOL,
            spec: vec![kernel],
            push: bytemuck::bytes_of(&push).to_vec(),
            buffers: vec![
                (0..7 * width * rows).map(|_| r.range(0.0, 2.0).to_bits()).collect(),
                vec![0; (7 * out_width * push.out_height) as usize],
            ],
            groups: (7 * out_width * out_rows).div_ceil(256),
        };
        case.run(&gpu).assert_equal(&LPIPS_POOL, &format!("{push:?}"));
    }
    let push = DifferencePush { channels: 19, pixels: 300 };
    let mut features = || -> Vec<u32> {
        // The first pixel has no feature at all.
        (0..19 * 300).map(|i| if i % 300 == 0 { 0 } else { r.range(0.0, 2.0).to_bits() }).collect()
    };
    let buffers = vec![features(), features(), floats(&mut Random(7), 19, 1.0), vec![0; 300]];
    let case = KernelCase {
        kernel: &LPIPS_DIFFERENCE,
        spec: vec![],
        push: bytemuck::bytes_of(&push).to_vec(),
        buffers,
        groups: 2,
    };
    let result = case.run(&gpu);
    result.assert_equal(&LPIPS_DIFFERENCE, "300 pixels");
    assert_eq!(result.gpu[3][0], 0.0_f32.to_bits());
}

#[test]
fn bad_weights_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("w.safetensors");
    let write = |list: Vec<(&str, Vec<usize>, Vec<f32>)>| {
        let tensors = list.iter().map(|(n, s, v)| tensors::floats(*n, s.clone(), v)).collect();
        tensors::write(&path, ["test", "1"], tensors, &Default::default()).unwrap();
        WeightsFile::read(&path).unwrap_err().to_string()
    };
    assert!(write(vec![("x", vec![1], vec![1.0])]).contains("net.slice1.0.weight"));
    assert!(write(vec![("net.slice1.0.weight", vec![1, 2], vec![1.0; 2])]).contains("[1, 2]"));
    let first = ("net.slice1.0.weight", vec![64, 3, 11, 11], vec![1.0; 64 * 363]);
    assert!(write(vec![first.clone()]).contains("net.slice1.0.bias"));
    let bias = ("net.slice1.0.bias", vec![64], vec![f32::NAN; 64]);
    let message = write(vec![first, bias]);
    assert!(message.contains("net.slice1.0.bias") && message.contains("NaN"), "{message}");
    std::fs::write(&path, b"no tensors").unwrap();
    assert_eq!(WeightsFile::read(&path).unwrap_err().exit_code(), 3);
}
