//! Case 7: many layers of almost nothing.

use engine::error::Result;
use engine::reference::gradient::image::visible_splats;
use engine::reference::{DeformationAt, Gaussians64};
use engine::scene::Scene;

use super::blend::{Rules, blend};
use super::case::{Case, Check, Context, Outcome};
use super::compare::{compare, options_of, reference_options};
use super::images;

pub(super) fn cases() -> Vec<Case> {
    let above = "300 layers with α up to 1.05/255: what the cut at 1/255 drops at their rims.";
    let below = "300 layers with α up to 0.95/255: all of them fall under the cut.";
    vec![
        Case::new(7, "dropped_energy", above, |context| judge(context, 0.0)),
        Case::new(7, "dropped_energy_all", below, |context| judge(context, (0.95_f32 / 1.05).ln())),
    ]
}

/// `shift` is added to the opacity logits; for small opacities that scales them.
fn judge(context: &Context<'_>, shift: f32) -> Result<Outcome> {
    let case = images::named("faint_layers")?;
    let mut scene: Scene = case.scene.clone();
    scene.gaussians.opacity_logit.iter_mut().for_each(|o| *o += shift);
    let options = options_of(&case);
    let c = compare(context.gpu, &scene, &case.camera, case.time, &options)?;
    let truth = reference_options(&options);
    let splats =
        match visible_splats(&Gaussians64::from(&scene.gaussians), &DeformationAt::default(), &case.camera, &truth) {
            Ok(splats) if !splats.is_empty() => splats,
            // The definition drops Gaussians whose opacity is under the cut, so for the study they are lifted over it and the cut
            // of the blending does the rest.
            _ => {
                let mut lifted = scene.clone();
                lifted.gaussians.opacity_logit.iter_mut().for_each(|o| *o -= shift);
                let mut splats = visible_splats(
                    &Gaussians64::from(&lifted.gaussians),
                    &DeformationAt::default(),
                    &case.camera,
                    &truth,
                )?;
                splats.iter_mut().for_each(|s| s.opacity *= 0.95 / 1.05);
                splats
            }
        };
    let uncut = blend(splats.iter(), &case.camera, truth.background, Rules { alpha_min: 0.0, ..Rules::default() });
    let count = uncut.len() as f64;
    let dropped = uncut.iter().zip(&c.truth.rgb).map(|(a, b)| (a - b).abs());
    let (mean, most) = dropped.fold((0.0, 0.0_f64), |(sum, most), d| (sum + d / count, most.max(d)));
    let bias = c.image.rgb().zip(&c.truth.rgb).map(|(a, b)| a - b).sum::<f64>() / count;
    let mut outcome = c.outcome();
    outcome.truth =
        format!("the cut changes colours by {most:.3} at most and {mean:.4} on average: a fact of the definition");
    outcome.checks.push(Check::at_most("mean signed colour error", bias.abs(), 1.0e-5));
    outcome.checks.push(Check::shown("largest colour that the cut drops", most));
    outcome.checks.push(Check::shown("mean colour that the cut drops", mean));
    Ok(outcome)
}
