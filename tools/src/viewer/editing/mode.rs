//! What the edit mode shows and what it is about to do: plain data.

use glam::{DVec2, DVec3};

use super::gesture::{Gesture, Kind};

/// What a click or a drag with the left button does.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(in crate::viewer) enum Tool {
    /// A click selects what moves together; a drag turns the camera.
    #[default]
    Superpoint,
    /// A click selects a Gaussian; a drag turns the camera.
    Gaussian,
    Rectangle,
    Lasso,
}

impl Tool {
    pub(in crate::viewer) const ALL: [(Self, &'static str, &'static str); 4] = [
        (Self::Superpoint, "part", "click: what moves together"),
        (Self::Gaussian, "Gaussian", "click: one Gaussian"),
        (Self::Rectangle, "rect", "drag a rectangle (B)"),
        (Self::Lasso, "lasso", "drag around it (L)"),
    ];

    /// Whether drags with the left button are its own.
    pub(in crate::viewer) fn takes_drags(self) -> bool {
        matches!(self, Self::Rectangle | Self::Lasso)
    }
}

/// How deep picks go.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(in crate::viewer) enum Reach {
    #[default]
    Surface,
    Depth,
    Through,
}

/// When a change holds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(in crate::viewer) enum Holds {
    /// In the world at all times.
    #[default]
    Always,
    /// Along with the selection's motion, as asked for at this time.
    Part,
    /// For a while.
    During,
}

/// A selection with a name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::viewer) struct Name {
    pub(in crate::viewer) name: String,
    pub(in crate::viewer) count: usize,
    pub(in crate::viewer) hidden: bool,
    pub(in crate::viewer) locked: bool,
}

/// What is asked of the editor.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::viewer) enum Ask {
    /// Begins or ends the edit mode.
    Toggle,
    /// Commands of the language of edits, undone together.
    Run(String),
    Undo,
    Redo,
    Save,
}

/// Fields of the panel.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::viewer) struct Form {
    /// How deep picks go behind the surface, world units.
    pub(in crate::viewer) depth: f64,
    /// Pixels off one rigid motion.
    pub(in crate::viewer) similar: f64,
    pub(in crate::viewer) grow: f64,
    pub(in crate::viewer) center: [f64; 3],
    pub(in crate::viewer) radius: f64,
    pub(in crate::viewer) opacity: f64,
    pub(in crate::viewer) size: f64,
    pub(in crate::viewer) color: [f32; 3],
    pub(in crate::viewer) within: f64,
    pub(in crate::viewer) floaters: f64,
    /// First and last time, and the way there and back.
    pub(in crate::viewer) during: [f64; 3],
    pub(in crate::viewer) tint: [f32; 3],
    pub(in crate::viewer) gain: f64,
    pub(in crate::viewer) name: String,
    pub(in crate::viewer) merge: String,
    /// Where the model is saved.
    pub(in crate::viewer) file: String,
    /// Commands that are typed.
    pub(in crate::viewer) command: String,
}

impl Default for Form {
    fn default() -> Self {
        Self {
            depth: 0.1,
            similar: 1.5,
            grow: 0.02,
            center: [0.0; 3],
            radius: 0.5,
            opacity: 0.1,
            size: 0.1,
            color: [0.7, 0.3, 0.2],
            within: 0.2,
            floaters: 0.5,
            during: [0.25, 0.75, 0.1],
            tint: [1.0, 0.5, 0.0],
            gain: 1.0,
            name: String::new(),
            merge: String::new(),
            file: String::new(),
            command: String::new(),
        }
    }
}

/// Window that pixels are of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::viewer) struct Frame {
    /// Pixels.
    pub(in crate::viewer) size: [u32; 2],
    /// Pixels per point of the interface.
    pub(in crate::viewer) scale: f64,
}

/// The edit mode.
#[derive(Debug, Clone)]
pub(in crate::viewer) struct EditMode {
    pub(in crate::viewer) on: bool,
    pub(in crate::viewer) tool: Tool,
    pub(in crate::viewer) reach: Reach,
    /// A click goes on to what moves alike.
    pub(in crate::viewer) goes_on: bool,
    pub(in crate::viewer) holds: Holds,
    /// Which handles are shown.
    pub(in crate::viewer) handles: Kind,
    pub(in crate::viewer) gesture: Option<Gesture>,
    /// Corners of the rectangle, or the line of the lasso, that is being dragged, pixels.
    pub(in crate::viewer) drawn: Vec<DVec2>,
    pub(in crate::viewer) form: Form,
    pub(in crate::viewer) frame: Frame,
    /// Groups of commands that were done, then those that were undone, the next one first.
    pub(in crate::viewer) list: Vec<String>,
    pub(in crate::viewer) done: usize,
    pub(in crate::viewer) unsaved: bool,
    pub(in crate::viewer) names: Vec<Name>,
    pub(in crate::viewer) selected: usize,
    pub(in crate::viewer) hidden: usize,
    pub(in crate::viewer) locked: usize,
    /// Some of what is selected: indices, and where they are at the time shown.
    pub(in crate::viewer) sample: Vec<usize>,
    pub(in crate::viewer) placed: Vec<DVec3>,
    /// Time of [`Self::placed`]; none when it is to be made anew.
    pub(in crate::viewer) placed_at: Option<f64>,
}

impl Default for EditMode {
    fn default() -> Self {
        Self {
            on: false,
            tool: Tool::default(),
            reach: Reach::default(),
            goes_on: false,
            holds: Holds::default(),
            handles: Kind::default(),
            gesture: None,
            drawn: Vec::new(),
            form: Form::default(),
            frame: Frame { size: [1, 1], scale: 1.0 },
            list: Vec::new(),
            done: 0,
            unsaved: false,
            names: Vec::new(),
            selected: 0,
            hidden: 0,
            locked: 0,
            sample: Vec::new(),
            placed: Vec::new(),
            placed_at: None,
        }
    }
}

impl EditMode {
    /// About where the selection's centre is, world units; `None` of nothing.
    pub(in crate::viewer) fn center(&self) -> Option<DVec3> {
        let count = self.placed.len();
        (count > 0).then(|| self.placed.iter().sum::<DVec3>() / count as f64)
    }

    /// Ends what is being dragged or typed.
    pub(in crate::viewer) fn rest(&mut self) {
        self.gesture = None;
        self.drawn.clear();
    }
}
