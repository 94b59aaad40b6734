//! What is asked of the editor, done between two frames.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;

use engine::error::Result;

use super::editor::{Editor, default_target};
use super::follow::follow;
use super::mode::{Ask, EditMode};
use crate::viewer::program::Viewer;
use crate::viewer::record::free_name;

impl Viewer {
    /// Does what is asked of the editor. What is refused is said in the window.
    ///
    /// # Errors
    /// The device's.
    pub(crate) fn edit(&mut self, ask: Ask) -> Result<()> {
        if ask == Ask::Toggle {
            self.toggle_editing();
            return self.show_edits(false);
        }
        let Some(editor) = &mut self.editor else { return Ok(()) };
        let state = &mut self.state;
        let changed = match ask {
            Ask::Run(commands) => match editor.run(&commands) {
                Ok((changed, notes)) => {
                    notes.into_iter().for_each(|note| state.say(note, false));
                    changed
                }
                Err(error) => {
                    state.say(error.to_string(), true);
                    return Ok(());
                }
            },
            Ask::Undo | Ask::Redo => {
                let (moved, end) = match ask {
                    Ask::Undo => (editor.undo(), "nothing to undo"),
                    _ => (editor.redo(), "nothing to redo"),
                };
                let Some(changed) = moved else {
                    state.say(end, false);
                    return Ok(());
                };
                changed
            }
            Ask::Save | Ask::Toggle => {
                match editor.save(Path::new(&state.edit.form.file)) {
                    Ok(target) => {
                        state.say(format!("saved {} and {}", target.model.display(), target.list.display()), false);
                    }
                    Err(error) => state.say(error.to_string(), true),
                }
                false
            }
        };
        self.show_edits(changed)
    }

    fn toggle_editing(&mut self) {
        let Some(gui) = &self.gui else { return };
        let state = &mut self.state;
        state.edit.rest();
        state.selection = None;
        if state.edit.on {
            state.edit.on = false;
            return;
        }
        if gui.model.path.as_os_str().is_empty() {
            state.say("no model: drop one into the window", false);
            return;
        }
        // What is edited is not read anew.
        if let Some(stop) = self.watching.take() {
            stop.store(true, Ordering::Relaxed);
        }
        state.edit.on = true;
        if self.editor.is_none() {
            self.editor = Some(Editor::new(&gui.model.scene, &state.cameras, &gui.model.path));
            state.edit.form.file = default_target(&gui.model.path).display().to_string();
        }
    }

    /// Shows the edited scene, if it is another, and what is selected and hidden.
    ///
    /// # Errors
    /// The device's.
    pub(crate) fn show_edits(&mut self, changed: bool) -> Result<()> {
        let (Some(gui), Some(editor)) = (&mut self.gui, &self.editor) else { return Ok(()) };
        editor.tell(&mut self.state.edit);
        if changed {
            gui.change_scene(Arc::new(editor.scene().clone()), &mut self.state)?;
        }
        follow(&mut self.state, &gui.model)?;
        let edit = &mut self.state.edit;
        match (edit.center(), &mut edit.gesture) {
            // It may have begun before.
            (Some(center), Some(gesture)) => gesture.center = center,
            (None, _) => edit.rest(),
            _ => {}
        }
        let (selected, hidden) = editor.marks();
        gui.model.mark(selected.filter(|_| self.state.edit.on), hidden);
        Ok(())
    }

    /// Ends the editing of a model that goes. A list of edits that are in no file is written; returns where.
    ///
    /// # Errors
    /// Those of writing.
    pub(crate) fn leave_editing(&mut self) -> Result<Option<PathBuf>> {
        self.state.edit = EditMode { form: std::mem::take(&mut self.state.edit.form), ..EditMode::default() };
        let Some(editor) = self.editor.take().filter(Editor::is_unsaved) else { return Ok(None) };
        let path = free_name(&self.args.out, "unsaved", "edits.toml")?;
        editor.save_list(&path)?;
        Ok(Some(path))
    }
}
