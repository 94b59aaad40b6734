//! What a frame is, as the kernels see it: the Rust mirror of `glsl/lib/frame.glsl`, made from a camera in f64.

use glam::DVec3;

use super::limits::TILE_SIZE;
use crate::error::{Error, Result};
use crate::scene::{Camera, KeyInterval};

/// Largest image edge, pixels.
pub const MAX_IMAGE_EDGE: u32 = 16_384;
/// Margin by which x/z and y/z may leave the image in the Jacobian, as a share of the half extent.
const TANGENT_MARGIN: f64 = 0.3;

crate::gpu_struct! {
    /// One frame: camera, image, time, counts. Uploaded once per frame; binding 0 of the render kernels.
    pub struct Frame {
        /// First row of the rotation world → camera; w = 0.
        pub world_to_camera_0: [f32; 4],
        /// Second row.
        pub world_to_camera_1: [f32; 4],
        /// Third row.
        pub world_to_camera_2: [f32; 4],
        /// Camera centre rounded to f32, world units.
        pub camera_position_high: [f32; 3],
        /// Gaussians at camera depth z ≤ near are not drawn; world units.
        pub near: f32,
        /// Camera centre − high.
        pub camera_position_low: [f32; 3],
        /// Weight of the second motion key.
        pub key_weight: f32,
        /// fx, fy, cx, cy, pixels.
        pub intrinsics: [f32; 4],
        /// Range in which x/z and y/z enter the Jacobian: x min, x max, y min, y max.
        pub tan_limit: [f32; 4],
        /// Background colour.
        pub background: [f32; 3],
        /// Time for the networks.
        pub time: f32,
        /// Width and height, pixels.
        pub size: [u32; 2],
        /// Tiles in x and y.
        pub tiles: [u32; 2],
        /// Gaussians.
        pub gaussians: u32,
        /// Superpoints.
        pub superpoints: u32,
        /// The motion key at or before the time.
        pub first_key: u32,
        /// The motion key after it.
        pub second_key: u32,
        /// Tile instances that the buffers hold.
        pub instance_capacity: u32,
        /// Tiles of the image.
        pub tile_count: u32,
        /// Pairs that the list of each tile has room for; 0: `scan_tiles` says where the lists lie.
        pub tile_room: u32,
        /// To a multiple of 16 bytes.
        pub unused: u32,
    }
}

/// What a frame needs beside the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameOptions {
    /// Colour behind everything.
    pub background: [f32; 3],
    /// Gaussians at camera depth z ≤ near are not drawn; world units, ≥ 0.
    pub near: f32,
    /// Time for network F, in the unit of the motion table.
    pub time: f64,
    /// Where the time lies in the pose table.
    pub interval: KeyInterval,
    /// Number of Gaussians.
    pub gaussians: u32,
    /// Number of superpoints.
    pub superpoints: u32,
    /// SH degree of the scene.
    pub sh_degree: u32,
    /// Tile instances that the buffers hold.
    pub instance_capacity: u32,
}

impl Default for FrameOptions {
    fn default() -> Self {
        Self {
            background: [0.0; 3],
            near: 0.2,
            time: 0.0,
            interval: KeyInterval::default(),
            gaussians: 0,
            superpoints: 0,
            sh_degree: 0,
            instance_capacity: 0,
        }
    }
}

impl FrameOptions {
    /// Fails with a named field when a number is not finite or senseless.
    pub(crate) fn check(&self) -> Result<()> {
        check_finite("background", &self.background.map(f64::from))?;
        check_finite("time", &[self.time])?;
        if !(self.near >= 0.0 && self.near.is_finite()) {
            return Err(Error::usage("near plane", self.near.to_string(), "a finite distance of at least 0"));
        }
        Ok(())
    }
}

impl Frame {
    /// A frame of `camera`. The Gaussians' coordinates are relative to `origin` (world units). All arithmetic is f64; the
    /// camera centre is split into two f32 so that nothing is lost far from the origin.
    ///
    /// Fails with a named field when a number is not finite or senseless, or when the image is empty or larger than
    /// [`MAX_IMAGE_EDGE`].
    pub fn new(camera: &Camera, origin: DVec3, options: &FrameOptions) -> Result<Self> {
        check_size(camera)?;
        let rows = camera.rotation.transpose().to_cols_array();
        check_finite("camera rotation (row-major)", &rows)?;
        let intrinsics = [camera.fx, camera.fy, camera.cx, camera.cy];
        check_finite("camera intrinsics fx, fy, cx, cy", &intrinsics)?;
        let position = camera.position - origin;
        check_finite("camera position", &position.to_array())?;
        options.check()?;
        for (what, f) in [("camera fx", camera.fx), ("camera fy", camera.fy)] {
            if f <= 0.0 {
                return Err(Error::usage(what, f.to_string(), "a focal length above 0 px"));
            }
        }
        let row = |i: usize| [rows[3 * i] as f32, rows[3 * i + 1] as f32, rows[3 * i + 2] as f32, 0.0];
        let high = position.as_vec3();
        let low = (position - high.as_dvec3()).as_vec3();
        let tiles = [camera.width.div_ceil(TILE_SIZE), camera.height.div_ceil(TILE_SIZE)];
        let interval = options.interval;
        Ok(Self {
            world_to_camera_0: row(0),
            world_to_camera_1: row(1),
            world_to_camera_2: row(2),
            camera_position_high: high.to_array(),
            near: options.near,
            camera_position_low: low.to_array(),
            key_weight: interval.weight as f32,
            intrinsics: intrinsics.map(|v| v as f32),
            tan_limit: tan_limit(camera).map(|v| v as f32),
            background: options.background,
            time: options.time as f32,
            size: [camera.width, camera.height],
            tiles,
            gaussians: options.gaussians,
            superpoints: options.superpoints,
            first_key: interval.first,
            second_key: interval.second,
            instance_capacity: options.instance_capacity,
            tile_count: tiles[0] * tiles[1],
            tile_room: 0,
            unused: 0,
        })
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.size[0] as usize * self.size[1] as usize
    }
}

/// Range of x/z and of y/z in the Jacobian: the image's own, widened by 0.3 of its half extent on each side.
fn tan_limit(camera: &Camera) -> [f64; 4] {
    let axis = |size: u32, f: f64, c: f64| {
        let size = f64::from(size);
        let margin = TANGENT_MARGIN * 0.5 * size / f;
        [-(c / f + margin), (size - c) / f + margin]
    };
    let x = axis(camera.width, camera.fx, camera.cx);
    let y = axis(camera.height, camera.fy, camera.cy);
    [x[0], x[1], y[0], y[1]]
}

fn check_size(camera: &Camera) -> Result<()> {
    for (what, edge) in [("image width", camera.width), ("image height", camera.height)] {
        if edge == 0 {
            return Err(Error::usage(what, "0", "at least 1 px"));
        }
        if edge > MAX_IMAGE_EDGE {
            return Err(Error::Limit { what: what.into(), need: edge.into(), have: MAX_IMAGE_EDGE.into() });
        }
    }
    Ok(())
}

/// Every value must be finite as f32, which is what the kernels get.
fn check_finite(what: &str, values: &[f64]) -> Result<()> {
    match values.iter().position(|&v| !(v as f32).is_finite()) {
        Some(index) => Err(Error::NonFinite { what: what.into(), index, value: values[index].to_string() }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::gpu::interface::GpuStruct as _;
    use glam::{DMat3, DVec3};

    fn camera() -> Camera {
        Camera::look_at(DVec3::new(1.0, -2.0, 3.0), DVec3::ZERO, DVec3::Y, 0.9, [400, 300])
    }

    #[test]
    fn is_176_bytes_in_std430_order() {
        assert_eq!(size_of::<Frame>(), 176);
        assert_eq!(Frame::MEMBERS[11], ("size", 128));
    }

    #[test]
    fn position_keeps_f64_accuracy_far_from_the_origin() {
        let mut c = camera();
        c.position = DVec3::new(1.0e6 + 0.123_456_789, -3.0e7 - 0.25, 1.0 / 3.0);
        let f = Frame::new(&c, DVec3::ZERO, &FrameOptions::default()).unwrap();
        for i in 0..3 {
            let sum = f64::from(f.camera_position_high[i]) + f64::from(f.camera_position_low[i]);
            assert!((sum - c.position[i]).abs() <= 1e-7, "{sum} {}", c.position[i]);
        }
        let moved = Frame::new(&c, c.position, &FrameOptions::default()).unwrap();
        assert_eq!((moved.camera_position_high, moved.near), ([0.0; 3], 0.2));
    }

    #[test]
    fn rows_and_limits_follow_the_camera() {
        let c = camera();
        let f = Frame::new(&c, DVec3::ZERO, &FrameOptions::default()).unwrap();
        let x = c.rotation * DVec3::X;
        assert_eq!(f.world_to_camera_0[0], x.x as f32);
        assert_eq!(f.world_to_camera_1[0], x.y as f32);
        let tan = 0.5 * 400.0 / c.fx;
        assert!((f64::from(f.tan_limit[0]) + 1.3 * tan).abs() < 1e-6);
        assert!((f64::from(f.tan_limit[1]) - 1.3 * tan).abs() < 1e-6);
        assert_eq!((f.size, f.tiles, f.tile_count), ([400, 300], [25, 19], 475));
    }

    #[test]
    fn senseless_cameras_are_refused_by_name() {
        let refused = |change: fn(&mut Camera)| {
            let mut c = camera();
            change(&mut c);
            Frame::new(&c, DVec3::ZERO, &FrameOptions::default()).unwrap_err().to_string()
        };
        assert!(refused(|c| c.width = 0).contains("image width"));
        assert!(refused(|c| c.height = 16_385).contains("16384"));
        assert!(refused(|c| c.fx = f64::NAN).contains("intrinsics"));
        assert!(refused(|c| c.fy = -1.0).contains("fy"));
        assert!(refused(|c| c.position.y = f64::INFINITY).contains("position"));
        assert!(refused(|c| c.position.y = 1e300).contains("position"));
        assert!(refused(|c| c.rotation = DMat3::from_diagonal(DVec3::NAN)).contains("rotation"));
        let options = FrameOptions { near: f32::NAN, ..FrameOptions::default() };
        assert!(Frame::new(&camera(), DVec3::ZERO, &options).is_err());
    }
}
