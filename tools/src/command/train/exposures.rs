//! What training found of each photo's exposure, in a file of its own: the model shows none of them.

use std::path::Path;

use engine::data::dataset::View;
use engine::error::Result;
use engine::train::exposure::EXPOSURE_WORDS;
use serde_json::json;

use crate::report::files;

/// Writes `exposures.json`, one affine map of colours per photo, and says how bright photos are beside the scene; nothing where photos
/// are taken as they are.
pub(super) fn write(out: &Path, photos: &[View], rows: Option<&[f32]>) -> Result<Option<String>> {
    let Some(rows) = rows else { return Ok(None) };
    let maps = rows.chunks_exact(EXPOSURE_WORDS).map(|row| [&row[..4], &row[4..8], &row[8..12]]);
    let list: Vec<_> = photos.iter().zip(maps.clone()).map(|(v, map)| json!({ "name": v.name, "map": map })).collect();
    files::write_text(&out.join("exposures.json"), &files::to_json(&json!({ "photos": list }))?)?;
    // What a mid-grey of the scene is in the photo.
    let grey = |map: [&[f32]; 3]| map.iter().map(|r| 0.5 * (r[0] + r[1] + r[2]) + r[3]).sum::<f32>() / 1.5;
    let shares: Vec<f32> = maps.map(grey).collect();
    let (least, most) = shares.iter().fold((f32::INFINITY, 0.0_f32), |(a, b), s| (a.min(*s), b.max(*s)));
    Ok(Some(format!(
        "exposures of {} photos in exposures.json: a mid-grey is {least:.3} to {most:.3} times as bright",
        shares.len()
    )))
}
