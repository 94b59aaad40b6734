//! What a data set holds, for people and as JSON.

use std::path::Path;

use engine::data::{Dataset, DatasetOptions, View, dataset};
use engine::error::Result;
use serde_json::json;

use crate::cli::output;

/// Loads a data set and prints what was found and decided.
pub(super) fn inspect(path: &Path, as_json: bool) -> Result<()> {
    let dataset = dataset::load(path, &DatasetOptions::default())?;
    if as_json {
        return output::json(&describe(&dataset));
    }
    output::line(&format!("{}: data set", path.display()));
    print_decisions(&dataset);
    Ok(())
}

/// One line for each of [`Dataset::decisions`].
fn print_decisions(dataset: &Dataset) {
    dataset.decisions.iter().for_each(|line| output::line(&format!("  {line}")));
}

fn describe(dataset: &Dataset) -> serde_json::Value {
    let split = |views: &[View]| {
        let view =
            |v: &View| json!({"name": v.name, "time": v.time, "width": v.camera.width, "height": v.camera.height});
        views.iter().map(view).collect::<Vec<_>>()
    };
    json!({
        "kind": dataset.kind,
        "train": split(&dataset.train),
        "test": split(&dataset.test),
        "val": split(&dataset.val),
        "points": dataset.points.as_ref().map_or(0, |p| p.position.len()),
        "extent": dataset.extent,
        "static": dataset.is_static,
        "time_range": dataset.time_range,
        "downscale": dataset.downscale,
        "decisions": dataset.decisions,
    })
}
