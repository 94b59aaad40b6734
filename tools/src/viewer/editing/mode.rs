//! What the edit mode shows and what it is about to do: plain data.

use glam::{DVec2, DVec3};

use super::gesture::{Gesture, Kind};

/// What a click or a drag with the left button does.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) enum Tool {
    /// A click selects what moves together; a drag turns the camera.
    #[default]
    Superpoint,
    /// A click selects a Gaussian; a drag turns the camera.
    Gaussian,
    Rectangle,
    Lasso,
}

impl Tool {
    pub(crate) const ALL: [(Self, &'static str, &'static str); 4] = [
        (Self::Superpoint, "part", "click: what moves together"),
        (Self::Gaussian, "Gaussian", "click: one Gaussian"),
        (Self::Rectangle, "rect", "drag a rectangle (B)"),
        (Self::Lasso, "lasso", "drag around it (L)"),
    ];

    /// Whether drags with the left button are its own.
    pub(crate) fn takes_drags(self) -> bool {
        matches!(self, Self::Rectangle | Self::Lasso)
    }
}

/// How deep picks go.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) enum Reach {
    #[default]
    Surface,
    Depth,
    Through,
}

/// When a change holds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) enum Holds {
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
pub(crate) struct Name {
    pub(crate) name: String,
    pub(crate) count: usize,
    pub(crate) hidden: bool,
    pub(crate) locked: bool,
}

/// What is asked of the editor.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Ask {
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
pub(crate) struct Form {
    /// How deep picks go behind the surface, world units.
    pub(crate) depth: f64,
    /// Pixels off one rigid motion.
    pub(crate) similar: f64,
    pub(crate) grow: f64,
    pub(crate) center: [f64; 3],
    pub(crate) radius: f64,
    pub(crate) opacity: f64,
    pub(crate) size: f64,
    pub(crate) color: [f32; 3],
    pub(crate) within: f64,
    pub(crate) floaters: f64,
    /// First and last time, and the way there and back.
    pub(crate) during: [f64; 3],
    pub(crate) tint: [f32; 3],
    pub(crate) gain: f64,
    pub(crate) name: String,
    pub(crate) merge: String,
    /// Where the model is saved.
    pub(crate) file: String,
    /// Commands that are typed.
    pub(crate) command: String,
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
pub(crate) struct Frame {
    /// Pixels.
    pub(crate) size: [u32; 2],
    /// Pixels per point of the interface.
    pub(crate) scale: f64,
}

/// The edit mode.
#[derive(Debug, Clone)]
pub(crate) struct EditMode {
    pub(crate) on: bool,
    pub(crate) tool: Tool,
    pub(crate) reach: Reach,
    /// A click goes on to what moves alike.
    pub(crate) goes_on: bool,
    pub(crate) holds: Holds,
    /// Which handles are shown.
    pub(crate) handles: Kind,
    pub(crate) gesture: Option<Gesture>,
    /// Corners of the rectangle, or the line of the lasso, that is being dragged, pixels.
    pub(crate) drawn: Vec<DVec2>,
    pub(crate) form: Form,
    pub(crate) frame: Frame,
    /// Groups of commands that were done, then those that were undone, the next one first.
    pub(crate) list: Vec<String>,
    pub(crate) done: usize,
    pub(crate) unsaved: bool,
    pub(crate) names: Vec<Name>,
    pub(crate) selected: usize,
    pub(crate) hidden: usize,
    pub(crate) locked: usize,
    /// Some of what is selected: indices, and where they are at the time shown.
    pub(crate) sample: Vec<usize>,
    pub(crate) placed: Vec<DVec3>,
    /// Time of [`Self::placed`]; none when it is to be made anew.
    pub(crate) placed_at: Option<f64>,
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
    pub(crate) fn center(&self) -> Option<DVec3> {
        let count = self.placed.len();
        (count > 0).then(|| self.placed.iter().sum::<DVec3>() / count as f64)
    }

    /// Ends what is being dragged or typed.
    pub(crate) fn rest(&mut self) {
        self.gesture = None;
        self.drawn.clear();
    }
}
