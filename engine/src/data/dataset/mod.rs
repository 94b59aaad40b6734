//! Data sets: posed pictures with times, split for training and test, and points to start from.
//!
//! A folder's format is found by its files, in this order; the first that is there wins, so that a COLMAP model inside a
//! HyperNeRF scene does not take its place:
//!
//! | file | format |
//! |---|---|
//! | `transforms_train.json` | D-NeRF |
//! | `dataset.json` | Nerfies, HyperNeRF, NeRF-DS |
//! | `transforms.json` | nerfstudio, instant-ngp |
//! | `precomputed.json`, `poses_bounds.npy` | LLFF, nonrigid_nerf, NVIDIA Dynamic Scene |
//! | `cameras` and `images`, `.bin` or `.txt`, here or in `sparse/0` or `sparse` | COLMAP |

mod blender;
mod colmap;
mod llff;
mod nerfies;
mod options;
mod pictures;
mod views;

use std::path::Path;

use serde::Serialize;

use crate::data::CameraSet;
use crate::data::frame::Frame;
use crate::data::pixels::ImageSource;
use crate::error::{Error, Result};
use crate::scene::Camera;

pub use options::{DatasetOptions, MaskRule, SplitRule, TimeRule};

/// The format of a data set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DatasetKind {
    /// `transforms_{train,test,val}.json`.
    Blender,
    /// One `transforms.json`.
    Nerfstudio,
    /// Nerfies, HyperNeRF, DyCheck.
    Nerfies,
    /// The same with masks.
    NerfDs,
    /// `poses_bounds.npy`.
    Llff,
    /// `precomputed.json`.
    NonrigidNerf,
    /// `poses_bounds.npy` of the 12-camera rig.
    Nvidia,
    /// A COLMAP model and its photos.
    Colmap,
}

impl DatasetKind {
    /// Name for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Blender => "D-NeRF (transforms_*.json)",
            Self::Nerfstudio => "nerfstudio (transforms.json)",
            Self::Nerfies => "Nerfies / HyperNeRF (dataset.json)",
            Self::NerfDs => "NeRF-DS (dataset.json, resized_mask)",
            Self::Llff => "LLFF (poses_bounds.npy)",
            Self::NonrigidNerf => "nonrigid_nerf (precomputed.json)",
            Self::Nvidia => "NVIDIA Dynamic Scene (poses_bounds.npy, 12 cameras)",
            Self::Colmap => "COLMAP",
        }
    }
}

/// Coloured points to start Gaussians from, in world units; the two lists are equally long.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Points {
    /// `[n, 3]`.
    pub position: Vec<[f32; 3]>,
    /// `[n, 3]`, 8-bit RGB.
    pub colour: Vec<[u8; 3]>,
}

/// One picture with its camera.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// Name of the frame in the data set.
    pub name: String,
    /// Pinhole camera of the decoded picture: undistorted and scaled down.
    pub camera: Camera,
    /// Time of the frame; `camera.time` is the same.
    pub time: f64,
    /// Where the picture is and how it is decoded.
    pub image: ImageSource,
}

impl View {
    /// The same view of `factor` times fewer pixels a side, rounded; at least one.
    #[must_use]
    pub fn reduced(&self, factor: u32) -> Self {
        let size = views::scaled([self.camera.width, self.camera.height], factor);
        let image = ImageSource { size, ..self.image.clone() };
        Self { name: self.name.clone(), time: self.time, camera: self.camera.resized(size[0], size[1]), image }
    }
}

/// A data set ready for training.
#[derive(Debug, Clone, PartialEq)]
pub struct Dataset {
    /// Its format.
    pub kind: DatasetKind,
    /// Pictures to train on; at least one.
    pub train: Vec<View>,
    /// Pictures to measure with; may be empty.
    pub test: Vec<View>,
    /// Pictures held out beside the test split; often empty.
    pub val: Vec<View>,
    /// Points to start from, if the data set has some.
    pub points: Option<Points>,
    /// 1.1 × the largest distance of a training camera from the mean of their centres (`getNerfppNorm` of 3DGS).
    pub extent: f64,
    /// All training views have the same time: no motion can be learnt.
    pub is_static: bool,
    /// Smallest and largest time of the training views.
    pub time_range: [f64; 2],
    /// By how much the pictures are smaller than the camera files say.
    pub downscale: u32,
    /// What was found and decided, for the user to read; one line each.
    pub decisions: Vec<String>,
}

/// A data set before its pictures are looked at.
#[derive(Debug)]
struct Source {
    kind: DatasetKind,
    train: Vec<Posed>,
    test: Vec<Posed>,
    val: Vec<Posed>,
    points: Option<Points>,
    /// Downscale where the options name none.
    default_downscale: u32,
    decisions: Vec<String>,
}

/// A frame and its picture.
#[derive(Debug, Clone)]
struct Posed {
    frame: Frame,
    image: views::Stored,
}

/// Loads a data set from its folder. All pictures must be there, with the sizes that the cameras have; they are decoded
/// later ([`crate::data::ImageLoader`]).
///
/// # Errors
/// [`Error::Usage`] when no known format is found; [`Error::Corrupt`] naming file and place; [`Error::Io`] naming the
/// file.
pub fn load(path: &Path, options: &DatasetOptions) -> Result<Dataset> {
    let source = read(path, options)?;
    views::dataset(source, options)
}

fn read(path: &Path, options: &DatasetOptions) -> Result<Source> {
    let metadata = std::fs::metadata(path).map_err(|e| Error::io(path, "open", e))?;
    let has = |name: &str| path.join(name).is_file();
    if !metadata.is_dir() {
        return Err(Error::usage("data set", path.display().to_string(), "a folder"));
    }
    if has("transforms_train.json") {
        return blender::read_splits(path, options);
    }
    if has("dataset.json") {
        return nerfies::read(path, options);
    }
    if has("transforms.json") {
        return blender::read_single(path, options);
    }
    if let Some(file) = llff::file(path) {
        return llff::read(path, &file, options);
    }
    if let Some(model) = crate::data::colmap::find(path) {
        return colmap::read(path, &model, options);
    }
    Err(unknown(path))
}

/// Times of the images of a COLMAP model by the rules of its data set; names in natural order.
pub(super) fn colmap_times(folder: &Path, names: &[&str]) -> Result<Vec<f64>> {
    Ok(colmap::times(folder, names)?.0)
}

/// Whether [`cameras`] reads the folder: it holds a data set whose splits only this module knows.
pub(super) fn is_known(folder: &Path) -> bool {
    let has = |name: &str| folder.join(name).is_file();
    has("dataset.json") || llff::file(folder).is_some() || has("transforms.json") && !has("transforms_train.json")
}

/// The cameras of a split at the data set's default size, or at another; pictures need not be there. No split means
/// `test`, or `train` where that is empty.
pub(super) fn cameras(folder: &Path, split: Option<&str>, size_override: Option<[u32; 2]>) -> Result<CameraSet> {
    let source = read(folder, &DatasetOptions::default())?;
    let mut warnings = Vec::new();
    let posed: Vec<&Posed> = match split {
        None if source.test.is_empty() => {
            warnings.push(format!("{}: no test frames, using the training frames", folder.display()));
            source.train.iter().collect()
        }
        None | Some("test") => source.test.iter().collect(),
        Some("train") => source.train.iter().collect(),
        Some("val") => source.val.iter().collect(),
        Some("all") => source.train.iter().chain(&source.test).chain(&source.val).collect(),
        Some(other) => return Err(Error::usage("split of a data set", other, "train, test, val or all")),
    };
    if posed.is_empty() {
        let what = format!("cameras in {}", folder.display());
        return Err(Error::usage(what, format!("no frame in split `{}`", split.unwrap_or("test")), "at least one"));
    }
    let camera = |p: &&Posed| {
        let size = size_override.unwrap_or_else(|| views::scaled(p.frame.size, source.default_downscale));
        p.frame.pinhole().resized(size[0], size[1])
    };
    let cameras = posed.iter().map(camera).collect();
    Ok(CameraSet { cameras, warnings, source: folder.display().to_string() })
}

fn unknown(path: &Path) -> Error {
    let found = match std::fs::read_dir(path) {
        Err(e) => return Error::io(path, "list", e),
        Ok(entries) => {
            let mut names: Vec<String> = entries.flatten().filter_map(|e| e.file_name().into_string().ok()).collect();
            names.sort();
            if names.is_empty() { "an empty folder".into() } else { names[..names.len().min(8)].join(", ") }
        }
    };
    let expected = "transforms_train.json, dataset.json, transforms.json, poses_bounds.npy, precomputed.json or a COLMAP \
                    model (cameras and images, .bin or .txt, here or in sparse/0 or sparse)";
    Error::usage(format!("data set in {}", path.display()), found, expected)
}
