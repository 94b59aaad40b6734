//! The kernels of exposures against their twins, and against the definition in f64.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use engine::render::frame::Frame;
use engine::train::exposure::definition::{IDENTITY, backward, exposed};
use engine::train::exposure::expose::*;
use engine::train::exposure::exposure_backward::*;
use engine::train::exposure::learn_exposure::*;
use engine::train::exposure::{EXPOSURE_PIXELS, EXPOSURE_VALUES, EXPOSURE_WORDS, identities};
use engine::train::status;
use engine::train::step::Step;
use tests_harness::render_case::Random;
use tests_harness::{KernelCase, widths};

/// The photo whose turn it is, of three.
const PHOTO: usize = 1;

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|v| v.to_bits()).collect()
}

fn floats(words: &[u32]) -> Vec<f64> {
    words.iter().map(|w| f32::from_bits(*w).into()).collect()
}

fn frame(size: [u32; 2]) -> Vec<u32> {
    bytemuck::pod_collect_to_vec(&[Frame { size, ..Frame::default() }])
}

fn step(rate_exposure: f32) -> Vec<u32> {
    bytemuck::pod_collect_to_vec(&[Step { exposure: PHOTO as u32, rate_exposure, ..Step::default() }])
}

/// Rows of three photos, all of them numbers of their own.
fn rows(r: &mut Random) -> Vec<f32> {
    let mut rows = identities(3);
    rows.iter_mut().enumerate().filter(|(i, _)| i % EXPOSURE_WORDS < 36).for_each(|(_, v)| *v += r.range(-0.3, 0.3));
    // Second moments are none below zero.
    (0..3).for_each(|p| (24..36).for_each(|k| rows[EXPOSURE_WORDS * p + k] = r.range(1e-6, 1e-3)));
    (0..3).for_each(|p| (36..38).for_each(|k| rows[EXPOSURE_WORDS * p + k] = r.range(0.1, 0.9)));
    rows
}

fn map(rows: &[f32]) -> [f64; EXPOSURE_VALUES] {
    std::array::from_fn(|k| rows[EXPOSURE_WORDS * PHOTO + k].into())
}

fn rgb(four: &[f32]) -> Vec<f64> {
    four.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).map(f64::from).collect()
}

fn image(size: [u32; 2], r: &mut Random, bound: f32) -> Vec<f32> {
    (0..4 * size[0] * size[1]).map(|_| r.range(-bound, bound)).collect()
}

/// Sizes below, at and above what one workgroup has.
const SIZES: [[u32; 2]; 5] = [[1, 1], [16, 16], [64, 32], [67, 31], [130, 70]];

#[test]
fn images_are_exposed_as_their_photo_was() {
    let gpu = tests_harness::shared_gpu();
    for size in SIZES {
        let mut r = Random(size[0].into());
        let (rows, color) = (rows(&mut r), image(size, &mut r, 1.5));
        let buffers = ExposeBuffers {
            frame: frame(size),
            step: step(0.0),
            exposure: bits(&rows),
            color: bits(&color),
            exposed: vec![0; color.len()],
        };
        let groups = (size[0] * size[1]).div_ceil(256) + 1;
        let case = KernelCase { kernel: &EXPOSE, constants: (), push: (), buffers, groups };
        let done = case.check(&gpu, &format!("{size:?}"));
        let found: Vec<f32> = done.exposed.iter().map(|w| f32::from_bits(*w)).collect();
        for (a, b) in rgb(&found).iter().zip(exposed(&map(&rows), &rgb(&color))) {
            assert!((a - b).abs() < 1e-6, "{size:?}: {a} against {b}");
        }
        assert!((3..color.len()).step_by(4).all(|i| found[i].to_bits() == color[i].to_bits()));
    }
}

#[test]
fn gradients_go_back_through_the_exposure() {
    let gpu = tests_harness::shared_gpu();
    widths::assert_lanes(&gpu);
    for size in SIZES {
        let mut r = Random(7 + u64::from(size[0]));
        let (rows, mut color, mut gradient) = (rows(&mut r), image(size, &mut r, 1.5), image(size, &mut r, 0.01));
        // Where the loss has no gradient there may be no number in the image.
        let last = color.len() - 4;
        color[last] = f32::NAN;
        gradient[last..last + 3].fill(0.0);
        let groups = (size[0] * size[1]).div_ceil(EXPOSURE_PIXELS);
        let buffers = ExposureBackwardBuffers {
            frame: frame(size),
            step: step(0.0),
            exposure: bits(&rows),
            color: bits(&color),
            image_gradient: bits(&gradient),
            exposure_partial: vec![0; EXPOSURE_VALUES * groups as usize],
        };
        let case = KernelCase { kernel: &EXPOSURE_BACKWARD, constants: (), push: (), buffers, groups: groups + 1 };
        let done = case.check(&gpu, &format!("{size:?}"));
        color[last] = 0.0;
        let (by_image, by_map) = backward(&map(&rows), &rgb(&color), &rgb(&gradient));
        let found: Vec<f32> = done.image_gradient.iter().map(|w| f32::from_bits(*w)).collect();
        for (a, b) in rgb(&found).iter().zip(&by_image) {
            assert!((a - b).abs() < 1e-8, "{size:?}: {a} against {b}");
        }
        assert!(found.iter().skip(3).step_by(4).all(|w| *w == 0.0));
        let sums = floats(&done.exposure_partial);
        for (k, b) in by_map.iter().enumerate() {
            let a: f64 = sums.iter().skip(k).step_by(EXPOSURE_VALUES).sum();
            assert!((a - b).abs() < 1e-5, "{size:?}, {k}: {a} against {b}");
        }
    }
}

fn learning(size: [u32; 2], rows: &[f32], partial: &[f32], failed: u32) -> KernelCase<LearnExposure> {
    let buffers = LearnExposureBuffers {
        frame: frame(size),
        step: step(0.01),
        exposure: bits(rows),
        exposure_partial: bits(partial),
        counters: vec![0, 0, 0, failed, 0, 0, 0, 0],
        status: status::clear().to_vec(),
    };
    KernelCase { kernel: &LEARN_EXPOSURE, constants: (), push: LearnExposurePush { hold: 0.05 }, buffers, groups: 1 }
}

#[test]
fn the_exposure_of_one_photo_steps() {
    let gpu = tests_harness::shared_gpu();
    for size in [[1_u32, 1], [64, 32], [130, 70], [800, 700]] {
        let mut r = Random(19 + u64::from(size[0]));
        let rows = rows(&mut r);
        let groups = (size[0] * size[1]).div_ceil(EXPOSURE_PIXELS) as usize;
        let partial: Vec<f32> = (0..EXPOSURE_VALUES * groups).map(|_| r.range(-0.01, 0.01)).collect();
        let done = learning(size, &rows, &partial, 0).check(&gpu, &format!("{size:?}"));
        let found = floats(&done.exposure);
        let first = EXPOSURE_WORDS * PHOTO;
        let was = |k: usize| f64::from(rows[first + k]);
        for k in 0..EXPOSURE_VALUES {
            let sum: f64 = partial.iter().skip(k).step_by(EXPOSURE_VALUES).map(|v| f64::from(*v)).sum();
            let gradient = sum + 0.05 * (was(k) - IDENTITY[k]);
            let moments = [0.9 * was(12 + k) + 0.1 * gradient, 0.99 * was(24 + k) + 0.01 * gradient * gradient];
            let decays = [was(36) * 0.9, was(37) * 0.99];
            let way = 0.01 * moments[0] / (1.0 - decays[0]) / (moments[1] / (1.0 - decays[1])).sqrt();
            let off = (found[first + k] - (was(k) - way)).abs();
            assert!(off < 1e-6, "{size:?}, {k}: off by {off:.1e} of a step of {way:.1e}");
        }
        let others = |i: &usize| !(first..first + EXPOSURE_WORDS).contains(i);
        assert!((0..rows.len()).filter(others).all(|i| done.exposure[i] == rows[i].to_bits()));
    }
}

#[test]
fn nothing_changes_when_the_frame_failed_or_a_sum_is_no_number() {
    let gpu = tests_harness::shared_gpu();
    let mut r = Random(5);
    let rows = rows(&mut r);
    let mut partial: Vec<f32> = (0..EXPOSURE_VALUES).map(|_| r.range(-0.01, 0.01)).collect();
    let done = learning([20, 10], &rows, &partial, 1).check(&gpu, "failed");
    assert_eq!(done.exposure, bits(&rows));
    partial[4] = f32::INFINITY;
    let done = learning([20, 10], &rows, &partial, 0).check(&gpu, "infinite");
    let at = EXPOSURE_WORDS * PHOTO + 4;
    assert_eq!((done.exposure[at], done.exposure[at + 12]), (rows[at].to_bits(), rows[at + 12].to_bits()));
    assert_eq!(done.status[2 * status::IMAGE_GRADIENT..][..2], [1, PHOTO as u32]);
}
