//! Plain scene data, no GPU: Gaussians, what moves them, cameras. Arrays keep the layout of the model file.

pub mod camera;
pub mod deformation;
pub mod field;
pub mod gaussians;
pub mod motion;
pub mod network;
pub mod parameter;
pub mod path;
pub mod synthetic;

use std::collections::BTreeMap;

use self::gaussians::retain_chunks;
use self::parameter::LIFESPAN;

pub use camera::Camera;
pub use deformation::{Deformation, SuperpointDeformation};
pub use field::DeformationField;
pub use gaussians::{Gaussians, Rejected};
pub use motion::{Association, Blend, KeyInterval, Motion, MotionSource, Superpoints, heaviest_slot};
pub use network::{DeformNetwork, DeformSize, Linear, NonrigidNetwork};
pub use path::CameraPath;

/// A named tensor that the engine carries but does not interpret: shape and f32 data.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    /// Dimensions, outermost first.
    pub shape: Vec<usize>,
    /// Row-major values.
    pub data: Vec<f32>,
}

/// A whole model.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Scene {
    /// The canonical Gaussians.
    pub gaussians: Gaussians,
    /// What moves them.
    pub deformation: Deformation,
    /// Further tensors by name, kept on a round trip.
    pub extra: BTreeMap<String, Tensor>,
    /// Free metadata of the file (training configuration, data set, provenance).
    pub metadata: BTreeMap<String, String>,
}

impl Scene {
    /// Whether anything moves, comes or goes.
    pub fn is_dynamic(&self) -> bool {
        self.deformation.moves() || self.gaussians.optional.present().has(LIFESPAN)
    }

    /// First and last time: of what moves; 0 and 1 where Gaussians only come and go; both 0 in a scene that stands still.
    pub fn time_range(&self) -> [f64; 2] {
        if self.is_dynamic() && !self.deformation.moves() { [0.0, 1.0] } else { self.deformation.time_range() }
    }

    /// Keeps the Gaussians for which `keep` holds, in order, with all that belongs to them. Superpoints keep their numbers.
    pub fn retain(&mut self, keep: &[bool]) {
        for tensor in self.extra_of_gaussians() {
            let width = tensor.shape[1..].iter().product();
            retain_chunks(&mut tensor.data, width, keep);
            tensor.shape[0] = keep.iter().filter(|kept| **kept).count();
        }
        self.gaussians.retain(keep);
        self.deformation.retain(keep);
    }

    /// Further tensors with a row for each Gaussian.
    pub(crate) fn extra_of_gaussians(&mut self) -> impl Iterator<Item = &mut Tensor> {
        let n = self.gaussians.len();
        let of_gaussians =
            move |(name, t): &(&String, &mut Tensor)| name.starts_with("gaussians.") && t.shape.first() == Some(&n);
        self.extra.iter_mut().filter(of_gaussians).map(|(_, tensor)| tensor)
    }
}
