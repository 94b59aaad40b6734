//! Where an edited model goes, with the list of its edits beside it.

use std::path::{Path, PathBuf};

use engine::edit::Step;
use engine::edit::script::{EditList, ListedEdit};
use engine::error::{Error, Result};
use engine::file::{self, Output, durable};
use engine::scene::{Camera, Scene};

use crate::report::files::write_text;

/// The files that are written.
#[derive(Debug)]
pub struct Target {
    /// The model.
    pub model: PathBuf,
    /// The list of edits.
    pub list: PathBuf,
    kind: Output,
}

impl Target {
    /// Looks whether both files can be written, before any work.
    ///
    /// # Errors
    /// A name that says no format; files that cannot be written there.
    pub fn new(path: &Path) -> Result<Self> {
        let kind = Output::of_name(path)?;
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let stem = &name[..name.len() - kind.ending().len()];
        let list = path.with_file_name(format!("{stem}.edits.toml"));
        durable::check_target(path)?;
        durable::check_target(&list)?;
        Ok(Self { model: path.to_owned(), list, kind })
    }

    /// Writes a scene, with what was done to it, and what was done beside it. Returns what the format cannot hold.
    ///
    /// # Errors
    /// Formats that leave motion out: Gaussians alone are not where the edits have put them. Those of writing.
    pub fn write(&self, scene: &mut Scene, steps: &[Step], bound_px: f64, cameras: &[Camera]) -> Result<Vec<String>> {
        if !self.kind.holds_motion() && scene.deformation.moves() {
            let expected = "a .safetensors file; `spgs convert --time T` makes one of a moment of it";
            return Err(Error::usage(format!("output {}", self.model.display()), "a format without motion", expected));
        }
        let list = list(steps, bound_px, cameras)?;
        if self.kind.holds_motion() {
            note(scene, steps);
        }
        let dropped = file::save_as(&self.model, scene, self.kind)?;
        write_text(&self.list, &list)?;
        Ok(dropped)
    }
}

/// A list of edits, as it is written.
///
/// # Errors
/// What TOML cannot hold.
pub fn list(steps: &[Step], bound_px: f64, cameras: &[Camera]) -> Result<String> {
    EditList::new(bound_px, steps.iter().map(listed).collect(), cameras).to_text()
}

/// The edits in the model's metadata, after those that were there.
fn note(scene: &mut Scene, steps: &[Step]) {
    let all: Vec<&str> = steps.iter().map(|step| step.command.as_str()).collect();
    if all.is_empty() {
        return;
    }
    let noted = scene.metadata.entry("edits".into()).or_default();
    *noted = [noted.as_str()].into_iter().filter(|text| !text.is_empty()).chain(all).collect::<Vec<_>>().join("\n");
}

fn listed(step: &Step) -> ListedEdit {
    ListedEdit { command: step.command.clone(), selected: step.selected, touched: step.touched.gaussians }
}
