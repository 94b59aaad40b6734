//! Unusable and extreme values in every parameter of a Gaussian.

use engine::error::Result;
use engine::gpu::Gpu;
use engine::scene::synthetic::random_scene;
use engine::scene::{Camera, Gaussians, Rejected, Scene};
use glam::DVec3;

use super::case::{Case, Check, Outcome};
use super::compare::{compare, usual_options};

/// What is put into a parameter: not finite, at the ends of the range, denormal, and beside thresholds (1/255, the tile
/// edge, the near plane, the largest log scale).
pub const POISON: [f32; 24] = [
    f32::NAN,
    -f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    0.0,
    -0.0,
    1e-45,
    -1e-45,
    f32::MIN_POSITIVE,
    -f32::MIN_POSITIVE,
    1e-20,
    -1e-20,
    1e20,
    -1e20,
    1e38,
    -1e38,
    f32::MAX,
    f32::MIN,
    1.0 / 255.0,
    16.0,
    -0.2,
    0.2,
    0.200_000_02,
    30.1,
];

/// Parameters of a Gaussian: centre, log scale, rotation, opacity, SH.
pub fn slots(g: &Gaussians) -> usize {
    3 + 3 + 4 + 1 + g.sh_coefficients() * 3
}

/// Writes `value` into parameter `slot` of Gaussian `i`.
pub fn poison(g: &mut Gaussians, i: usize, slot: usize, value: f32) {
    let row = g.sh_coefficients() * 3;
    match slot {
        0..3 => g.mean[i][slot] = value,
        3..6 => g.log_scale[i][slot - 3] = value,
        6..10 => g.rotation[i][slot - 6] = value,
        10 => g.opacity_logit[i] = value,
        _ => g.sh[i * row + slot - 11] = value,
    }
}

/// A view from 4 units before the origin.
pub fn camera([width, height]: [u32; 2]) -> Camera {
    Camera::look_at(DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, DVec3::NEG_Y, 0.9, [width, height])
}

pub(super) fn cases() -> Vec<Case> {
    let each = |value: f32| {
        let name = match value {
            v if v.is_nan() => format!("poison_{}nan", if v.is_sign_negative() { "-" } else { "" }),
            v => format!("poison_{v:e}"),
        };
        let input = format!("{value:e} in every parameter of SH degree 1, one Gaussian each, among 100 good ones.");
        Case::new(21, name, input, move |context| judge(context.gpu, value))
    };
    POISON.into_iter().map(each).collect()
}

fn judge(gpu: &Gpu, value: f32) -> Result<Outcome> {
    let mut scene: Scene = random_scene(123, 21, 1);
    for slot in 0..slots(&scene.gaussians) {
        poison(&mut scene.gaussians, 5 * slot, slot, value);
    }
    let g = &scene.gaussians;
    let mut rejected = Rejected::default();
    let refused = (0..g.len()).filter(|&i| !g.is_valid(i, &mut rejected)).count();
    let c = compare(gpu, &scene, &camera([64, 48]), 0.0, &usual_options())?;
    let mut outcome = c.outcome();
    outcome.checks.push(Check::exactly("Gaussians refused on upload", c.rejected, refused));
    let counted = c.statistics.rejected as f64;
    outcome.checks.push(Check::at_least("Gaussians refused on the device", counted, refused as f64));
    Ok(outcome)
}
