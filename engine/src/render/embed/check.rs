//! What of a host's arguments makes no sense, found before anything is made or recorded.

use glam::DMat3;

use super::super::frame::FrameOptions;
use super::options::{MAX_IN_FLIGHT, Target, ViewOptions};
use super::scene::SceneHandle;
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::scene::Camera;

/// How far the products of a rotation's columns may be from those of orthonormal ones: matrices of floats pass, those with a
/// scale do not.
const RIGID_TOLERANCE: f64 = 1e-3;

/// Buffers of one device mean nothing to another.
pub(super) fn scene(gpu: &Gpu, scene: &SceneHandle) -> Result<()> {
    if scene.gpu.is_clone_of(gpu) {
        return Ok(());
    }
    Err(Error::usage("scene of a view", "one of another gpu", "one that was uploaded with the gpu of the view"))
}

pub(super) fn options(options: &ViewOptions) -> Result<()> {
    if !(1..=MAX_IN_FLIGHT).contains(&options.in_flight) {
        let expected = format!("1 to {MAX_IN_FLIGHT}");
        return Err(Error::usage("frames in flight", options.in_flight.to_string(), expected));
    }
    if options.storage && !options.format.is_storable() {
        let found = format!("{:?} with a storage view", options.format);
        let expected = "Rgba8, Rgba16F or Rgba32F, or an image that is copied to";
        return Err(Error::usage("format of a view", found, expected));
    }
    FrameOptions { background: options.background, near: options.near, ..FrameOptions::default() }.check()
}

pub(super) fn target(target: &Target, options: &ViewOptions) -> Result<()> {
    if target.depth.is_some() && !options.depth {
        return Err(Error::usage("depth image", "one", "none: the view was made without depth"));
    }
    let said = |storage| if storage { "with a storage view" } else { "without a storage view" };
    if target.color.is_storage() != options.storage {
        let expected = format!("one {}: the view was made so", said(options.storage));
        return Err(Error::usage("colour image", format!("one {}", said(!options.storage)), expected));
    }
    if target.depth.is_some_and(|d| d.is_storage()) {
        return Err(Error::usage("depth image", "one with a storage view", "one that is copied to"));
    }
    target.color.check("colour image")?;
    target.depth.map_or(Ok(()), |d| d.check("depth image"))
}

/// The kernels take the rotation as it is: a scale or a mirror would bend the projected Gaussians without a word.
pub(super) fn rigid(camera: &Camera) -> Result<()> {
    let off = camera.rotation.transpose() * camera.rotation - DMat3::IDENTITY;
    let most = off.to_cols_array().into_iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    // Not `>`: what is not a number is refused too.
    let orthonormal = most <= RIGID_TOLERANCE;
    let determinant = camera.rotation.determinant();
    if orthonormal && determinant > 0.0 {
        return Ok(());
    }
    let [x, y, z] = [camera.rotation.x_axis, camera.rotation.y_axis, camera.rotation.z_axis].map(|c| c.length());
    let found = if orthonormal {
        format!("a mirror, determinant {determinant:.4}")
    } else {
        format!("columns of lengths {x:.4}, {y:.4}, {z:.4}, determinant {determinant:.4}")
    };
    Err(Error::usage("camera rotation (world to camera)", found, "orthonormal columns, determinant 1"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use glam::DVec3;

    #[test]
    fn only_rotations_are_rigid() {
        let camera = Camera::look_at(DVec3::new(3.0, -2.0, 1.0), DVec3::ZERO, DVec3::Z, 0.9, [64, 48]);
        let with = |rotation: DMat3| Camera { rotation, ..camera.clone() };
        rigid(&camera).unwrap();
        rigid(&with(camera.rotation * 1.0001)).unwrap();
        // As floats, and turned half round.
        rigid(&with(camera.rotation.as_mat3().as_dmat3())).unwrap();
        rigid(&with(DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0)))).unwrap();
        let refused = |rotation: DMat3| rigid(&with(rotation)).unwrap_err().to_string();
        assert!(refused(DMat3::ZERO).contains("lengths 0.0000, 0.0000, 0.0000"));
        assert!(refused(camera.rotation * 2.0).contains("lengths 2.0000, 2.0000, 2.0000"));
        assert!(refused(camera.rotation * 1.001).contains("expected orthonormal"));
        assert!(refused(DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0))).contains("a mirror, determinant -1.0000"));
        assert!(refused(DMat3::from_cols(DVec3::X, DVec3::new(0.1, 1.0, 0.0), DVec3::Z)).contains("orthonormal"));
        assert!(refused(DMat3::from_diagonal(DVec3::NAN)).contains("NaN"));
    }
}
