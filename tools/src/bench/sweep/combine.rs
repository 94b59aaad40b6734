//! Which combinations of knobs are worth a try.

use engine::render::Quality;

use super::measured::Measured;
use super::settings::{Kind, Setting};

/// A knob must save this share of the exact time to be combined with others.
const WORTH: f64 = 0.02;

/// Combinations end at this mean square error: 30 dB.
const WORST: f64 = 1e-3;

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
    use super::*;

    #[test]
    fn combinations_add_the_cheapest_error_first_and_never_turn_a_knob_back() {
        let knob = |knob: &'static str, value: &str, ms: f64, rmse: f64| {
            let mut m = Measured::for_tests("x", ms, rmse);
            m.setting.kind = Kind::Knob { knob, value: value.into() };
            m
        };
        let measured = [
            Measured::for_tests("exact", 10.0, 0.0),
            knob("stop", "0.001", 8.0, 1e-4),
            knob("sh", "f16", 9.99, 1e-6),
            knob("alpha_cut", "1/64", 5.0, 1e-2),
            knob("alpha_cut", "1/128", 6.0, 1e-3),
            knob("resolution", "0.5", 11.0, 1e-1),
        ];
        let names: Vec<String> = combinations(&measured).into_iter().map(|s| s.name).collect();
        assert_eq!(names, ["alpha_cut=1/128, stop=0.001", "alpha_cut=1/64, stop=0.001"]);
    }
}
