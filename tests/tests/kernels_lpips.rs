//! The kernels of LPIPS against their twins, and the whole distance against f64.
#![allow(clippy::unwrap_used, reason = "tests")]

use engine::gpu::product::{Stage, product_groups};
use engine::metrics::Planes;
use engine::metrics::lpips::lpips_conv::{LPIPS_CONV, LpipsConvBuffers, LpipsConvConstants, LpipsConvPush};
use engine::metrics::lpips::lpips_difference::{LPIPS_DIFFERENCE, LpipsDifferenceBuffers, LpipsDifferencePush};
use engine::metrics::lpips::lpips_pool::{LPIPS_POOL, LpipsPoolBuffers, LpipsPoolConstants, LpipsPoolPush};
use engine::metrics::lpips::{self, Lpips, Network, Range};
use tests_harness::render_case::Random;
use tests_harness::{KernelCase, procedural_lpips};

fn noise(size: [usize; 2], seed: u64) -> Planes {
    let mut r = Random(seed);
    let mut plane = || (0..size[0] * size[1]).map(|_| f64::from(r.range(0.0, 1.0))).collect();
    Planes { width: size[0], height: size[1], rgb: [plane(), plane(), plane()] }
}

#[test]
fn device_and_f64_agree_whatever_the_bands() {
    let gpu = tests_harness::shared_gpu();
    let cases: &[_] = if tests_harness::small() {
        &[(Network::Alex, [37, 33])]
    } else {
        &[(Network::Alex, [37, 33]), (Network::Vgg, [17, 21])]
    };
    for &(network, size) in cases {
        let weights = procedural_lpips::weights(network, &procedural_lpips::names(network));
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
    let alex =
        Lpips::new(&gpu, &procedural_lpips::weights(Network::Alex, &procedural_lpips::names(Network::Alex))).unwrap();
    assert!(alex.distance(&tiny, &tiny, Range::default()).is_err());
}

fn floats(r: &mut Random, count: u32, bound: f32) -> Vec<u32> {
    (0..count).map(|_| r.range(-bound, bound).to_bits()).collect()
}

#[test]
fn convolutions_match_their_twin() {
    let gpu = tests_harness::shared_gpu();
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
        let push = LpipsConvPush {
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
            // Each window is a pipeline, which takes seconds to compile.
            if tests_harness::small() && stage == Stage::Shared && side != 3 {
                continue;
            }
            let buffers = LpipsConvBuffers {
                feature_input: floats(&mut r, inputs * push.in_rows * width, 1.0),
                parameter: floats(&mut r, outputs * (depth + 1), 1.0 / (depth as f32).sqrt()),
                feature_output: vec![0; (outputs * pixels) as usize],
            };
            let lanes = gpu.subgroup_size_of(&LPIPS_CONV);
            let threads = stage.threads(lanes);
            let constants = LpipsConvConstants { stage: stage as u32, kernel: side, stride, pad, threads };
            let groups = product_groups(stage, lanes, push.output_count, pixels, 1) as u32;
            let case = KernelCase { kernel: &LPIPS_CONV, constants, push, buffers, groups };
            case.check(&gpu, &format!("{push:?}, window {side}, {stage:?}"));
        }
    }
}

#[test]
fn pools_and_differences_match_their_twins() {
    let gpu = tests_harness::shared_gpu();
    let mut r = Random(6);
    for (kernel, width, rows) in [(2, 11, 6), (3, 11, 9)] {
        let (out_width, out_rows) = ((width - kernel) / 2 + 1, (rows - kernel) / 2 + 1);
        let push = LpipsPoolPush {
            channels: 7,
            in_width: width,
            in_rows: rows,
            out_width,
            out_height: out_rows + 5,
            out_first_row: 2,
            out_rows,
        };
        let buffers = LpipsPoolBuffers {
            feature_input: (0..7 * width * rows).map(|_| r.range(0.0, 2.0).to_bits()).collect(),
            feature_output: vec![0; (7 * out_width * push.out_height) as usize],
        };
        let groups = (7 * out_width * out_rows).div_ceil(256);
        let constants = LpipsPoolConstants { kernel };
        KernelCase { kernel: &LPIPS_POOL, constants, push, buffers, groups }.check(&gpu, &format!("{push:?}"));
    }
    let push = LpipsDifferencePush { channels: 19, pixels: 300 };
    let mut features = || -> Vec<u32> {
        // The first pixel has no feature at all.
        (0..19 * 300).map(|i| if i % 300 == 0 { 0 } else { r.range(0.0, 2.0).to_bits() }).collect()
    };
    let buffers = LpipsDifferenceBuffers {
        first: features(),
        second: features(),
        head: floats(&mut Random(7), 19, 1.0),
        distance_of_pixel: vec![0; 300],
    };
    let case = KernelCase { kernel: &LPIPS_DIFFERENCE, constants: (), push, buffers, groups: 2 };
    let distance = case.check(&gpu, "300 pixels").distance_of_pixel;
    assert_eq!(distance[0], 0.0_f32.to_bits());
}
