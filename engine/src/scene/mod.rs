//! Plain scene data, no GPU: Gaussians, superpoint motion, network F, cameras. Arrays keep the layout of the model file.

pub mod camera;
pub mod field;
pub mod gaussians;
pub mod motion;
pub mod network;
pub mod path;
pub mod synthetic;

use std::collections::BTreeMap;

use crate::error::{Error, Result};

pub use camera::Camera;
pub use field::DeformationField;
pub use gaussians::{Gaussians, Rejected};
pub use motion::{Association, KeyInterval, Motion, MotionSource, Superpoints};
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

/// A whole model. What a scene does not need is `None`: a static scene has no superpoints, motion or network.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Scene {
    /// The canonical Gaussians.
    pub gaussians: Gaussians,
    /// Which superpoint each Gaussian moves with, and the canonical superpoint centres.
    pub superpoints: Option<Superpoints>,
    /// Key-time table of superpoint poses.
    pub motion: Option<Motion>,
    /// Sparse association matrix A.
    pub association: Option<Association>,
    /// Network F (superpoint deformation).
    pub deform: Option<DeformNetwork>,
    /// Network G (non-rigid stage).
    pub nonrigid: Option<NonrigidNetwork>,
    /// Motion that is each Gaussian's own.
    pub field: Option<DeformationField>,
    /// Further tensors by name, kept on a round trip.
    pub extra: BTreeMap<String, Tensor>,
    /// Free metadata of the file (training configuration, data set, provenance).
    pub metadata: BTreeMap<String, String>,
}

impl Scene {
    /// Whether anything moves: the scene has superpoints and either a key-time table or network F, or a deformation field.
    pub fn is_dynamic(&self) -> bool {
        self.field.is_some() || self.superpoints.is_some() && (self.motion.is_some() || self.deform.is_some())
    }

    /// Refuses a deformation field that does not fit the Gaussians, or is not the only thing that moves them.
    ///
    /// # Errors
    /// `Usage` naming the tensor, what was found and what is possible.
    pub fn check_field(&self) -> Result<()> {
        let Some(field) = &self.field else { return Ok(()) };
        if self.superpoints.is_some() || self.nonrigid.is_some() {
            return Err(Error::usage(
                "field",
                "a deformation field beside superpoints or network G",
                "only one of them",
            ));
        }
        field.check(self.gaussians.len())
    }

    /// What moves the superpoints when `wanted` is asked for: `Table`, `Network`, or `None` for a scene that stands still.
    pub fn motion_source(&self, wanted: MotionSource) -> Result<Option<MotionSource>> {
        let table = self.superpoints.is_some() && self.motion.as_ref().is_some_and(|m| !m.times.is_empty());
        let network = self.superpoints.is_some() && self.deform.is_some();
        match wanted {
            MotionSource::Auto if table => Ok(Some(MotionSource::Table)),
            MotionSource::Auto if network => Ok(Some(MotionSource::Network)),
            MotionSource::Auto => Ok(None),
            MotionSource::Table if table => Ok(Some(MotionSource::Table)),
            MotionSource::Network if network => Ok(Some(MotionSource::Network)),
            // A deformation field is a network; it moves no superpoints.
            MotionSource::Network if self.field.is_some() => Ok(None),
            MotionSource::Table => Err(Error::usage("motion source `table`", "no motion.times", "a key-time table")),
            MotionSource::Network => Err(Error::usage("motion source `network`", "no deform.*", "network F")),
        }
    }
}
