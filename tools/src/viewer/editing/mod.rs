//! The edit mode: the pointer and keys become commands of the language of edits, which a [`engine::edit::History`] carries out.
//! Nothing here changes a scene by itself, so the list of commands makes the same model again.

pub(super) mod editor;
pub(super) mod follow;
pub(super) mod gesture;
pub(super) mod gizmo;
pub(super) mod input;
pub(super) mod mode;
pub(super) mod overlay;
pub(super) mod panel;
mod requests;
pub(super) mod words;
