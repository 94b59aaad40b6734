//! What a user may decide about a data set.

use serde::{Deserialize, Serialize};

/// Which frames are for training and which for test.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SplitRule {
    /// The format's own rule; what it was is among [`super::Dataset::decisions`].
    #[default]
    Auto,
    /// The lists that the data set gives (`train_ids` and `val_ids`, `train_filenames`, …).
    Lists,
    /// Frames 0, 4, 8… train, 2, 6, 10… test (HyperNeRF's interpolation split).
    Interpolation,
    /// Every n-th frame, from the first, is a test frame (8: LLFF's hold-out).
    Hold(usize),
    /// All frames train, none test.
    All,
}

/// How frames get their times.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TimeRule {
    /// As the data set says; what that was is among [`super::Dataset::decisions`].
    #[default]
    Auto,
    /// All frames at time 0: the scene is trained as one that stands still.
    Static,
}

/// Options of [`super::load`]; the default follows the data set.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DatasetOptions {
    /// Pictures are this many times smaller than the camera files say. Default: 2 for Nerfies-like scenes other than
    /// `NeRF*` (the published results' size), else 1.
    pub downscale: Option<u32>,
    /// Which frames are for training.
    pub split: SplitRule,
    /// How frames get their times.
    pub time: TimeRule,
    /// Nerfies-like scenes: camera positions and points as stored, without `scene.json`'s centre and scale.
    pub raw_world_units: bool,
}

impl SplitRule {
    /// Whether frame `i` trains (`Some(true)`), tests (`Some(false)`) or is left out, for the rules that count.
    pub(super) fn place(self, i: usize) -> Option<bool> {
        match self {
            Self::Interpolation if i.is_multiple_of(4) => Some(true),
            Self::Interpolation if i % 4 == 2 => Some(false),
            Self::Interpolation => None,
            Self::Hold(n) => Some(!i.is_multiple_of(n.max(1))),
            Self::Auto | Self::Lists | Self::All => Some(true),
        }
    }

    /// Training and test frames, for the rules that count.
    pub(super) fn divide<T>(self, all: Vec<T>) -> (Vec<T>, Vec<T>) {
        let (mut train, mut test) = (Vec::new(), Vec::new());
        for (i, item) in all.into_iter().enumerate() {
            match self.place(i) {
                Some(true) => train.push(item),
                Some(false) => test.push(item),
                None => {}
            }
        }
        (train, test)
    }

    /// The rule in words.
    pub(super) fn describe(self) -> String {
        match self {
            Self::Auto | Self::Lists => "split: by the data set's lists".into(),
            Self::Interpolation => "split: frames 0, 4, 8… train, 2, 6, 10… test".into(),
            Self::Hold(n) => format!("split: every {n}th frame, from the first, is a test frame"),
            Self::All => "split: all frames train".into(),
        }
    }
}
