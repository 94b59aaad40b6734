//! A model that is edited: its history, and what the window shows of it.

use std::path::{Path, PathBuf};

use engine::edit::script::parse;
use engine::edit::{BOUND_PX, Entry, History, Session, Step};
use engine::error::{Error, Result};
use engine::scene::{Camera, Scene};

use super::follow::SAMPLES;
use super::mode::{EditMode, Name};
use crate::cli::edited::{self, Target};
use crate::report::files::write_text;

/// A model and what was done to it.
#[derive(Debug)]
pub(crate) struct Editor {
    history: History,
    /// The file that was opened.
    source: PathBuf,
    /// Groups of commands that the saved model has; none when it has one that was undone since and is gone.
    saved: Option<usize>,
}

impl Editor {
    pub(crate) fn new(scene: &Scene, cameras: &[Camera], source: &Path) -> Self {
        let session = Session::new(scene.clone(), cameras.to_vec(), BOUND_PX);
        Self { history: History::new(session), source: source.to_owned(), saved: Some(0) }
    }

    pub(crate) fn scene(&self) -> &Scene {
        &self.history.session().scene
    }

    /// Carries out commands, all or none. Returns whether the scene is another, and what else there is to know.
    ///
    /// # Errors
    /// Those of the commands.
    pub(crate) fn run(&mut self, commands: &str) -> Result<(bool, Vec<String>)> {
        let commands = parse(commands).map_err(|e| e.named("edit"))?;
        self.history.run(&commands)?;
        self.saved = self.saved.filter(|saved| *saved < self.history.done().len());
        let Some(entry) = self.history.done().last() else { return Ok((false, Vec::new())) };
        let notes = entry.steps.iter().flat_map(|step| step.touched.notes.iter().cloned());
        Ok((entry.changes_scene(), notes.collect()))
    }

    /// Takes back what was done last; whether the scene is another, `None` at the beginning.
    pub(crate) fn undo(&mut self) -> Option<bool> {
        self.history.undo().map(Entry::changes_scene)
    }

    /// Does again what was undone last.
    pub(crate) fn redo(&mut self) -> Option<bool> {
        self.history.redo().map(Entry::changes_scene)
    }

    /// Whether a change of the scene is in no file.
    pub(crate) fn is_unsaved(&self) -> bool {
        let done = self.history.done();
        self.saved != Some(done.len()) && (self.saved != Some(0) || done.iter().any(Entry::changes_scene))
    }

    /// Writes the model, and the list of edits beside it.
    ///
    /// # Errors
    /// The opened file itself, which the list begins with; those of writing.
    pub(crate) fn save(&mut self, path: &Path) -> Result<Target> {
        let is_source = |p: &Path| {
            p == self.source || p.canonicalize().is_ok_and(|p| self.source.canonicalize().is_ok_and(|s| s == p))
        };
        if is_source(path) {
            let expected = "another name: the list of edits begins with the file that was opened";
            return Err(Error::usage("save", path.display().to_string(), expected));
        }
        let target = Target::new(path)?;
        let session = self.history.session();
        target.write(&mut session.finished(), &self.steps(), session.bound_px, session.cameras_used())?;
        self.saved = Some(self.history.done().len());
        Ok(target)
    }

    /// Writes the list alone.
    ///
    /// # Errors
    /// Those of writing.
    pub(crate) fn save_list(&self, path: &Path) -> Result<()> {
        let session = self.history.session();
        write_text(path, &edited::list(&self.steps(), session.bound_px, session.cameras_used())?)
    }

    fn steps(&self) -> Vec<Step> {
        self.history.steps().cloned().collect()
    }

    /// What is selected and what is hidden.
    pub(crate) fn marks(&self) -> (Option<&[bool]>, Option<&[bool]>) {
        let session = self.history.session();
        (session.selected(), session.hidden())
    }

    /// Says in the window's data how things are.
    pub(crate) fn tell(&self, edit: &mut EditMode) {
        let session = self.history.session();
        let text = |entry: &Entry| {
            let commands = entry.steps.iter().map(|step| step.command.as_str());
            let seen: Vec<&str> = commands.filter(|text| !text.starts_with("camera ")).collect();
            seen.join("; ")
        };
        edit.list = self.history.done().iter().chain(self.history.undone().iter().rev()).map(text).collect();
        edit.done = self.history.done().len();
        edit.unsaved = self.is_unsaved();
        let all = |of: &[bool], mask: Option<&[bool]>| {
            let mut members = of.iter().enumerate().filter(|(_, m)| **m).peekable();
            members.peek().is_some() && members.all(|(i, _)| mask.is_some_and(|mask| mask[i]))
        };
        let name = |(name, mask): (&str, &[bool])| Name {
            name: name.to_owned(),
            count: count(Some(mask)),
            hidden: all(mask, session.hidden()),
            locked: all(mask, session.locked()),
        };
        edit.names = session.named().map(name).collect();
        (edit.hidden, edit.locked) = (count(session.hidden()), count(session.locked()));
        let selected = session.selected().unwrap_or_default();
        edit.selected = count(Some(selected));
        let step = edit.selected.div_ceil(SAMPLES).max(1);
        edit.sample = (0..selected.len()).filter(|&i| selected[i]).step_by(step).collect();
        edit.placed_at = None;
    }
}

fn count(mask: Option<&[bool]>) -> usize {
    mask.unwrap_or_default().iter().filter(|m| **m).count()
}

/// Where the edited model goes unless somebody says otherwise: beside the one that was opened.
pub(crate) fn default_target(source: &Path) -> PathBuf {
    if source.is_dir() {
        return source.join("edited.safetensors");
    }
    let stem = source.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    source.with_file_name(format!("{stem}.edited.safetensors"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use engine::scene::synthetic::moving_scene;

    use super::*;

    #[test]
    fn what_is_saved_is_what_the_list_makes() {
        let folder = tempfile::tempdir().unwrap();
        let source = folder.path().join("scene.safetensors");
        let scene = moving_scene(200, 5, 4, 3, false);
        engine::file::save(&source, &scene).unwrap();
        let mut editor = Editor::new(&scene, &[], &source);
        assert!(!editor.is_unsaved());
        assert!(!editor.run("select superpoints 1").unwrap().0);
        assert!(!editor.is_unsaved(), "a selection is no change");
        assert!(editor.run("name arm; move 0,0.5,0 frame part time 0.3").unwrap().0);
        assert!(editor.run("delete all").is_err() && editor.run("select superpoints 99").is_err());
        assert!(editor.is_unsaved());
        assert!(editor.save(&source).unwrap_err().to_string().contains("another name"));
        let target = editor.save(&default_target(&source)).unwrap();
        assert!(!editor.is_unsaved() && target.model.ends_with("scene.edited.safetensors"));
        let list = std::fs::read_to_string(&target.list).unwrap();
        assert!(list.contains("frame part time 0.3"), "{list}");

        let mut edit = EditMode::default();
        editor.run("hide named arm").unwrap();
        editor.tell(&mut edit);
        assert!(edit.names.len() == 1 && edit.names[0].hidden && !edit.names[0].locked && edit.hidden > 0);
        assert_eq!((edit.list.len(), edit.done, edit.selected), (3, 3, 0));
        editor.undo();
        editor.undo();
        editor.tell(&mut edit);
        assert_eq!((edit.list.len(), edit.done), (3, 1));
        assert!(editor.is_unsaved() && editor.scene().gaussians == scene.gaussians);
        editor.redo();
        assert!(!editor.is_unsaved());
        // What was saved cannot be reached any more.
        editor.undo();
        editor.run("select all; scale 2").unwrap();
        assert!(editor.is_unsaved());
    }
}
