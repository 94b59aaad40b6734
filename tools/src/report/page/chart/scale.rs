//! A linear or logarithmic scale with ticks at 1, 2 and 5 times powers of ten.

use std::ops::Range;

use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};

/// Most ticks whatever there is room for.
const MAX_TICKS: usize = 12;

/// Values from `low` to `high`.
#[derive(Debug, Clone)]
pub(super) struct Scale {
    low: f64,
    high: f64,
    log: bool,
}

impl Scale {
    /// Holds `low` to `high` with a margin; any positive range when they are not finite.
    pub(super) fn around(low: f64, high: f64, log: bool) -> Self {
        let (low, high) = if low <= high { (low, high) } else { (1.0, 1.0) };
        if log {
            let margin = (0.05 * (high / low).ln()).max(0.05).exp();
            return Self { low: low / margin, high: high * margin, log };
        }
        let margin = (0.05 * (high - low)).max(1e-6 * high.abs()).max(1e-12);
        // A scale of amounts that starts near nothing starts at nothing.
        let start = if low >= 0.0 && low < 0.3 * high { 0.0 } else { low - margin };
        Self { low: start, high: high + margin, log }
    }

    /// Where a value lies: 0 at the low end, 1 at the high one.
    pub(super) fn position(&self, value: f64) -> f64 {
        if self.log {
            (value.max(f64::MIN_POSITIVE) / self.low).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        }
    }

    fn ticks(&self, most: usize) -> Vec<f64> {
        let most = most.clamp(2, MAX_TICKS);
        if self.log && self.high / self.low > 10.0 {
            return self.decades(most);
        }
        let step = round_up((self.high - self.low) / most as f64);
        let first = (self.low / step).ceil() as i64;
        let last = (self.high / step).floor() as i64;
        (first..=last.min(first.saturating_add(100)))
            .map(|i| i as f64 * step)
            .filter(|v| !self.log || *v > 0.0)
            .collect()
    }

    /// 1, 2, 5 per decade where there is room, else 1, else every k-th power of ten.
    fn decades(&self, most: usize) -> Vec<f64> {
        let (first, last) = (self.low.log10().floor() as i32, self.high.log10().ceil() as i32);
        let within = |v: &f64| *v >= self.low && *v <= self.high;
        let of = |factors: &[f64], every: i32| -> Vec<f64> {
            let powers = (first..=last).filter(|e| e.rem_euclid(every) == 0);
            powers.flat_map(|e| factors.iter().map(move |f| f * 10_f64.powi(e))).filter(within).collect()
        };
        let fine = of(&[1.0, 2.0, 5.0], 1);
        if fine.len() <= most {
            return fine;
        }
        (1..).map(|every| of(&[1.0], every)).find(|ticks| ticks.len() <= most).unwrap_or_default()
    }
}

/// The next of 1, 2, 5, 10, … times a power of ten.
fn round_up(step: f64) -> f64 {
    let power = 10_f64.powf(step.max(f64::MIN_POSITIVE).log10().floor());
    let factor = [1.0, 2.0, 5.0].into_iter().find(|f| f * power >= step * 0.999).unwrap_or(10.0);
    factor * power
}

impl Ranged for Scale {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let at = self.position(*value).clamp(-1.0, 2.0);
        limit.0 + (at * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        self.ticks(hint.bold_points())
    }

    fn range(&self) -> Range<f64> {
        self.low..self.high
    }
}

impl ValueFormatter<f64> for Scale {
    fn format(value: &f64) -> String {
        label(*value)
    }

    fn format_ext(&self, value: &f64) -> String {
        label(*value)
    }
}

/// `0`, `0.25`, `20`, `10k`, `2M`, `1e-6`.
fn label(value: f64) -> String {
    let short = |v: f64| {
        let text = format!("{v:.4}");
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    };
    match value.abs() {
        0.0 => "0".into(),
        a if !(9.9e-4..9.9e8).contains(&a) => format!("{value:.1e}").replace(".0e", "e"),
        a if a >= 9.9e5 => short(value / 1e6) + "M",
        a if a >= 9.9e3 => short(value / 1e3) + "k",
        _ => short(value),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(Scale::around(0.0, 1.0, false).ticks(6), [0.0, 0.2, 0.4, 0.6000000000000001, 0.8, 1.0]);
        assert_eq!(Scale::around(1e4, 1e6, true).ticks(10), [1e4, 2e4, 5e4, 1e5, 2e5, 5e5, 1e6]);
        assert_eq!(Scale::around(1e-9, 1e3, true).ticks(6), [1e-8, 1e-6, 1e-4, 1e-2, 1.0, 1e2]);
        assert!(Scale::around(40.0, 44.0, false).ticks(8).iter().all(|t| (39.0..45.0).contains(t)));
        assert!(Scale::around(2.0, 3.0, true).ticks(6).len() > 2, "a narrow logarithmic range has ticks too");
    }

    #[test]
    fn a_scale_of_one_value_or_none_is_not_empty() {
        for scale in [
            Scale::around(5.0, 5.0, false),
            Scale::around(5.0, 5.0, true),
            Scale::around(f64::INFINITY, f64::NEG_INFINITY, true),
        ] {
            assert!(scale.low < scale.high && !scale.ticks(6).is_empty(), "{scale:?}");
        }
    }

    #[test]
    fn labels_are_short() {
        for (value, text) in [
            (0.0, "0"),
            (0.25, "0.25"),
            (20.0, "20"),
            (1e4, "10k"),
            (2.5e6, "2.5M"),
            (1e-6, "1e-6"),
            (-3.0, "-3"),
            (1e9, "1e9"),
        ] {
            assert_eq!(label(value), text);
        }
    }
}
