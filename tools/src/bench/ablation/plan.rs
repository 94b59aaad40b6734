//! Which settings each ablation of the paper has.

use engine::scene::MotionSource;
use engine::train::config::Config;

/// One setting.
pub(super) struct Variant {
    pub(super) name: String,
    pub(super) change: Box<dyn Fn(&mut Config)>,
    /// Row of the paper's table.
    pub(super) paper_row: usize,
    /// Where play-back takes its poses from, where that is what is compared.
    pub(super) playback: Option<MotionSource>,
}

/// One ablation.
pub(super) struct Plan {
    /// That of [`crate::report::paper::Ablation`].
    pub(super) id: &'static str,
    pub(super) variants: Vec<Variant>,
    /// Why it has no variants, if so.
    pub(super) left_out: Option<&'static str>,
}

fn variant(name: impl Into<String>, paper_row: usize, change: impl Fn(&mut Config) + 'static) -> Variant {
    Variant { name: name.into(), change: Box::new(change), paper_row, playback: None }
}

fn plan(id: &'static str, variants: Vec<Variant>) -> Plan {
    Plan { id, variants, left_out: None }
}

/// All ablations of the paper, in its order.
pub(super) fn plans() -> Vec<Plan> {
    let superpoints = [50, 100, 200, 300, 400, 500].into_iter().enumerate();
    let neighbors = (1..=6).enumerate();
    let no_loss = |c: &mut Config| {
        (c.loss.lambda_position, c.loss.lambda_rotation, c.loss.lambda_translation) = (0.0, 0.0, 0.0);
    };
    let playback = |name: &str, row, source| Variant { playback: Some(source), ..variant(name, row, |_| ()) };
    let left_out = |id, why| Plan { id, variants: Vec::new(), left_out: Some(why) };
    vec![
        plan(
            "superpoints",
            superpoints
                .map(|(row, m)| variant(format!("{m} superpoints"), row, move |c| c.motion.superpoints = m))
                .collect(),
        ),
        plan(
            "neighbors",
            neighbors.map(|(row, k)| variant(format!("K = {k}"), row, move |c| c.motion.neighbors = k)).collect(),
        ),
        plan("property-loss", vec![variant("without", 0, no_loss), variant("with", 1, |_| ())]),
        left_out("distillation", "a teacher of another method (D-3D-GS) is needed"),
        weights("weight-position", [1.0, 0.1, 0.01, 1e-3, 1e-4, 0.0], |c, w| c.loss.lambda_position = w),
        weights("weight-translation", [10.0, 1.0, 0.1, 0.01, 1e-3, 0.0], |c, w| c.loss.lambda_translation = w),
        weights("weight-rotation", [10.0, 1.0, 0.1, 0.01, 1e-3, 0.0], |c, w| c.loss.lambda_rotation = w),
        plan("network-size", NETWORK_SIZES.into_iter().enumerate().map(network_size).collect()),
        plan(
            "warm-up",
            vec![variant("without", 0, |c| c.schedule.warm_up = 0), variant("with (3,000 of 40,000)", 1, |_| ())],
        ),
        plan(
            "inference",
            vec![
                playback("network F, live", 0, MotionSource::Network),
                playback("key-time table", 1, MotionSource::Table),
            ],
        ),
    ]
}

/// Width and depth of network F, in the order of the paper's rows.
const NETWORK_SIZES: [(u32, u32); 10] =
    [(64, 1), (64, 2), (64, 3), (64, 4), (64, 5), (64, 6), (64, 7), (64, 8), (128, 8), (256, 8)];

fn network_size((row, (width, layers)): (usize, (u32, u32))) -> Variant {
    variant(format!("{layers} layers of {width}"), row, move |c| {
        (c.motion.network_width, c.motion.network_layers) = (width, layers);
    })
}

fn weights(id: &'static str, values: [f32; 6], set: fn(&mut Config, f32)) -> Plan {
    let row = |(row, value)| variant(format!("λ = {value}"), row, move |c: &mut Config| set(c, value));
    plan(id, values.into_iter().enumerate().map(row).collect())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    #[test]
    fn ablations_are_those_of_the_paper_and_their_settings_are_valid() {
        let tables = crate::report::paper::tables().unwrap();
        let plans = plans();
        let ids: Vec<&str> = plans.iter().map(|p| p.id).collect();
        assert_eq!(ids, tables.ablations.iter().map(|a| a.id.as_str()).collect::<Vec<_>>());
        for plan in &plans {
            let printed = tables.ablation(plan.id).unwrap();
            assert_eq!(plan.variants.is_empty(), plan.left_out.is_some(), "{}", plan.id);
            for v in &plan.variants {
                assert!(v.paper_row < printed.rows.len(), "{} {}", plan.id, v.name);
                let mut config = Config::default();
                (v.change)(&mut config);
                config.check().unwrap();
            }
        }
    }

    #[test]
    fn settings_are_in_the_order_of_the_papers_rows() {
        let tables = crate::report::paper::tables().unwrap();
        for id in ["superpoints", "neighbors"] {
            let plan = plans().into_iter().find(|p| p.id == id).unwrap();
            for (v, row) in plan.variants.iter().zip(&tables.ablation(id).unwrap().rows) {
                assert!(v.name.contains(&row[0].to_string()), "{} {:?}", v.name, row[0]);
            }
        }
    }
}
