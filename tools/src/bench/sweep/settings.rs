//! Which settings a sweep tries.

use engine::render::Quality;
use engine::render::quality::KNOBS;
use engine::scene::{MotionSource, Scene};
use serde::Serialize;

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
    let table = scene.deformation.key_times().len() > 1;
    let network = scene.deformation.network().is_some();
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
                "nonrigid" => scene.deformation.nonrigid().is_some(),
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use engine::scene::synthetic::{moving_scene, random_scene};

    use super::*;

    #[test]
    fn knobs_that_cannot_matter_are_left_out() {
        let names = |scene: &Scene| alone(scene).into_iter().map(|s| s.name).collect::<Vec<_>>();
        let still = names(&random_scene(10, 1, 1));
        assert!(still[..2] == ["exact", "high"]);
        assert!(still.contains(&"sh_degree = 0".into()) && !still.contains(&"sh_degree = 1".into()));
        assert!(!still.iter().any(|n| n.starts_with("table_step") || n.starts_with("network")));
        let moving = names(&moving_scene(10, 2, 5, 1, false));
        assert!(moving.contains(&"table_step = 16".into()) && moving.contains(&"interpolation = geodesic".into()));
    }
}
