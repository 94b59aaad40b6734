//! `check_finite` on the device against its twin.

use engine::Error;
use engine::train::check_finite::*;
use tests_harness::render_case::Random;
use tests_harness::{KernelCase, widths};

#[test]
fn what_is_not_finite_is_counted_and_the_first_is_named() {
    let gpu = tests_harness::shared_gpu();
    widths::assert_lanes(&gpu);
    let mut r = Random(3);
    let nasty = [f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
    let fine = [0.0, -0.0, f32::MAX, f32::MIN, f32::MIN_POSITIVE, f32::from_bits(1)];
    for count in [1_u32, 7, 255, 256, 1023, 1024, 1025, 5000] {
        // From none on; the last value belongs to nobody and must not be looked at.
        for bad in [0, 1, count / 3] {
            let mut values: Vec<f32> = (0..=count).map(|i| fine[i as usize % fine.len()] * r.range(0.0, 1.0)).collect();
            let mut places: Vec<u32> = (0..bad).map(|_| (r.unit() * count as f32) as u32 % count).collect();
            places.iter().for_each(|&at| values[at as usize] = nasty[at as usize % nasty.len()]);
            values[count as usize] = f32::NAN;
            places.sort_unstable();
            places.dedup();
            let buffers =
                CheckFiniteBuffers { values: values.iter().map(|v| v.to_bits()).collect(), found: vec![0, u32::MAX] };
            // One workgroup too many, as a folded grid has.
            let groups = count.div_ceil(CHECK_FINITE_FLOATS) + 1;
            let case =
                KernelCase { kernel: &CHECK_FINITE, constants: (), push: CheckFinitePush { count }, buffers, groups };
            let found = case.check(&gpu, &format!("{bad} of {count}")).found;
            let first = places.first().copied().unwrap_or(u32::MAX);
            assert_eq!(found, [places.len() as u32, first], "{bad} of {count}");
        }
    }
}

#[test]
fn the_first_array_that_is_not_finite_is_the_error() {
    let gpu = tests_harness::shared_gpu();
    let good = gpu.buffer_with("good", bytemuck::cast_slice(&[1.0_f32, -2.0, f32::MAX, 0.0])).unwrap();
    let bad = gpu.buffer_with("bad", bytemuck::cast_slice(&[0.0_f32, 1.0, f32::NEG_INFINITY, f32::NAN])).unwrap();
    check_finite(&gpu, &[]).unwrap();
    check_finite(&gpu, &[("good", good.whole(), 4), ("none", bad.whole(), 0), ("start", bad.whole(), 2)]).unwrap();
    match check_finite(&gpu, &[("good", good.whole(), 4), ("mean", bad.whole(), 4)]) {
        Err(Error::NonFinite { what, index, value }) => {
            assert_eq!((what.as_str(), index, value.as_str()), ("mean (2 not finite)", 2, "-inf"));
        }
        other => panic!("{other:?}"),
    }
}
