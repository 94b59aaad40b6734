//! A posed picture as the files of a data set describe it, before its image is looked at.

use glam::{DMat3, DVec3};

use super::lens::Lens;
use crate::scene::Camera;

/// One frame. Lens and size are those of the camera file, which stored images may be a fraction of.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Frame {
    /// Name in the camera file.
    pub(super) name: String,
    /// Pixels of `size`.
    pub(super) lens: Lens,
    /// Width and height.
    pub(super) size: [u32; 2],
    /// World to camera, OpenCV axes.
    pub(super) rotation: DMat3,
    /// Camera centre.
    pub(super) position: DVec3,
    pub(super) time: f64,
    /// Name of a mask that the camera file gives.
    pub(super) mask: Option<String>,
}

impl Frame {
    /// The camera of the undistorted picture: same size, focal lengths and principal point.
    pub(super) fn pinhole(&self) -> Camera {
        let ([fx, fy], [cx, cy], [width, height]) = (self.lens.focal, self.lens.principal, self.size);
        let (name, rotation, position, time) = (self.name.clone(), self.rotation, self.position, self.time);
        Camera { name, width, height, fx, fy, cx, cy, rotation, position, time }
    }
}
