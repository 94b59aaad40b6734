//! The list of edits that were applied, as TOML: what a model was made with, and a script that makes it again.

use std::path::Path;

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::scene::Camera;

/// Value of `format`.
const FORMAT: &str = "spgs edits";
/// Value of `version`.
const VERSION: u32 = 1;

/// Edits with all that they depend on beside the model and the files that they name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EditList {
    format: String,
    version: u32,
    /// Largest displacement that re-made poses may cause, pixels.
    pub bound_px: f64,
    /// The edits, in order.
    #[serde(default, rename = "edit")]
    pub edits: Vec<ListedEdit>,
    #[serde(default, rename = "camera")]
    cameras: Vec<ListedCamera>,
}

/// An edit, and what it came to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ListedEdit {
    /// In the language of scripts.
    pub command: String,
    /// Gaussians selected after it.
    #[serde(default)]
    pub selected: usize,
    /// Gaussians that it touched.
    #[serde(default)]
    pub touched: usize,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ListedCamera {
    name: String,
    size: [u32; 2],
    focal: [f64; 2],
    center: [f64; 2],
    /// World to camera, row by row.
    rotation: [f64; 9],
    position: [f64; 3],
    time: f64,
}

impl EditList {
    /// A list.
    pub fn new(bound_px: f64, edits: Vec<ListedEdit>, cameras: &[Camera]) -> Self {
        let listed = |c: &Camera| ListedCamera {
            name: c.name.clone(),
            size: [c.width, c.height],
            focal: [c.fx, c.fy],
            center: [c.cx, c.cy],
            rotation: c.rotation.transpose().to_cols_array(),
            position: c.position.to_array(),
            time: c.time,
        };
        let cameras = cameras.iter().map(listed).collect();
        Self { format: FORMAT.into(), version: VERSION, bound_px, edits, cameras }
    }

    /// The cameras that views are numbers of.
    pub fn cameras(&self) -> Vec<Camera> {
        let camera = |c: &ListedCamera| Camera {
            name: c.name.clone(),
            width: c.size[0],
            height: c.size[1],
            fx: c.focal[0],
            fy: c.focal[1],
            cx: c.center[0],
            cy: c.center[1],
            rotation: DMat3::from_cols_array(&c.rotation).transpose(),
            position: DVec3::from_array(c.position),
            time: c.time,
        };
        self.cameras.iter().map(camera).collect()
    }

    /// As text.
    ///
    /// # Errors
    /// [`Error::Usage`] for what TOML cannot hold.
    pub fn to_text(&self) -> Result<String> {
        let text = toml::to_string(self).map_err(|e| Error::usage("edit list", e.to_string(), "what TOML can hold"))?;
        Ok(format!(
            "# Edits that were applied, in order. They make the same model again: spgs edit IN OUT --script THIS\n{text}"
        ))
    }

    /// Reads what [`Self::to_text`] wrote; `path` names it in errors.
    ///
    /// # Errors
    /// [`Error::Corrupt`] with line and column.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let list: Self = toml::from_str(text).map_err(|e| {
            let before = text.get(..e.span().map_or(0, |span| span.start)).unwrap_or(text);
            let column = before.lines().last().filter(|_| !before.ends_with('\n')).map_or(0, |l| l.chars().count()) + 1;
            let at = format!("line {}, column {column}", before.matches('\n').count() + 1);
            Error::corrupt(path, at, e.message(), "a list of edits")
        })?;
        let fine = list.format == FORMAT && list.version == VERSION && list.bound_px > 0.0;
        if fine && list.cameras.iter().all(|c| c.size[0] > 0 && c.size[1] > 0) {
            return Ok(list);
        }
        let found = format!("format \"{}\", version {}, bound {} px", list.format, list.version, list.bound_px);
        let expected = format!("\"{FORMAT}\", {VERSION}, a bound above 0, and cameras with pixels");
        Err(Error::corrupt(path, "line 1, column 1", found, expected))
    }
}
