//! `camera/ID.json` and `scene.json`.

use std::path::Path;

use glam::{DMat3, DVec3};
use serde_json::Value;

use super::object;
use crate::data::dataset::DatasetOptions;
use crate::data::frame::Frame;
use crate::data::json::{self, finite, show};
use crate::data::lens::{Distortion, Lens};
use crate::data::{MAX_IMAGE_SIDE, transforms};
use crate::error::{Error, Result};

/// A JSON file whose values are named in errors.
struct Reader<'a> {
    path: &'a Path,
    top: json::Keys,
}

impl Reader<'_> {
    fn corrupt(&self, key: &str, found: String, expected: &str) -> Error {
        Error::corrupt(self.path, format!("key `{key}`"), found, expected)
    }

    fn numbers<const N: usize>(&self, key: &str) -> Result<Option<[f64; N]>> {
        let Some(value) = self.top.get(key) else { return Ok(None) };
        let mut numbers = [0.0; N];
        let expected = format!("{N} finite numbers");
        let list = value.as_array().filter(|list| list.len() == N);
        let list = list.ok_or_else(|| self.corrupt(key, show(value), &expected))?;
        for (number, value) in numbers.iter_mut().zip(list) {
            *number = finite(value).ok_or_else(|| self.corrupt(key, show(value), &expected))?;
        }
        Ok(Some(numbers))
    }

    fn number(&self, key: &str) -> Result<Option<f64>> {
        let Some(value) = self.top.get(key) else { return Ok(None) };
        finite(value).map(Some).ok_or_else(|| self.corrupt(key, show(value), "a finite number"))
    }

    fn needed<T>(&self, key: &str, value: Option<T>, expected: &str) -> Result<T> {
        value.ok_or_else(|| self.corrupt(key, "nothing".into(), expected))
    }

    fn positive(&self, key: &str, value: f64) -> Result<f64> {
        let usable = value > 1.0e-9 && value < 1.0e9;
        if usable { Ok(value) } else { Err(self.corrupt(key, value.to_string(), "a number above 0")) }
    }
}

/// One camera in world units; its time is set by the caller.
pub(super) fn read(path: &Path, id: &str) -> Result<Frame> {
    let reader = Reader { path, top: object(path)? };
    let rotation = rotation(&reader)?;
    let position = reader.numbers("position")?;
    let position = DVec3::from_array(reader.needed("position", position, "3 numbers")?);
    let focal = reader.number("focal_length")?;
    let focal = reader.positive("focal_length", reader.needed("focal_length", focal, "a number")?)?;
    let aspect = reader.positive("pixel_aspect_ratio", reader.number("pixel_aspect_ratio")?.unwrap_or(1.0))?;
    let size = size(&reader)?;
    let centre = size.map(|side| 0.5 * f64::from(side));
    let [k1, k2, k3] = reader.numbers("radial_distortion")?.unwrap_or_default();
    // Old files name it `tangential`.
    let tangential = match reader.numbers("tangential_distortion")? {
        Some(p) => p,
        None => reader.numbers("tangential")?.unwrap_or_default(),
    };
    let lens = Lens {
        focal: [focal, focal * aspect],
        principal: reader.numbers("principal_point")?.unwrap_or(centre),
        skew: reader.number("skew")?.unwrap_or(0.0),
        distortion: Distortion::brown([k1, k2, k3, 0.0], [0.0; 3], tangential),
    };
    Ok(Frame { name: id.into(), lens, size, rotation, position, time: 0.0, mask: None })
}

fn rotation(reader: &Reader<'_>) -> Result<DMat3> {
    const KEY: &str = "orientation";
    let expected = "a 3x3 rotation, world to camera";
    let value = reader.needed(KEY, reader.top.get(KEY), expected)?;
    let row = |r: usize| -> Option<DVec3> {
        let row = value.as_array().filter(|rows| rows.len() == 3)?[r].as_array().filter(|row| row.len() == 3)?;
        Some(DVec3::new(finite(&row[0])?, finite(&row[1])?, finite(&row[2])?))
    };
    let (Some(x), Some(y), Some(z)) = (row(0), row(1), row(2)) else {
        return Err(reader.corrupt(KEY, show(value), expected));
    };
    let (rotation, scale) =
        transforms::rigid(DMat3::from_cols(x, y, z)).map_err(|found| reader.corrupt(KEY, found, expected))?;
    if (scale - 1.0).abs() > 1.0e-3 {
        return Err(reader.corrupt(KEY, format!("a scale of {scale:.6}"), expected));
    }
    Ok(rotation.transpose())
}

fn size(reader: &Reader<'_>) -> Result<[u32; 2]> {
    const KEY: &str = "image_size";
    let expected = format!("width and height, 1 to {MAX_IMAGE_SIDE}");
    let sides: [f64; 2] = reader.needed(KEY, reader.numbers(KEY)?, &expected)?;
    if sides.iter().all(|s| s.fract() == 0.0 && *s >= 1.0 && *s <= f64::from(MAX_IMAGE_SIDE)) {
        return Ok(sides.map(|s| s as u32));
    }
    Err(reader.corrupt(KEY, reader.top.get(KEY).map(Value::to_string).unwrap_or_default(), &expected))
}

/// From world to scene units: (p − centre) · scale.
#[derive(Debug, Clone, Copy)]
pub(super) struct SceneUnits {
    centre: DVec3,
    scale: f64,
}

impl SceneUnits {
    pub(super) fn read(folder: &Path, options: &DatasetOptions, decisions: &mut Vec<String>) -> Result<Self> {
        let path = folder.join("scene.json");
        let world = Self { centre: DVec3::ZERO, scale: 1.0 };
        if options.raw_world_units {
            decisions.push("units: world units as stored, as asked for".into());
            return Ok(world);
        }
        if !path.is_file() {
            decisions.push("units: world units as stored (no scene.json)".into());
            return Ok(world);
        }
        let reader = Reader { path: &path, top: object(&path)? };
        let scale = reader.positive("scale", reader.needed("scale", reader.number("scale")?, "a number above 0")?)?;
        let centre = DVec3::from_array(reader.needed("center", reader.numbers("center")?, "3 numbers")?);
        let [x, y, z] = centre.to_array();
        decisions.push(format!("units: (world − [{x:.4}, {y:.4}, {z:.4}]) · {scale:.6} (scene.json)"));
        Ok(Self { centre, scale })
    }

    pub(super) fn apply(&self, p: DVec3) -> DVec3 {
        (p - self.centre) * self.scale
    }

    /// Back to world units.
    pub(super) fn world(&self, p: DVec3) -> DVec3 {
        p / self.scale + self.centre
    }
}
