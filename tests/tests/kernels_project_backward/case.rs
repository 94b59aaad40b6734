//! Input of `deform_project_backward`: random Gaussians, splats from the forward's twin, rows as the blending leaves them.

use engine::render::deform_project::DEFORM_PROJECT;
use engine::render::frame::Frame;
use engine::scene::Camera;
use engine::scene::parameter::{PARAMETERS, REQUIRED, first_plane, in_degree, planes};
use engine::train::deform_project_backward::{
    DEFORM_PROJECT_BACKWARD, DEFORM_PROJECT_BACKWARD_THREADS, DeformProjectBackward, DeformProjectBackwardBuffers,
    DeformProjectBackwardConstants, OUTPUT_GRADIENT, SLOT_PLANES,
};
use engine::train::status;
use engine::train::step::{Step, bias_corrections};
use tests_harness::KernelCase;
use tests_harness::render_case::{Random, RenderInput};

pub(super) type Buffers = DeformProjectBackwardBuffers<Vec<u32>>;

/// Kinds of parameters: name, first plane, planes.
pub(super) fn kinds(input: &RenderInput) -> Vec<(&'static str, usize, usize)> {
    let present = input.optional.present();
    let given = PARAMETERS
        .iter()
        .enumerate()
        .filter(|(i, _)| if *i < REQUIRED { in_degree(*i, input.degree) } else { present.has(*i) });
    given.map(|(i, p)| (p.name, first_plane(i, present) as usize, p.width as usize)).collect()
}

pub(super) fn words(v: &[f32]) -> Vec<u32> {
    v.iter().map(|x| x.to_bits()).collect()
}

pub(super) fn floats(v: &[u32]) -> Vec<f32> {
    v.iter().map(|&x| f32::from_bits(x)).collect()
}

/// A step that gathers these statistics.
pub(super) fn step(density_statistics: f32) -> Step {
    let bias = bias_corrections(0.9, 0.999, 7);
    Step {
        rate: std::array::from_fn(|i| RATES[i % RATES.len()]),
        bias_gaussians: bias,
        density_statistics,
        ..Step::with_usual_adam()
    }
}

/// Learning rates, by parameter.
const RATES: [f32; 9] = [1.6e-3, 5e-3, 1e-3, 5e-2, 2.5e-3, 1.25e-4, 1.5e-4, 2e-4, 1e-3];

/// Rows as a handful of pixels would leave them.
fn rows(n: usize, r: &mut Random) -> Vec<f32> {
    let mut rows = vec![0.0; 12 * n];
    for row in rows.chunks_exact_mut(12) {
        let size = 10.0_f32.powf(r.range(-6.0, 0.0));
        for _ in 0..6 {
            let (h, u, v) = (size * r.range(-1.0, 1.0), r.range(-2.5, 2.5), r.range(-2.5, 2.5));
            for (x, add) in row.iter_mut().zip([h, h * u, h * v, h * u * u, h * u * v, h * v * v]) {
                *x += add;
            }
            row[6..9].iter_mut().for_each(|x| *x += size * r.range(-1.0, 1.0));
            row[9] += 1.0;
            row[10..12].iter_mut().for_each(|x| *x += size * r.range(0.0, 1.0));
        }
    }
    rows
}

/// Splats and tile counts, from the forward's twin.
fn forward(input: &RenderInput, frame: &Frame) -> [Vec<u32>; 2] {
    let case = input.deform_project(frame);
    let done = DEFORM_PROJECT.run_twin(8, case.constants, case.push, case.buffers, case.groups);
    [done.splats, done.tile_count]
}

/// The kernel's call for `input`. Gradients of other losses at the centres come along in every other case.
pub(super) fn case(input: &RenderInput, camera: &Camera, output: u32, seed: u64) -> KernelCase<DeformProjectBackward> {
    let frame: Frame = input.frame(camera);
    let [splats, tile_count] = forward(input, &frame);
    let (n, mut r) = (input.count, Random(seed));
    let planes = planes(input.degree, input.optional.present()) as usize;
    let splat_gradient = words(&rows(n, &mut r));
    let mut random =
        |count: usize, low: f32, high: f32| words(&(0..count).map(|_| r.range(low, high)).collect::<Vec<_>>());
    let (moment_1, moment_2) = (random(planes * n, -0.01, 0.01), random(planes * n, 1e-4, 1e-2));
    let mean_gradient = random(3 * n, -1e-3, 1e-3);
    let [blend_index, blend_weight] = input.blend_words();
    let (moving, nonrigid) = (!input.pose.is_empty(), !input.nonrigid_offset.is_empty());
    let band = |degree: u32| (input.degree >= degree).then(|| words(&input.sh[degree as usize]));
    KernelCase {
        kernel: &DEFORM_PROJECT_BACKWARD,
        constants: DeformProjectBackwardConstants {
            sh_degree: input.degree,
            motion: moving.into(),
            nonrigid: nonrigid.into(),
            output,
            mean_gradient: (seed % 2) as u32,
            optional: input.optional.present().0,
            blend: input.blend_slots(),
            antialiased: input.antialiased.into(),
        },
        push: (),
        buffers: Buffers {
            frame: bytemuck::cast_slice(&[frame]).to_vec(),
            step: bytemuck::cast_slice(&[step(if seed.is_multiple_of(3) { 2.0 } else { 1.0 })]).to_vec(),
            counters: vec![0; 8],
            status: status::clear().to_vec(),
            splats,
            tile_count,
            splat_gradient,
            mean: words(&input.mean),
            log_scale: words(&input.log_scale),
            rotation: words(&input.rotation),
            opacity_logit: words(&input.opacity_logit),
            superpoint_of_gaussian: input.hard_superpoints(),
            pose: moving.then(|| words(&input.pose)),
            sh_0: words(&input.sh[0]),
            sh_1: band(1),
            sh_2: band(2),
            sh_3: band(3),
            moment_1: Some(moment_1),
            moment_2: Some(moment_2),
            gradient: (output == OUTPUT_GRADIENT).then(|| vec![0; planes * n]),
            pose_gradient: moving.then(|| vec![0; n * (SLOT_PLANES * input.blend_slots()).max(6) as usize]),
            nonrigid_offset: nonrigid.then(|| words(&input.nonrigid_offset)),
            nonrigid_gradient: nonrigid.then(|| vec![0; 10 * n]),
            density: Some(vec![0; 2 * n]),
            max_radius: Some(vec![0; n]),
            mean_gradient: (seed % 2 == 1).then_some(mean_gradient),
            optional: (!input.optional.is_empty()).then(|| words(&input.optional.to_device())),
            blend_index,
            blend_weight,
        },
        groups: (n as u32).div_ceil(DEFORM_PROJECT_BACKWARD_THREADS).max(1),
    }
}

/// Words of an optional buffer that the case has.
pub(super) fn given(buffer: &Option<Vec<u32>>) -> &[u32] {
    buffer.as_deref().expect("the case has this buffer")
}
