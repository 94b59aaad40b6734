//! Numbers that are not finite, absurd or tiny, in every buffer.

use engine::gpu::Gpu;
use engine::scene::parameter::{Present, planes};
use engine::train::deform_project_backward::{OUTPUT_ADAM, OUTPUT_GRADIENT};
use engine::train::status;
use tests_harness::render_case::{RenderInput, test_camera};

use super::case::{Buffers, case, floats, given};

const POISON: [f32; 24] = [
    f32::NAN,
    -f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::MAX,
    f32::MIN,
    1e38,
    -1e38,
    1e30,
    -1e30,
    1e20,
    -1e20,
    1e15,
    -1e13,
    100.0,
    -100.0,
    1e-20,
    -1e-30,
    1e-38,
    -1e-38,
    1e-45,
    -1e-42,
    0.0,
    -0.0,
];

/// Buffers that can hold a poisoned float, with words per Gaussian and whether they are planes.
fn poison_slots(b: &mut Buffers) -> Vec<(&mut [u32], usize, bool)> {
    fn given(buffer: &mut Option<Vec<u32>>) -> &mut [u32] {
        buffer.as_deref_mut().expect("the case has this buffer")
    }
    let planes = planes(3, Present(u32::MAX)) as usize;
    vec![
        (&mut b.splats, 12, false),
        (&mut b.splat_gradient, 12, false),
        (&mut b.rotation, 4, false),
        (&mut b.mean, 3, true),
        (&mut b.log_scale, 3, true),
        (&mut b.opacity_logit, 1, true),
        (&mut b.sh_0, 3, true),
        (given(&mut b.sh_1), 9, true),
        (given(&mut b.sh_2), 15, true),
        (given(&mut b.sh_3), 21, true),
        (given(&mut b.moment_1), planes, true),
        (given(&mut b.moment_2), planes, true),
        (given(&mut b.nonrigid_offset), 10, true),
        (given(&mut b.density), 2, true),
        (given(&mut b.max_radius), 1, true),
        (given(&mut b.optional), Present(u32::MAX).planes() as usize, true),
    ]
}

/// Puts `value` into slot number g of Gaussian g; every Gaussian counts as visible if the clean one was.
fn poison(b: &mut Buffers, n: usize, value: f32) {
    let mut slots = poison_slots(b);
    let total: usize = slots.iter().map(|s| s.1).sum();
    for g in 0..n {
        let mut k = g % total;
        for (words, count, planes) in &mut slots {
            if k < *count {
                words[if *planes { k * n + g } else { *count * g + k }] = value.to_bits();
                break;
            }
            k -= *count;
        }
    }
    // Some poses too: their superpoint's Gaussians all suffer.
    let pose = b.pose.as_mut().expect("the case moves");
    for k in 0..6 {
        pose[8 * k + k % 3 + 4 * (k / 3)] = value.to_bits();
    }
}

/// What a step keeps.
fn kept(b: &Buffers) -> Vec<(&'static str, &[u32])> {
    vec![
        ("mean", &b.mean),
        ("log_scale", &b.log_scale),
        ("rotation", &b.rotation),
        ("opacity_logit", &b.opacity_logit),
        ("sh_0", &b.sh_0),
        ("sh_1", given(&b.sh_1)),
        ("sh_2", given(&b.sh_2)),
        ("sh_3", given(&b.sh_3)),
        ("moment_1", given(&b.moment_1)),
        ("moment_2", given(&b.moment_2)),
        ("density", given(&b.density)),
        ("max_radius", given(&b.max_radius)),
        ("optional", given(&b.optional)),
    ]
}

fn run_poisoned(gpu: &Gpu, input: &RenderInput, value: f32, output: u32) {
    let n = input.count;
    let mut case = case(input, &test_camera(160, 120), output, 4);
    poison(&mut case.buffers, n, value);
    let before = case.buffers.clone();
    let after = case.run(gpu).gpu;
    let context = format!("{value:e}, output {output}");
    for ((name, before), (_, after)) in kept(&before).into_iter().zip(kept(&after)) {
        for (k, (b, a)) in before.iter().zip(after).enumerate() {
            let rotted = f32::from_bits(*b).is_finite() && !f32::from_bits(*a).is_finite();
            assert!(!rotted, "{context}: {name} [{k}] rotted");
        }
    }
    let gradients = [("pose", &after.pose_gradient), ("non-rigid", &after.nonrigid_gradient)];
    let own = (output == OUTPUT_GRADIENT).then_some(("own", &after.gradient));
    for (name, gradient) in gradients.into_iter().chain(own) {
        assert!(floats(given(gradient)).iter().all(|x| x.is_finite()), "{context}: {name} gradient is not finite");
    }
    if !value.is_finite() {
        assert!(status::first(&after.status).is_some(), "{context}: nothing was reported");
    }
}

#[test]
fn poison_never_spreads() {
    let gpu = tests_harness::shared_gpu();
    // Half of the superpoints keep clean poses.
    let input = RenderInput::random(700, 3, 21).moving(12, 5).nonrigid(6).with_optional(7);
    for value in POISON {
        for output in [OUTPUT_GRADIENT, OUTPUT_ADAM] {
            run_poisoned(&gpu, &input, value, output);
        }
    }
}
