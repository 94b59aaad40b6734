//! Where the selection is at the time that is shown.

use engine::edit::centers_of;
use engine::error::Result;

use crate::viewer::model::Model;
use crate::viewer::state::State;

/// Gaussians of a selection that are drawn as dots at most.
pub(crate) const SAMPLES: usize = 2000;

/// Moves what stands for the selection to the time that is shown.
///
/// # Errors
/// Those of placing Gaussians.
pub(crate) fn follow(state: &mut State, model: &Model) -> Result<()> {
    let (time, edit) = (state.timeline.time, &mut state.edit);
    if !edit.on || edit.placed_at == Some(time) {
        return Ok(());
    }
    edit.placed = centers_of(&model.scene, edit.sample.clone(), time)?;
    edit.placed_at = Some(time);
    Ok(())
}
