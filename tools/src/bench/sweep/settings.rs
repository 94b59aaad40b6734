//! Which settings a sweep tries.

use engine::render::Quality;
use engine::render::quality::KNOBS;
use engine::scene::{MotionSource, Scene};
use serde::Serialize;

use super::measure::Measured;

/// A knob must save this share of the exact time to be combined with others.
const WORTH: f64 = 0.02;

/// Combinations end at this mean square error: 30 dB.
const WORST: f64 = 1e-3;

/// Where a setting comes from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase", tag = "kind")]
pub(super) enum Kind {
    /// The definition.
    Exact,
    /// A preset by name.
    Preset,
    /// One knob alone.
    Knob {
        /// Its name.
        knob: &'static str,
        /// Its value.
        value: String,
    },
    /// Several knobs.
    Combination,
}

/// One way to render.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Setting {
    pub(super) name: String,
    #[serde(flatten)]
    pub(super) kind: Kind,
    pub(super) quality: Quality,
    /// Poses from network F although the model has a table.
    pub(super) network: bool,
}

impl Setting {
    /// The definition.
    pub(super) fn exact() -> Self {
        Self { name: "exact".into(), kind: Kind::Exact, quality: Quality::EXACT, network: false }
    }

    /// The motion source that is asked for.
    pub(super) fn motion(&self, asked: MotionSource) -> MotionSource {
        if self.network { MotionSource::Network } else { asked }
    }
}

/// The definition, the presets, and each knob alone at each of its values that can matter for the scene.
pub(super) fn alone(scene: &Scene) -> Vec<Setting> {
    let exact = Quality::EXACT;
    let mut all = vec![Setting::exact()];
    for (name, quality) in Quality::PRESETS.into_iter().filter(|(_, q)| *q != exact) {
        all.push(Setting { name: name.into(), kind: Kind::Preset, quality, network: false });
    }
    let table = scene.motion.as_ref().is_some_and(|m| m.times.len() > 1);
    let network = scene.deform.is_some() && scene.superpoints.is_some();
    let mut knob = |knob: &'static str, value: &str, quality: Quality, network: bool| {
        let kind = Kind::Knob { knob, value: value.to_owned() };
        all.push(Setting { name: format!("{knob} = {value}"), kind, quality, network });
    };
    if network && table {
        knob("motion", "network", exact, true);
    }
    for k in KNOBS {
        for value in &k.values[1..] {
            let mut quality = exact;
            let matters = match k.name {
                "interpolation" | "table_step" => table,
                "network" => network,
                "nonrigid" => scene.nonrigid.is_some(),
                "sh_degree" => value.parse().is_ok_and(|d: u32| d < scene.gaussians.sh_degree),
                _ => true,
            };
            if matters && k.set(&mut quality, value).is_some() {
                // Half weights are only read where the network runs.
                knob(k.name, value, quality, k.name == "network");
            }
        }
    }
    all
}

/// Combinations that the single knobs suggest: starting from the definition, the change that costs the least error for the
/// time that it saves is added, again and again; a knob that is turned further keeps its later value.
pub(super) fn combinations(measured: &[Measured]) -> Vec<Setting> {
    let Some(exact) = measured.first() else { return Vec::new() };
    let time = exact.ms();
    let mut steps: Vec<(f64, f64, &'static str, &str)> = measured
        .iter()
        .filter_map(|m| {
            let Kind::Knob { knob, value } = &m.setting.kind else { return None };
            let saved = time - m.ms();
            let added = (m.error.rmse.powi(2) - exact.error.rmse.powi(2)).max(0.0);
            (saved > WORTH * time && !m.setting.network).then_some((added / saved, added, *knob, value.as_str()))
        })
        .collect();
    steps.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut quality = Quality::EXACT;
    let mut largest: Vec<(&str, f64)> = Vec::new();
    let (mut all, mut predicted) = (Vec::new(), 0.0);
    for (_, added, knob, value) in steps {
        // A finer value of a knob that is turned further already would take a step back.
        match largest.iter_mut().find(|(name, _)| *name == knob) {
            Some((_, before)) if *before >= added => continue,
            Some((_, before)) => *before = added,
            None => largest.push((knob, added)),
        }
        predicted += added;
        if predicted > WORST {
            break;
        }
        if quality.set(knob, value).is_ok() {
            let name = quality.describe().replace("exact, ", "");
            all.push(Setting { name, kind: Kind::Combination, quality, network: false });
        }
    }
    // The first one is a knob alone.
    if !all.is_empty() {
        all.remove(0);
    }
    all
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use engine::scene::synthetic::{moving_scene, random_scene};

    use super::*;

    #[test]
    fn knobs_that_cannot_matter_are_left_out() {
        let names = |scene: &Scene| alone(scene).into_iter().map(|s| s.name).collect::<Vec<_>>();
        let still = names(&random_scene(10, 1, 1));
        assert!(still[..3] == ["exact", "high", "fast"]);
        assert!(still.contains(&"sh_degree = 0".into()) && !still.contains(&"sh_degree = 1".into()));
        assert!(!still.iter().any(|n| n.starts_with("table_step") || n.starts_with("network")));
        let moving = names(&moving_scene(10, 2, 5, 1, false));
        assert!(moving.contains(&"table_step = 16".into()) && moving.contains(&"interpolation = geodesic".into()));
    }

    #[test]
    fn combinations_add_the_cheapest_error_first_and_never_turn_a_knob_back() {
        let knob = |knob: &'static str, value: &str, ms: f64, rmse: f64| {
            let mut m = Measured::for_tests("x", ms, rmse);
            m.setting.kind = Kind::Knob { knob, value: value.into() };
            m
        };
        let measured = [
            Measured::for_tests("exact", 10.0, 0.0),
            knob("depth_bits", "16", 8.0, 1e-4),
            knob("sh", "f16", 9.99, 1e-6),
            knob("alpha_cut", "1/64", 5.0, 1e-2),
            knob("alpha_cut", "1/128", 6.0, 1e-3),
            knob("resolution", "0.5", 11.0, 1e-1),
        ];
        let names: Vec<String> = combinations(&measured).into_iter().map(|s| s.name).collect();
        assert_eq!(names, ["depth_bits=16, alpha_cut=1/128", "depth_bits=16, alpha_cut=1/64"]);
    }
}
