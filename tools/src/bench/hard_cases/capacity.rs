//! Case 14: frames that need exactly as much room as there is, one more, or far more.

use engine::error::{Error, Result};
use engine::render::{RenderOptions, Renderer};
use engine::scene::Scene;
use engine::scene::synthetic::random_scene;

use super::case::{Case, Check, Context, Outcome};
use super::compare::{compare, usual_options};
use super::{images, views};

pub(super) fn cases() -> Vec<Case> {
    let one = "3,000 Gaussians with room for exactly the tile instances that they need, and for one less.";
    let grow = "2,000 Gaussians that cover the whole image: twenty times the room of the first try.";
    vec![Case::new(14, "overflow_by_one", one, judge_by_one), Case::new(14, "overflow_and_growth", grow, judge_growth)]
}

fn judge_by_one(context: &Context<'_>) -> Result<Outcome> {
    let (scene, camera) = (random_scene(3000, 7, 1), views::camera(200, 120));
    let renderer = |room: Option<u64>| {
        Renderer::new(context.gpu, &scene, &RenderOptions { max_instances: room, ..usual_options() })
    };
    let needed = renderer(None)?.draw(&camera, 0.0)?.1.instances;
    let exact = renderer(Some(needed))?.draw(&camera, 0.0)?.1.instances;
    let short = renderer(Some(needed - 1))?.render(&camera, 0.0);
    let named = match short {
        Err(Error::Limit { need, have, .. }) => need == u128::from(needed) && have == u128::from(needed - 1),
        _ => false,
    };
    Ok(Outcome {
        truth: format!("{needed} tile instances; one less is a limit, never a wrong image"),
        checks: vec![
            Check::exactly("instances drawn with just enough room", exact as usize, needed as usize),
            Check::exactly("limit errors that name both numbers", usize::from(named), 1),
        ],
    })
}

fn judge_growth(context: &Context<'_>) -> Result<Outcome> {
    let case = images::named("all_full_screen")?;
    let scene: Scene = case.scene;
    let camera = case.camera.resized(256, 256);
    let mut renderer = Renderer::new(context.gpu, &scene, &usual_options())?;
    let first = renderer.submit(&camera, 0.0)?;
    let overflowed = renderer.finish(first)?.is_none();
    let (grown, again) = (renderer.render(&camera, 0.0)?, renderer.render(&camera, 0.0)?);
    let c = compare(context.gpu, &scene, &camera, 0.0, &usual_options())?;
    let mut outcome = c.outcome();
    let changed = |a: &[f32], b: &[f32]| a.iter().zip(b).filter(|(a, b)| a.to_bits() != b.to_bits()).count();
    let bits = changed(&grown.rgba, &again.rgba) + changed(&grown.rgba, &c.image.rgba);
    outcome.checks.push(Check::exactly("first tries that overflowed", usize::from(overflowed), 1));
    outcome.checks.push(Check::exactly("values whose bits growing changed", bits, 0));
    outcome.truth += &format!(", {} tile instances", c.statistics.instances);
    Ok(outcome)
}
