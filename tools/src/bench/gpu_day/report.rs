//! All steps as text and on one page.

use engine::error::Result;
use serde_json::Value;

use super::outcome::{Figure, Finished, State};
use crate::bench::prediction;
use crate::report::page::{Align, Page, Standing, Table};

/// One row per figure: measured, predicted, how far apart.
fn figures(steps: &[Finished]) -> Table {
    let (l, r) = (Align::Left, Align::Right);
    let columns =
        [("step", l), ("figure", l), ("measured", r), ("predicted", r), ("on", l), ("measured / predicted", r)];
    let mut table = Table::new(&columns);
    for step in steps {
        for f in &step.figures {
            let both = f.measured.zip(f.predicted).filter(|(_, p)| f.same_device && *p > 0.0);
            let quotient = both.map(|(m, p)| format!("{:.2}", m / p));
            table.row([
                step.title.to_owned(),
                f.what.clone(),
                number(f.measured, f),
                number(f.predicted, f),
                f.predicted_on.unwrap_or("–").to_owned(),
                quotient.unwrap_or("–".into()),
            ]);
        }
    }
    table
}

fn number(value: Option<f64>, figure: &Figure) -> String {
    let Some(value) = value else { return "–".into() };
    let digits = if value.abs() >= 100.0 { 1 } else { 3 };
    format!("{value:.digits$} {}", figure.unit).trim_end().to_owned()
}

/// One row per step.
fn states(steps: &[Finished]) -> Table {
    let (l, r) = (Align::Left, Align::Right);
    let mut table = Table::new(&[("step", l), ("state", l), ("s", r), ("of s", r), ("what to know", l)]);
    for step in steps {
        let standing = match step.state {
            State::Done => Standing::Good,
            State::Skipped(_) => Standing::Plain,
            State::Failed(_) => Standing::Bad,
        };
        let mut known: Vec<String> = step.state.reason().into_iter().collect();
        known.extend(step.reduced.iter().cloned());
        table.marked(
            standing,
            [
                step.title.to_owned(),
                step.state.name().to_owned(),
                format!("{:.1}", step.elapsed.as_secs_f64()),
                format!("{:.1}", step.budget.as_secs_f64()),
                known.join("; "),
            ],
        );
    }
    table
}

/// For the terminal.
pub(super) fn text(device: &str, steps: &[Finished]) -> String {
    format!("\ndevice  {device}\n{}", figures(steps).text().trim_end())
}

/// What must not be overlooked, even when quiet.
pub(super) fn loud(steps: &[Finished]) {
    for step in steps {
        let title = step.title;
        match &step.state {
            State::Done => {}
            State::Skipped(why) => log::warn!("SKIPPED {title}: {why}"),
            State::Failed(error) => log::error!("FAILED {title}: {error}"),
        }
        step.reduced.iter().for_each(|what| log::warn!("reduced, {title}: {what}"));
    }
}

/// The page.
pub(super) fn html(record: &Value, mut steps: Vec<Finished>) -> Result<String> {
    let mut page = Page::new("spgs bench gpu-day");
    page.provenance(record);
    page.heading("Measured beside predicted");
    page.text(
        "Predictions are of a model whose inputs are in the files of the steps. They are for the GPU in the column \"on\", and for what \
         was run here, which may be smaller than on that GPU: only where it is the device of this page is there a quotient.",
    );
    page.table(&figures(&steps));
    page.heading("Steps");
    page.table(&states(&steps));
    for step in &mut steps {
        page.heading(step.title);
        if let Some(why) = step.state.reason() {
            page.note(&format!("{}: {why}", step.state.name()));
        }
        step.reduced.iter().for_each(|what| page.note(&format!("reduced: {what}")));
        if let Some(section) = step.take_section() {
            section(&mut page)?;
        }
    }
    page.heading("What the predictions assume");
    prediction::report::model(&mut page);
    Ok(page.finish())
}
