//! A scene follows new photos: how superpoints, cameras or both stand in photos that were never trained.
//!
//! [`follow`] takes photos in order of their times. For each time it renders the scene, compares, goes back on the GPU
//! ([`crate::train::photo_loss`]) and moves superpoints and cameras by Adam, in f64 on the host, from small photos to full ones:
//!
//! Σ L_photo + λ_A E_A + λ_v Σ_j (‖x_j − x̂_j‖² + ρ_j²‖log R_j R̂_jᵀ‖²)/u²
//!
//! - L: L1 + D-SSIM, times pixels. Poses change by tangents about each superpoint's current centre x.
//! - E_A: as rigid as possible, with weights and rest offsets from the motion of training ([`Coupling`]). What no pixel sees follows
//!   its neighbours by it alone.
//! - x̂, R̂: where the two key times before want the superpoints to go on to, for photos after the last key.
//!
//! A superpoint steps in the metric of its own block of Gauss–Newton's JᵀJ and of its coupling, at most by so many pixels of
//! the size that is looked at, and not further than Newton's step: directions that photos hardly tell (depth in a single one) do not
//! drift, and those that they tell are not slowed down.
//!
//! Where photos then fit well, rounds of Gauss–Newton with derivatives by differences of images go on to the end.

mod adam;
mod bodies;
mod coupling;
mod divide;
mod follow;
mod gauge;
mod gauss_newton;
mod information;
mod keys;
mod reseat;
mod sight;
mod solver;
mod uncertainty;
mod verdict;

pub use bodies::{Bodies, Stand};
pub use coupling::Coupling;
pub use divide::divide;
pub use follow::follow;
pub use keys::put;
pub use sight::{apart_px, project};
pub use uncertainty::Uncertainty;
pub use verdict::Verdict;

use serde::Serialize;

use crate::scene::{Camera, Scene};

/// What is to be found.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Solve {
    /// How the superpoints stand; cameras are right.
    #[default]
    Superpoints,
    /// Where each photo was taken from; the scene is right.
    Camera,
    /// Both. What could be either, a motion of the whole scene as one, is given to the cameras.
    Both,
}

/// How it is searched for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Options {
    /// What is to be found.
    pub solve: Solve,
    /// Time of the model whose poses a search begins with; otherwise those that it has at the photo's time.
    pub init: Option<f64>,
    /// Iterations per time, over all sizes of its photos.
    pub iterations: u32,
    /// Most rounds of Gauss–Newton after them, where photos fit well and superpoints alone are searched for.
    pub rounds: u32,
    /// λ_A. It is 30 times as large while photos are small, and less at the end where they fit well.
    pub coupling: f64,
    /// λ_v.
    pub smoothness: f64,
    /// λ of D-SSIM.
    pub lambda_dssim: f32,
    /// Colour behind everything.
    pub background: [f32; 3],
    /// Near plane, world units.
    pub near: f32,
    /// Whether the same bits come out on every run.
    pub deterministic: bool,
    /// Random images per photo for uncertainties; 0: none are made.
    pub probes: u32,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            solve: Solve::default(),
            init: None,
            iterations: 600,
            rounds: 8,
            coupling: 3.0,
            smoothness: 0.003,
            lambda_dssim: 0.2,
            background: [0.0; 3],
            near: 0.2,
            deterministic: false,
            probes: 32,
        }
    }
}

/// Where a search is.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Progress {
    /// Time of the photos.
    pub time: f64,
    /// Which of the times it is, from 0.
    pub moment: usize,
    /// Iterations of this time, from 1.
    pub iteration: u32,
    /// The round of Gauss–Newton, from 1; 0 before them.
    pub round: u32,
    /// The latest loss, summed over the photos of this time.
    pub loss: f64,
}

/// Looks at each iteration; false wants an end.
pub type Watch<'w> = dyn FnMut(&Progress) -> bool + 'w;

/// What was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Following {
    /// The model with a key at each photo's time; as it was where only cameras were searched for.
    pub scene: Scene,
    /// Cameras of all photos, in their order.
    pub cameras: Vec<Camera>,
    /// What was found at each time, in order of time.
    pub moments: Vec<Moment>,
}

/// What was found at one time.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Moment {
    /// The time.
    pub time: f64,
    /// Whether the model's table had no key at it.
    pub is_new_key: bool,
    /// Whether the photos fit better than before. Superpoints (and with them cameras) that do not stay as they were.
    pub is_better: bool,
    /// Its photos.
    pub photos: Vec<PhotoReport>,
    /// Where the first of them was looking, world space.
    pub direction: [f64; 3],
    /// `[M]` how well they fix each superpoint; empty where only cameras were searched for.
    pub superpoints: Vec<Uncertainty>,
    /// Root mean square way of the superpoints' centres from where the search began, pixels of the first photo.
    pub moved_px: Option<f64>,
}

/// A photo before and after.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PhotoReport {
    /// Name of the photo.
    pub name: String,
    /// PSNR before, dB.
    pub psnr_before: f64,
    /// PSNR after, dB.
    pub psnr: f64,
    /// What became of its camera, where that was searched for.
    pub camera: Option<CameraReport>,
}

/// What became of a camera.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CameraReport {
    /// By how much it was turned, degrees.
    pub turned_degrees: f64,
    /// How far it was moved, world units.
    pub moved: f64,
    /// How far what it sees has moved in its image, root mean square, pixels.
    pub moved_px: Option<f64>,
    /// Whether it was found.
    pub verdict: Verdict,
}
