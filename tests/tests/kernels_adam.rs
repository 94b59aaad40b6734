//! Adam on flat arrays and the check for numbers that are not finite, on the device.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use engine::Error;
use engine::gpu::Gpu;
use engine::scene::synthetic::Random;
use engine::train::adam::{ADAM, AdamBuffers, AdamGroup, AdamPush};
use engine::train::check_finite::{CHECK_FINITE, CheckFiniteBuffers, CheckFinitePush, check_finite};
use engine::train::status;
use engine::train::step::{Step, bias_corrections};
use tests_harness::KernelCase;

fn step(t: u64) -> Step {
    let pair = |t| bias_corrections(0.9, 0.999, t);
    let [g, f, a, n] = [pair(t + 30), pair(t), pair(t + 10), pair(t + 20)];
    Step {
        rate_1: [0.1, 0.2, 1e-3, 5e-3],
        rate_2: [8e-4, 0.0, 0.0, 0.0],
        adam: [0.9, 0.999, 1e-15, 0.0],
        bias_0: [g[0], g[1], f[0], f[1]],
        bias_1: [a[0], a[1], n[0], n[1]],
        ..Step::default()
    }
}

fn floats(n: usize, random: &mut Random, scale: f64) -> Vec<u32> {
    (0..n).map(|_| ((scale * random.normal()) as f32).to_bits()).collect()
}

/// Gradient, value and moments that the device leaves of these, and its report, after the comparison with the twin.
fn adam(gpu: &Gpu, group: AdamGroup, t: u64, failed: u32, arrays: [Vec<u32>; 4]) -> ([Vec<u32>; 4], Vec<u32>) {
    let [gradient, value, moment_1, moment_2] = arrays;
    let push = AdamPush::new(gradient.len() as u32, group);
    let groups = push.count.div_ceil(256) + 1;
    let counters = vec![5, 0, 0, failed, 0, 0, 0, 0];
    let step = bytemuck::pod_collect_to_vec(&[step(t)]);
    let status = status::clear().to_vec();
    let buffers = AdamBuffers { step, counters, gradient, value, moment_1, moment_2, status };
    let case = KernelCase { kernel: &ADAM, constants: (), push, buffers, groups };
    let done = case.check(gpu, &format!("{group:?}"));
    ([done.gradient, done.value, done.moment_1, done.moment_2], done.status)
}

#[test]
fn adam_equals_its_twin_and_the_formula() {
    let gpu = tests_harness::gpu();
    let mut random = Random::new(3);
    let groups = [(AdamGroup::NetworkF, 1e-3, 0), (AdamGroup::Association, 5e-3, 10), (AdamGroup::NetworkG, 8e-4, 20)];
    for (group, rate, offset) in groups {
        for (n, t) in [(1, 1), (700, 3)] {
            let start = [floats(n, &mut random, 1e-3), floats(n, &mut random, 1.0), vec![0; n], vec![0; n]];
            let ([_, value, ..], _) = adam(&gpu, group, t, 0, start.clone());
            let (m_hat, v_hat) = (1.0 - 0.9_f64.powi((t + offset) as i32), 1.0 - 0.999_f64.powi((t + offset) as i32));
            for i in 0..n {
                let g = f64::from(f32::from_bits(start[0][i]));
                let expected = f64::from(f32::from_bits(start[1][i]))
                    - rate * (0.1 * g / m_hat) / ((0.001 * g * g / v_hat).sqrt() + 1e-15);
                assert!((f64::from(f32::from_bits(value[i])) - expected).abs() < 1e-6, "{group:?} {n} [{i}]");
            }
            // Nothing happens in a failed frame.
            let (skipped, _) = adam(&gpu, group, t, 1, start.clone());
            assert_eq!(skipped, start);
        }
    }
}

#[test]
fn poison_is_reported_and_not_applied() {
    let gpu = tests_harness::gpu();
    let mut random = Random::new(4);
    let clean = [0, 1, 2, 3].map(|k| floats(100, &mut random, if k == 3 { 0.0 } else { 1.0 }));
    let poison = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e38, f32::MIN_POSITIVE / 2.0];
    for slot in 0..4 {
        for value in poison {
            let mut arrays = clean.clone();
            arrays[slot][42] = value.to_bits();
            let (done, status) = adam(&gpu, AdamGroup::NetworkF, 5, 0, arrays.clone());
            let report = status::first(&status);
            let changed = (1..4).any(|k| done[k][42] != arrays[k][42]);
            assert_eq!(changed, report.is_none(), "{slot} {value}");
            assert!(report.is_none_or(|r| r == ("network F", 1, 42)), "{report:?}");
            let finite = |k: usize| f32::from_bits(done[k][42]).is_finite();
            assert!((1..4).all(|k| finite(k) || done[k][42] == arrays[k][42]), "{slot} {value}");
            assert!(value.is_finite() || report.is_some(), "{slot} {value}");
        }
    }
}

#[test]
fn the_first_number_that_is_not_finite_is_found() {
    let gpu = tests_harness::gpu();
    for n in [1_u32, 1023, 1024, 5000] {
        let mut values = floats(n as usize, &mut Random::new(5), 1e30);
        values[0] = f32::MAX.to_bits();
        for (k, bad) in [f32::NAN, f32::INFINITY, -f32::NAN].into_iter().enumerate() {
            values[(n - 1) as usize / (k + 1)] = bad.to_bits();
            let push = CheckFinitePush { count: n };
            let buffers = CheckFiniteBuffers { values: values.clone(), found: vec![0, u32::MAX] };
            let groups = n.div_ceil(1024) + 1;
            let case = KernelCase { kernel: &CHECK_FINITE, constants: (), push, buffers, groups };
            assert_eq!(case.check(&gpu, &n.to_string()).found[1], (n - 1) / (k as u32 + 1));
        }
    }
    let good = gpu.buffer_with("good", bytemuck::cast_slice(&[1.0_f32, -2.0, f32::MAX, 0.0])).unwrap();
    let bad = gpu.buffer_with("bad", bytemuck::cast_slice(&[0.0_f32, 1.0, f32::NEG_INFINITY, f32::NAN])).unwrap();
    check_finite(&gpu, &[]).unwrap();
    check_finite(&gpu, &[("good", (&good).into(), 4), ("none", (&bad).into(), 0), ("start", (&bad).into(), 2)])
        .unwrap();
    match check_finite(&gpu, &[("good", (&good).into(), 4), ("mean", (&bad).into(), 4)]) {
        Err(Error::NonFinite { what, index, value }) => {
            assert_eq!((what.as_str(), index, value.as_str()), ("mean (2 not finite)", 2, "-inf"));
        }
        other => panic!("{other:?}"),
    }
}
