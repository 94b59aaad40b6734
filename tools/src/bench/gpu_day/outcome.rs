//! What came of a step.

use std::path::Path;
use std::time::Duration;

use engine::error::{Error, Result};
use serde::Serialize;
use serde_json::{Value, json};

use crate::bench::prediction::{Kind, Predicted};
use crate::report::files::{to_json, write_text};
use crate::report::page::Page;

/// A measured figure and the predicted one.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Figure {
    pub(super) what: String,
    pub(super) unit: &'static str,
    pub(super) measured: Option<f64>,
    pub(super) predicted: Option<f64>,
    /// The GPU of the prediction, and whether that is the device that was measured.
    pub(super) predicted_on: Option<&'static str>,
    pub(super) same_device: bool,
}

impl Figure {
    /// One that nobody predicts.
    pub(super) fn new(what: impl Into<String>, unit: &'static str, measured: f64) -> Self {
        Self {
            what: what.into(),
            unit,
            measured: Some(measured),
            predicted: None,
            predicted_on: None,
            same_device: false,
        }
    }
}

/// Measured figures of a frame or step, by name: on the device, one at a time, per second.
#[derive(Debug, Clone, Copy)]
pub(super) struct Measured {
    pub(super) device_ms: Option<f64>,
    pub(super) one_at_a_time_ms: f64,
    pub(super) per_second: f64,
}

/// The figures of a frame or step, beside those of the device's own prediction, or of the first GPU's where the device has none.
pub(super) fn figures(predicted: Option<&Predicted>, kind: Kind, device: &str, m: Measured) -> Vec<Figure> {
    let (beside, same_device) = predicted.and_then(|p| p.beside(device)).unzip();
    let same_device = same_device.unwrap_or(false);
    let figure = |what: &str, unit, measured: Option<f64>, predicted: Option<f64>| Figure {
        what: what.into(),
        unit,
        measured,
        predicted,
        predicted_on: beside.map(|g| g.gpu),
        same_device,
    };
    let (one, rate) = match kind {
        Kind::Frame => ("frame, one at a time", ("frames in flight", "FPS")),
        Kind::Step => ("step, with the host", ("steps", "steps/s")),
    };
    vec![
        figure(rate.0, rate.1, Some(m.per_second), beside.map(|g| g.per_second)),
        figure(one, "ms", Some(m.one_at_a_time_ms), beside.map(|g| g.one_at_a_time_ms)),
        figure("on the device", "ms", m.device_ms, beside.map(|g| g.device_ms)),
    ]
}

/// Writes a step's section into the page.
type Section = Box<dyn FnOnce(&mut Page) -> Result<()>>;

/// A step that has run.
pub(super) struct Outcome {
    /// Its file.
    pub(super) record: Value,
    pub(super) figures: Vec<Figure>,
    /// What was left out or made smaller, and why.
    pub(super) reduced: Vec<String>,
    /// It ran to its end, and found something wrong.
    pub(super) failure: Option<Error>,
    pub(super) section: Section,
}

/// What a step gives back.
pub(super) enum Done {
    /// It has run.
    Ran(Box<Outcome>),
    /// It could not, for this reason.
    Skipped(String),
}

/// How a step ended.
#[derive(Debug)]
pub(super) enum State {
    Done,
    Skipped(String),
    Failed(Error),
}

impl State {
    /// `done`, `skipped`, `failed`.
    pub(super) fn name(&self) -> &'static str {
        match self {
            Self::Done => "done",
            Self::Skipped(_) => "skipped",
            Self::Failed(_) => "failed",
        }
    }

    /// Why, if there is something to say.
    pub(super) fn reason(&self) -> Option<String> {
        match self {
            Self::Done => None,
            Self::Skipped(why) => Some(why.clone()),
            Self::Failed(error) => Some(error.to_string()),
        }
    }
}

/// A step after its end.
pub(super) struct Finished {
    name: &'static str,
    pub(super) title: &'static str,
    pub(super) budget: Duration,
    pub(super) elapsed: Duration,
    pub(super) state: State,
    pub(super) figures: Vec<Figure>,
    pub(super) reduced: Vec<String>,
    record: Option<Value>,
    section: Option<Section>,
}

impl Finished {
    pub(super) fn new(
        (name, title): (&'static str, &'static str),
        budget: Duration,
        elapsed: Duration,
        done: Result<Done>,
    ) -> Self {
        let empty = |state| Self {
            name,
            title,
            budget,
            elapsed,
            state,
            figures: Vec::new(),
            reduced: Vec::new(),
            record: None,
            section: None,
        };
        match done {
            Err(error) => empty(State::Failed(error)),
            Ok(Done::Skipped(why)) => empty(State::Skipped(why)),
            Ok(Done::Ran(o)) => Self {
                figures: o.figures,
                reduced: o.reduced,
                record: Some(o.record),
                section: Some(o.section),
                ..empty(o.failure.map_or(State::Done, State::Failed))
            },
        }
    }

    fn file(&self) -> Option<String> {
        self.record.as_ref().map(|_| format!("{}.json", self.name))
    }

    /// Writes its file, if it has one.
    pub(super) fn write(&self, folder: &Path) -> Result<()> {
        let Some((file, record)) = self.file().zip(self.record.as_ref()) else { return Ok(()) };
        write_text(&folder.join(file), &(to_json(record)? + "\n"))
    }

    /// For the summary.
    pub(super) fn summary(&self) -> Value {
        json!({
            "name": self.name,
            "title": self.title,
            "state": self.state.name(),
            "reason": self.state.reason(),
            "reduced": self.reduced,
            "budget_s": self.budget.as_secs_f64(),
            "seconds": self.elapsed.as_secs_f64(),
            "file": self.file(),
            "figures": self.figures,
        })
    }

    /// For the terminal, as soon as it has ended.
    pub(super) fn line(&self) -> String {
        format!("{:8} {:32} {:6.1} s", self.state.name(), self.title, self.elapsed.as_secs_f64())
    }

    /// Its section of the page.
    pub(super) fn take_section(&mut self) -> Option<Section> {
        self.section.take()
    }
}
