//! Nerfies' layout, which HyperNeRF, NeRF-DS and DyCheck share (google/nerfies README and `camera.py`):
//!
//! - `dataset.json` {`ids`, `train_ids`, `val_ids`}; `metadata.json` {id: {`warp_id`, `time_id`?, …}};
//! - `camera/ID.json` {`orientation` world-to-camera, `position`, `focal_length`, `principal_point`, `skew`,
//!   `pixel_aspect_ratio`, `radial_distortion` (k1 k2 k3), `tangential_distortion` or `tangential` (p1 p2), `image_size`};
//! - `scene.json` {`scale`, `center`}: scene units are (world − centre) · scale; `points.npy` holds world units;
//! - `rgb/Kx/ID.png`, K times smaller than `image_size`; NeRF-DS adds `resized_mask/Kx`.

mod camera;
mod lists;
mod points;

use std::path::{Path, PathBuf};

use super::views::{self, Stored};
use super::{DatasetKind, DatasetOptions, Posed, Source};
use crate::data::json;
use crate::error::Result;

/// Extensions of pictures that are looked for.
const EXTENSIONS: [&str; 4] = ["png", "jpg", "jpeg", "JPG"];

pub(super) fn read(folder: &Path, options: &DatasetOptions) -> Result<Source> {
    let mut decisions = Vec::new();
    let lists = lists::read(folder, options, &mut decisions)?;
    let times = lists::times(folder, &lists, &mut decisions)?;
    let scene = camera::SceneUnits::read(folder, options, &mut decisions)?;
    let default_downscale = lists.default_downscale;
    let downscale = views::downscale(options, default_downscale)?;
    let levels = levels(folder);
    let factor = views::stored_factor(&levels, downscale);
    let stored = |id: &str| stored(folder, id, factor.unwrap_or(downscale));
    let posed = |id: &String| -> Result<Posed> {
        let mut frame = camera::read(&folder.join("camera").join(format!("{id}.json")), id)?;
        frame.time = times.of(id)?;
        frame.position = scene.apply(frame.position);
        Ok(Posed { frame, image: stored(id) })
    };
    let read = |ids: &[String]| ids.iter().map(posed).collect::<Result<Vec<_>>>();
    let (mut train, mut test) = (read(&lists.train)?, read(&lists.test)?);
    let points = points::read(folder, &scene, &mut train, &mut test, &mut decisions)?;
    let kind = if folder.join("resized_mask").is_dir() { DatasetKind::NerfDs } else { DatasetKind::Nerfies };
    if !levels.is_empty() {
        let names: Vec<String> = levels.iter().map(|k| format!("{k}x")).collect();
        decisions.push(format!("stored sizes: {} under rgb", names.join(", ")));
    }
    Ok(Source { kind, train, test, val: Vec::new(), points, default_downscale, decisions })
}

/// The `Kx` folders under `rgb`, ascending.
fn levels(folder: &Path) -> Vec<u32> {
    let Ok(entries) = std::fs::read_dir(folder.join("rgb")) else { return Vec::new() };
    let factor = |name: String| name.strip_suffix('x').and_then(|k| k.parse().ok()).filter(|&k| k > 0);
    let mut levels: Vec<u32> = entries.flatten().filter_map(|e| factor(e.file_name().into_string().ok()?)).collect();
    levels.sort_unstable();
    levels
}

fn stored(folder: &Path, id: &str, factor: u32) -> Stored {
    let level = format!("{factor}x");
    let pictures = folder.join("rgb").join(&level);
    let path = EXTENSIONS.map(|e| pictures.join(format!("{id}.{e}"))).into_iter().find(|p| p.is_file());
    let path = path.unwrap_or_else(|| pictures.join(format!("{id}.png")));
    // NeRF-DS writes masks as ID.png.png.
    let masks = folder.join("resized_mask").join(&level);
    let mask = [format!("{id}.png.png"), format!("{id}.png")].map(|name| masks.join(name));
    Stored { path, factor, mask: mask.into_iter().find(|p: &PathBuf| p.is_file()) }
}

/// The object that a file of the data set holds.
fn object(path: &Path) -> Result<json::Keys> {
    json::file(path, "a JSON file of a Nerfies data set")
}
