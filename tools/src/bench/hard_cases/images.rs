//! The hard cases of the engine: one image each.

use engine::error::{Error, Result};
use engine::gpu::Gpu;
use engine::scene::synthetic::{HardCase, hard_cases};

use super::case::{Case, Check, GROUPS, Outcome};
use super::compare::{compare, options_of};

/// Beginnings of the names of each group of [`GROUPS`].
const NUMBERS: [(usize, &[&str]); 14] = [
    (1, &["needles"]),
    (2, &["scale_"]),
    (3, &["quaternion", "poison"]),
    (4, &["near_plane", "camera_inside", "mean_at_camera", "almost_zero"]),
    (5, &["equal_depths", "one_point", "reverse_order"]),
    (6, &["depth_range"]),
    (7, &["faint", "alpha_clamp", "opacity_limits", "bright_and_dark"]),
    (8, &["wide_", "principal", "uneven"]),
    (10, &["rotation_"]),
    (11, &["time_", "single_key"]),
    (12, &["empty_superpoint", "one_superpoint", "more_superpoints", "network_only", "table_beats"]),
    (13, &["world_offset"]),
    (14, &["no_gaussians", "none_visible", "crowded", "all_full"]),
    (22, &["image_", "one_gaussian", "two_gaussians"]),
];

/// Group of a case of the engine; the last one for a name that no group claims.
fn number(name: &str) -> usize {
    let claims = |names: &[&str]| names.iter().any(|n| name.starts_with(n));
    NUMBERS.iter().find(|(_, names)| claims(names)).map_or(GROUPS.len(), |(number, _)| *number)
}

/// One case for each of [`hard_cases`].
pub(super) fn cases() -> Vec<Case> {
    let judged =
        |case: HardCase| Case::new(number(case.name), case.name, case.doc, move |context| judge(context.gpu, &case));
    hard_cases().into_iter().map(judged).collect()
}

/// The case of the engine with this name.
pub(super) fn named(name: &str) -> Result<HardCase> {
    let found = hard_cases().into_iter().find(|case| case.name == name);
    found.ok_or_else(|| Error::usage("hard case", name, "a name of the engine's hard cases"))
}

fn judge(gpu: &Gpu, case: &HardCase) -> Result<Outcome> {
    let options = options_of(case);
    let c = compare(gpu, &case.scene, &case.camera, case.time, &options)?;
    let mut outcome = c.outcome();
    outcome.checks.push(Check::exactly("Gaussians refused", c.rejected, case.rejected));
    if case.empty {
        let painted = c.image.rgba.chunks_exact(4).filter(|p| p[..3] != case.background || p[3] != 0.0).count();
        outcome.checks.push(Check::exactly("pixels that are not background", painted, 0));
    }
    Ok(outcome)
}
