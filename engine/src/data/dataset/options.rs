//! What a user may decide about a data set.

use serde::{Deserialize, Serialize};

use super::DatasetKind;
use crate::data::pixels::MaskColour;

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

/// Which pixels of masks take part in training.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MaskRule {
    /// White ones for nerfstudio and COLMAP, whose programs mean it so; all of other data, where masks say what moves.
    #[default]
    Auto,
    /// All: masks are for measuring only.
    All,
    /// White ones.
    White,
    /// Black ones.
    Black,
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
    /// Which pixels of masks take part in training.
    pub masks: MaskRule,
}

impl MaskRule {
    /// The colour that takes part, in data of this format; `None`: masks are not looked at.
    pub(super) fn used(self, kind: DatasetKind) -> Option<MaskColour> {
        match (self, kind) {
            (Self::White, _) | (Self::Auto, DatasetKind::Nerfstudio | DatasetKind::Colmap) => Some(MaskColour::White),
            (Self::Black, _) => Some(MaskColour::Black),
            (Self::All | Self::Auto, _) => None,
        }
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_are_used_where_their_programs_mean_them_so() {
        let used = |kind| MaskRule::Auto.used(kind);
        assert_eq!([DatasetKind::Nerfstudio, DatasetKind::Colmap].map(used), [Some(MaskColour::White); 2]);
        assert_eq!([DatasetKind::Blender, DatasetKind::NerfDs, DatasetKind::Nerfies].map(used), [None; 3]);
        let asked = [MaskRule::All, MaskRule::White, MaskRule::Black].map(|rule| rule.used(DatasetKind::Colmap));
        assert_eq!(asked, [None, Some(MaskColour::White), Some(MaskColour::Black)]);
    }
}
