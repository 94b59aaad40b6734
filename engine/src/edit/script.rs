//! The language of edits: one command per line, or several with `;` between them; `#` begins a comment.
//!
//! [`parse`] makes [`Command`]s of a text and says line and column of a mistake; [`crate::edit::Session`] carries them out.

mod list;
mod parse;
mod reader;

use glam::DVec3;

use super::select::{Criterion, Depth, Likeness};
use super::{Recolor, Window};
use crate::error::Error;
use crate::scene::Camera;

pub use list::{EditList, ListedEdit};
pub use parse::parse;

/// Where a command or a word begins, both counted from 1; columns are characters.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Place {
    /// Line.
    pub line: usize,
    /// Column.
    pub column: usize,
}

/// A mistake in a script.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ScriptError {
    /// Where.
    pub place: Place,
    /// What stands there.
    pub found: String,
    /// What could.
    pub expected: String,
}

impl ScriptError {
    /// The same as the engine's error; `source` names the script.
    pub fn named(self, source: &str) -> Error {
        let Place { line, column } = self.place;
        Error::usage(format!("{source}: line {line}, column {column}"), self.found, self.expected)
    }
}

/// A command of a script.
#[derive(Debug, Clone, PartialEq)]
pub struct Command {
    /// Where it begins.
    pub place: Place,
    /// Its words, one blank between them; [`parse`] makes the same of them.
    pub text: String,
    /// What it does.
    pub action: Action,
}

/// What a selection does to the one before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// `select`: takes its place.
    Replace,
    /// `add`.
    Add,
    /// `subtract`.
    Subtract,
    /// `intersect`.
    Intersect,
}

/// What is selected.
#[derive(Debug, Clone, PartialEq)]
pub enum Term {
    /// By a property.
    Criterion(Criterion),
    /// Nothing.
    None,
    /// A selection that was given this name.
    Named(String),
    /// What is seen at a place of the image: x and y.
    Click([Coordinate; 2]),
    /// What is seen in a rectangle of pixels.
    Rectangle([f64; 4]),
    /// What is seen within a line around pixels.
    Lasso(Vec<[f64; 2]>),
}

/// Where along a side of an image, from the left or the top.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Coordinate {
    /// Pixels.
    Pixels(f64),
    /// A share of the side, in percent.
    Percent(f64),
}

impl Coordinate {
    /// In pixels, along a side of `size` pixels.
    pub(crate) fn pixels(self, size: u32) -> f64 {
        match self {
            Self::Pixels(pixels) => pixels,
            Self::Percent(percent) => 0.01 * percent * f64::from(size),
        }
    }
}

impl Term {
    /// Whether it looks through a camera.
    pub(crate) fn is_pick(&self) -> bool {
        matches!(self, Self::Click(_) | Self::Rectangle(_) | Self::Lasso(_))
    }
}

/// What can be seen and selected: of the selection, of what has a name, or (to show and to unlock) of everything.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Mark {
    /// Is no longer seen, and so not selected.
    Hide(Option<String>),
    /// Nothing but the selection is seen.
    Isolate,
    /// Is seen again.
    Show(Option<String>),
    /// Can no longer be selected.
    Lock(Option<String>),
    /// Can be selected again.
    Unlock(Option<String>),
}

/// What a rigid change or a scale does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Change {
    /// By this vector, world units.
    Move(DVec3),
    /// Around this axis, by radians.
    Rotate(DVec3, f64),
    /// By factors along the axes.
    Scale(DVec3),
}

/// What stays where it is in a turn or a scale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pivot {
    /// The mean of the selection's centres.
    Center,
    /// A point, world units.
    Point(DVec3),
}

/// In which frame a change holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Frame {
    /// The world's.
    World,
    /// That of the superpoint with most of the selection's Gaussians.
    Part,
    /// That of this superpoint.
    Superpoint(usize),
}

/// Another time for the selection.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Retime {
    /// Always as at this time.
    Freeze(f64),
    /// Later by this.
    Shift(f64),
    /// This many times as long, from the scene's first time.
    Stretch(f64),
    /// Backwards within the scene's range.
    Reverse,
    /// Between these times again and again.
    Loop(f64, f64),
}

/// What a command does.
#[derive(Debug, Clone, PartialEq)]
pub enum Action {
    /// Changes the selection.
    Select {
        /// How.
        mode: Mode,
        /// To what.
        term: Term,
        /// How deep a pick goes.
        depth: Depth,
        /// Through which camera of the data set.
        view: Option<usize>,
        /// At which time.
        time: Option<f64>,
        /// And what moves like it.
        similar: Option<Likeness>,
    },
    /// Selects all others.
    Invert,
    /// Selects what is within a distance, too, at a time.
    Grow(f64, Option<f64>),
    /// Gives the selection a name.
    Name(String),
    /// Hides, locks, or takes that back.
    Mark(Mark),
    /// Moves, turns or scales.
    Change {
        /// What.
        change: Change,
        /// About what.
        pivot: Pivot,
        /// In which frame.
        frame: Frame,
        /// Time of frame and pivot.
        time: Option<f64>,
        /// For a while only.
        during: Option<Window>,
    },
    /// Takes the selection away.
    Delete,
    /// Takes all others away.
    Keep,
    /// Adds a copy, which is then selected.
    Duplicate,
    /// Changes colours.
    Recolor(Recolor),
    /// Changes time.
    Retime(Retime),
    /// Adds another model, which is then selected.
    Merge {
        /// Its file.
        file: String,
        /// Where its origin comes to be, world units.
        at: DVec3,
        /// Turned around an axis, radians.
        rotate: (DVec3, f64),
        /// Scaled by this.
        scale: f64,
        /// Its time t becomes `[0]` + `[1]`·t.
        time: [f64; 2],
    },
    /// The camera of later picks.
    Camera(Box<Camera>),
}

impl Action {
    /// Whether it may change the scene, and not selections alone.
    pub fn changes_scene(&self) -> bool {
        !matches!(
            self,
            Self::Select { .. } | Self::Invert | Self::Grow(..) | Self::Name(_) | Self::Mark(_) | Self::Camera(_)
        )
    }
}
