//! The kernels of key poses under training against their twins, and against the definition in f64.

use engine::scene::Motion;
use engine::train::KeyOptions;
use engine::train::association::superpoint_sum::SUM_PLANES;
use engine::train::keys::definition::Keys;
use engine::train::keys::interpolate_keys::*;
use engine::train::keys::learn_keys::*;
use engine::train::keys::words::{key_words, superpoint_words, table_of, twin_words};
use engine::train::photo_loss::Twist;
use engine::train::status;
use engine::train::step::Step;
use glam::DVec3;
use tests_harness::KernelCase;
use tests_harness::render_case::Random;

/// Pixels of an image.
const PIXELS: f64 = 300.0;

/// A table with two keys of one time, in which some vectors begin anew, and how it learns; every fifth superpoint rests.
fn table(m: usize, seed: u64) -> (Motion, KeyOptions) {
    let mut r = Random(seed);
    let times = vec![0.0, 0.3, 0.5, 0.5_f32.next_up(), 1.0];
    let mut rows = |bound: f32| -> Vec<[f32; 3]> {
        (0..times.len() * m).map(|_| std::array::from_fn(|_| r.range(-bound, bound))).collect()
    };
    let (mut rotation, mut translation) = (rows(1.5), rows(1.0));
    for j in (0..m).filter(|j| j % 3 > 0) {
        (rotation[3 * m + j], translation[3 * m + j]) = (rotation[2 * m + j], translation[2 * m + j]);
    }
    let center = (0..m).map(|_| DVec3::from_array(std::array::from_fn(|_| f64::from(r.range(-2.0, 2.0))))).collect();
    let unit = (0..m).map(|j| if j % 5 == 4 { 0.0 } else { 0.01 }).collect();
    let options = KeyOptions {
        center,
        // Some are so small that a step would turn them far.
        reach: (0..m).map(|j| if j % 11 == 3 { 2e-3 } else { f64::from(r.range(0.1, 0.6)) }).collect(),
        unit,
        rate_px: [0.5, 0.05],
        hold: 0.05,
        smooth: 0.05,
        iterations: 40,
    };
    (Motion { times, rotation, translation }, options)
}

/// What a step says at a time, as the trainer has it.
fn step(motion: &Motion, options: &KeyOptions, iteration: u64, time: f64) -> Step {
    let between = motion.interval(time);
    let share = iteration as f64 / options.iterations as f64;
    let [from, to] = options.rate_px;
    Step {
        superpoints: options.center.len() as u32,
        key_first: between.first,
        key_second: between.second,
        key_weight: between.weight as f32,
        rate_key: (from * (to / from).powf(share)) as f32,
        key_fade: (1.0 - share) as f32,
        pixels: PIXELS as f32,
        ..Step::with_usual_adam()
    }
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|v| v.to_bits()).collect()
}

fn step_words(step: Step) -> Vec<u32> {
    bytemuck::cast_slice(&[step]).to_vec()
}

/// Gradients by poses, and the planes that hold them; every seventh superpoint is not seen.
fn gradients(m: usize, r: &mut Random) -> (Vec<Twist>, Vec<f32>) {
    let mut planes = vec![0.0; SUM_PLANES * m];
    for j in (0..m).filter(|j| j % 7 != 6) {
        (13..19).for_each(|plane| planes[plane * m + j] = r.range(-0.02, 0.02));
    }
    let vector = |plane: usize, j: usize| DVec3::from_array([0, 1, 2].map(|c| f64::from(planes[(plane + c) * m + j])));
    let twist = |j| Twist { rotation: PIXELS * vector(13, j), translation: PIXELS * vector(16, j) };
    ((0..m).map(twist).collect(), planes)
}

#[test]
fn poses_between_keys_match_their_twin_and_the_definition() {
    let gpu = tests_harness::shared_gpu();
    for m in [1_usize, 20, 300] {
        let (motion, options) = table(m, m as u64);
        let keys = Keys::new(&motion, options.clone()).unwrap();
        // Before, at, between and after the keys, and between the two of one time.
        for time in [-1.0, 0.0, 0.11, 0.3, 0.5, f64::from(0.5_f32.next_up()), 0.77, 1.0, 3.0] {
            let buffers = InterpolateKeysBuffers {
                step: step_words(step(&motion, &options, 1, time)),
                key: bits(&key_words(&motion, &options)),
                key_superpoint: bits(&superpoint_words(&options)),
                pose: vec![0; 8 * m],
            };
            let groups = (m as u32).div_ceil(256);
            let case = KernelCase { kernel: &INTERPOLATE_KEYS, constants: (), push: (), buffers, groups };
            let done = case.check(&gpu, &format!("{m} superpoints at {time}"));
            for (j, pose) in keys.poses(time).into_iter().enumerate() {
                let of = |word: usize| {
                    DVec3::from_array([0, 1, 2].map(|c| f64::from(f32::from_bits(done.pose[8 * j + word + c]))))
                };
                let off = of(0).distance(pose.rotation).max(of(4).distance(pose.translation));
                assert!(off < 2e-6, "superpoint {j} of {m} at {time}: off by {off:.1e}");
            }
        }
    }
}

fn learning(motion: &Motion, options: &KeyOptions, step: Step, failed: u32, sums: &[f32], key: Vec<u32>) -> Learning {
    let push =
        LearnKeysPush { keys: motion.times.len() as u32, hold: options.hold as f32, smoothness: options.smooth as f32 };
    let buffers = LearnKeysBuffers {
        step: step_words(step),
        counters: vec![0, 0, 0, failed, 0, 0, 0, 0],
        pose_sum: bits(sums),
        key_superpoint: bits(&superpoint_words(options)),
        key_twin: twin_words(&motion.times),
        key,
        status: status::clear().to_vec(),
    };
    let groups = (options.center.len() as u32).div_ceil(256);
    KernelCase { kernel: &LEARN_KEYS, constants: (), push, buffers, groups }
}

type Learning = KernelCase<LearnKeys>;

#[test]
fn keys_learn_as_their_twin_and_the_definition_do() {
    let gpu = tests_harness::shared_gpu();
    for m in [1_usize, 20, 300] {
        let (motion, options) = table(m, 7 + m as u64);
        let mut keys = Keys::new(&motion, options.clone()).unwrap();
        let mut key = bits(&key_words(&motion, &options));
        let mut r = Random(3 + m as u64);
        for (iteration, time) in (1..).zip([0.1, 0.2, 0.4, 0.45, 0.5, 0.5, 0.6, 0.9, 1.0, 2.0, -1.0, 0.3]) {
            let (twists, sums) = gradients(m, &mut r);
            let step = step(&motion, &options, iteration, time);
            let done = learning(&motion, &options, step, 0, &sums, key.clone())
                .check(&gpu, &format!("{m} superpoints at {time}"));
            assert!(status::first(&done.status).is_none());
            key = done.key;
            keys.learn(iteration, time, &twists);
        }
        let key: Vec<f32> = key.into_iter().map(f32::from_bits).collect();
        let (found, expected) = (table_of(&key, &motion.times, &options), keys.table());
        for (at, (a, b)) in found.rotation.iter().zip(&expected.rotation).enumerate() {
            let place = |m: &Motion| m.translation[at];
            let off = (0..3).map(|c| (a[c] - b[c]).abs().max((place(&found)[c] - place(&expected)[c]).abs()));
            let off = off.fold(0.0, f32::max);
            // A step is 5e-3 world units.
            assert!(off < 2e-5, "row {at} of {m} superpoints: off by {off:.1e}");
        }
        assert!(m < 2 || found.rotation != motion.rotation, "nothing was learnt");
        for j in (0..m).filter(|j| j % 5 == 4) {
            assert_eq!(found.rotation[j], motion.rotation[j], "superpoint {j} rests");
        }
    }
}

#[test]
fn keys_stay_when_the_frame_failed_or_a_gradient_is_not_finite() {
    let gpu = tests_harness::shared_gpu();
    let (motion, options) = table(20, 5);
    let key = bits(&key_words(&motion, &options));
    let (_, mut sums) = gradients(20, &mut Random(9));
    let step = step(&motion, &options, 3, 0.4);
    let done = learning(&motion, &options, step, 1, &sums, key.clone()).check(&gpu, "a frame that failed");
    assert_eq!(done.key, key);
    sums[13 * 20 + 3] = f32::NAN;
    let done = learning(&motion, &options, step, 0, &sums, key.clone()).check(&gpu, "a gradient that is not finite");
    assert_eq!(status::first(&done.status).map(|(_, count, first)| (count, first)), Some((1, 3)));
    let of = |words: &[u32], j: usize| words.iter().skip(j).step_by(20).copied().collect::<Vec<_>>();
    assert!(of(&done.key, 3) == of(&key, 3) && of(&done.key, 2) != of(&key, 2));
}
