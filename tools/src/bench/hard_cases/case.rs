//! A case, what it found, and what that is held against.

use std::time::Instant;

use engine::error::{Error, Result};
use engine::gpu::Gpu;
use serde::Serialize;

/// The twenty cases of the published list, and what comes beside them.
pub const GROUPS: [&str; 22] = [
    "needle Gaussians",
    "tiny and huge scales",
    "quaternions and poison",
    "camera inside, near plane, z → 0",
    "equal depths and order",
    "depth range 1e-3 … 1e5",
    "faint and opaque layers",
    "wide and off-centre views",
    "half and double resolution",
    "rotation across π, |θ| → 0",
    "times outside, repeated, single",
    "superpoints: empty, one, ties, M > N",
    "world offset 1e6",
    "crowded tile, overflow, nothing visible",
    "gradients of every parameter",
    "run-to-run bits",
    "long-run drift",
    "popping",
    "flicker of static pixels",
    "other renderers' conventions",
    "poison in every field",
    "image sizes and counts",
];

/// What the cases need.
#[derive(Debug)]
pub struct Context<'a> {
    /// The device.
    pub gpu: &'a Gpu,
    /// Runs whose bits are compared (case 16).
    pub runs: u32,
    /// Frames of the drift test (case 17).
    pub frames: u32,
}

/// A number and what it is held against.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Check {
    /// What is measured, with its unit.
    pub what: String,
    /// The value; `f64::MAX` where something was not finite.
    pub value: f64,
    /// What it must be.
    pub bound: Bound,
}

/// What a value must be.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Bound {
    /// Not more.
    AtMost(f64),
    /// Not less.
    AtLeast(f64),
    /// Just that.
    Exactly(f64),
    /// Anything finite: it describes the method or the input, not the device's arithmetic.
    Shown,
}

impl Check {
    /// A check of an error.
    pub fn at_most(what: impl Into<String>, value: f64, bound: f64) -> Self {
        Self { what: what.into(), value, bound: Bound::AtMost(bound) }
    }

    /// A check of a quality.
    pub fn at_least(what: impl Into<String>, value: f64, bound: f64) -> Self {
        Self { what: what.into(), value, bound: Bound::AtLeast(bound) }
    }

    /// A check of a count.
    pub fn exactly(what: impl Into<String>, value: usize, expected: usize) -> Self {
        Self { what: what.into(), value: value as f64, bound: Bound::Exactly(expected as f64) }
    }

    /// A fact without a bound.
    pub fn shown(what: impl Into<String>, value: f64) -> Self {
        Self { what: what.into(), value, bound: Bound::Shown }
    }

    /// Whether the value is finite.
    pub fn is_finite(&self) -> bool {
        self.value.is_finite() && self.value.abs() < f64::MAX
    }

    /// Whether the bound holds; phrased so that NaN fails.
    pub fn passes(&self) -> bool {
        match self.bound {
            Bound::AtMost(bound) => self.value <= bound,
            Bound::AtLeast(bound) => self.value >= bound,
            Bound::Exactly(expected) => self.value == expected,
            Bound::Shown => self.value.is_finite(),
        }
    }
}

/// What a case found.
#[derive(Debug, Clone, Default)]
pub struct Outcome {
    /// What the f64 truth says, in words.
    pub truth: String,
    /// The numbers, most telling first.
    pub checks: Vec<Check>,
}

type Judge = Box<dyn Fn(&Context<'_>) -> Result<Outcome>>;

/// One case.
pub struct Case {
    /// Place in [`GROUPS`], from 1.
    pub number: usize,
    /// Short name, unique.
    pub name: String,
    /// The input in one sentence.
    pub input: String,
    judge: Judge,
}

impl std::fmt::Debug for Case {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Case").field(&self.number).field(&self.name).finish()
    }
}

/// A judged case: a row of the table.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// Place in [`GROUPS`], from 1.
    pub number: usize,
    /// Name of the case.
    pub name: String,
    /// The input in one sentence.
    pub input: String,
    /// What the f64 truth says.
    pub truth: String,
    /// The numbers.
    pub checks: Vec<Check>,
    /// Why it could not be judged, if so.
    pub error: Option<String>,
    /// Whether all bounds hold.
    pub pass: bool,
    /// Whether all numbers are finite.
    pub finite: bool,
    /// Host time of everything, truth included, milliseconds.
    pub ms: f64,
}

impl Case {
    pub(super) fn new(
        number: usize,
        name: impl Into<String>,
        input: impl Into<String>,
        judge: impl Fn(&Context<'_>) -> Result<Outcome> + 'static,
    ) -> Self {
        Self { number, name: name.into(), input: input.into(), judge: Box::new(judge) }
    }

    /// Judges the case. An error of the engine is a row that fails.
    ///
    /// # Errors
    /// `DeviceLost`: nothing after it can be believed.
    pub fn run(&self, context: &Context<'_>) -> Result<Row> {
        let start = Instant::now();
        let judged = (self.judge)(context);
        let ms = start.elapsed().as_secs_f64() * 1e3;
        let (outcome, error, finite) = match judged {
            Ok(outcome) => {
                let finite = outcome.checks.iter().all(Check::is_finite);
                (outcome, None, finite)
            }
            Err(error @ Error::DeviceLost { .. }) => return Err(error),
            Err(error) => (Outcome::default(), Some(error.to_string()), !matches!(error, Error::NonFinite { .. })),
        };
        Ok(Row {
            number: self.number,
            name: self.name.clone(),
            input: self.input.clone(),
            truth: outcome.truth,
            pass: error.is_none() && outcome.checks.iter().all(Check::passes),
            finite,
            checks: outcome.checks,
            error,
            ms,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_fail_on_nan_and_on_the_wrong_side() {
        assert!(Check::at_most("x", 1.0, 1.0).passes() && !Check::at_most("x", 1.1, 1.0).passes());
        assert!(Check::at_least("x", 1.0, 1.0).passes() && !Check::at_least("x", 0.9, 1.0).passes());
        assert!(Check::exactly("x", 3, 3).passes() && !Check::exactly("x", 3, 4).passes());
        for check in
            [Check::at_most("x", f64::NAN, 1.0), Check::at_least("x", f64::NAN, 1.0), Check::shown("x", f64::NAN)]
        {
            assert!(!check.passes() && !check.is_finite());
        }
        assert!(!Check::shown("x", f64::MAX).is_finite());
    }
}
