//! The structures of `spgs.h`, member by member; a test compiles the header and compares sizes and offsets.
#![allow(non_camel_case_types, reason = "the names of the header")]

use std::ffi::{c_char, c_void};

use engine::gpu::{HostImage, ImageUse};
use engine::render::{Finished, FrameStatistics};
use engine::scene::Camera;
use engine::{Error, Result};
use glam::DMat4;

use crate::status::null;

/// How far the last row of a camera's matrix may be from 0, 0, 0, 1.
const LAST_ROW_TOLERANCE: f64 = 1e-3;

/// Declares a `#[repr(C)]` structure with the table of its members, so that the test can compare it with the header.
macro_rules! c_struct {
    ($(pub struct $name:ident { $(pub $field:ident : $ty:ty),* $(,)? })*) => {
        $(
            /// See `spgs.h`.
            #[repr(C)]
            #[derive(Debug, Clone, Copy)]
            pub struct $name { $(#[doc = "See `spgs.h`."] pub $field: $ty),* }
            impl Default for $name {
                fn default() -> Self {
                    // SAFETY: plain data and nullable pointers, for which zero bytes are valid.
                    unsafe { std::mem::zeroed() }
                }
            }
        )*
        /// Name and size of each structure, then name and offset of each of its members.
        pub const LAYOUT: &[(&str, usize, &[(&str, usize)])] = &[
            $((stringify!($name), size_of::<$name>(), &[$((stringify!($field), std::mem::offset_of!($name, $field))),*])),*
        ];
    };
}

/// A queue lock's function.
pub type LockFunction = Option<unsafe extern "C" fn(*mut c_void)>;

c_struct! {
    pub struct spgs_host {
        pub struct_size: u32,
        pub api_version: u32,
        pub get_instance_proc_addr: Option<unsafe extern "system" fn()>,
        pub instance: *mut c_void,
        pub physical_device: *mut c_void,
        pub device: *mut c_void,
        pub queue: *mut c_void,
        pub queue_family: u32,
        pub reserved: u32,
        pub lock_queue: LockFunction,
        pub unlock_queue: LockFunction,
        pub lock_user: *mut c_void,
    }
    pub struct spgs_gpu_options {
        pub struct_size: u32,
        pub instance_extension_count: u32,
        pub device_extension_count: u32,
        pub validation: u32,
        pub device_name: *const c_char,
        pub instance_extensions: *const *const c_char,
        pub device_extensions: *const *const c_char,
        pub skip_self_test: u32,
        pub reserved: u32,
    }
    pub struct spgs_handles {
        pub instance: *mut c_void,
        pub physical_device: *mut c_void,
        pub device: *mut c_void,
        pub queue_family: u32,
        pub reserved: u32,
    }
    pub struct spgs_scene_options {
        pub struct_size: u32,
        pub motion: u32,
        pub quality: u32,
        pub reserved: u32,
    }
    pub struct spgs_scene_info {
        pub gaussians: u64,
        pub rejected: u64,
        pub bytes: u64,
    }
    pub struct spgs_scene_extent {
        pub first_time: f64,
        pub last_time: f64,
        pub center: [f64; 3],
        pub radius: f64,
        pub motion: u32,
        pub one_after_another: u32,
    }
    pub struct spgs_camera {
        pub width: u32,
        pub height: u32,
        pub fx: f64,
        pub fy: f64,
        pub cx: f64,
        pub cy: f64,
        pub world_to_camera: [f64; 16],
    }
    pub struct spgs_view_options {
        pub struct_size: u32,
        pub format: u32,
        pub depth: u32,
        pub in_flight: u32,
        pub max_instances: u64,
        pub background: [f32; 3],
        pub near_plane: f32,
        pub storage: u32,
        pub reserved: u32,
    }
    pub struct spgs_image {
        pub image: u64,
        pub x: u32,
        pub y: u32,
        pub layer: u32,
        pub level: u32,
        pub old_layout: i32,
        pub new_layout: i32,
        pub before_stages: u64,
        pub before_access: u64,
        pub after_stages: u64,
        pub after_access: u64,
        pub storage_view: u64,
    }
    pub struct spgs_target {
        pub color: spgs_image,
        pub depth: *const spgs_image,
    }
    pub struct spgs_statistics {
        pub visible: u32,
        pub rejected: u32,
        pub instances: u64,
    }
    pub struct spgs_finished {
        pub serial: u64,
        pub statistics: spgs_statistics,
        pub overflowed: u32,
        pub reserved: u32,
    }
}

impl spgs_camera {
    /// The engine takes the upper rows and looks at them; the last one says whether the matrix is what it takes it for.
    pub(crate) fn camera(&self) -> Result<Camera> {
        let matrix = DMat4::from_cols_array(&self.world_to_camera);
        let last = matrix.row(3).to_array();
        let near = |(found, expected): (&f64, f64)| (found - expected).abs() <= LAST_ROW_TOLERANCE;
        if !last.iter().zip([0.0, 0.0, 0.0, 1.0]).all(near) {
            let expected = "[0.0, 0.0, 0.0, 1.0]: a rigid matrix, column by column";
            return Err(Error::usage("spgs_camera.world_to_camera, last row", format!("{last:?}"), expected));
        }
        let [fx, fy, cx, cy] = [self.fx, self.fy, self.cx, self.cy];
        Ok(Camera::from_world_to_camera(matrix, [fx, fy, cx, cy], [self.width, self.height]))
    }
}

impl spgs_image {
    /// Refuses by the header's names what the engine would refuse by its own. `place`: which member of the target it is.
    pub(crate) fn check(&self, place: &str) -> Result<()> {
        if self.image == 0 {
            return Err(null(&format!("{place}.image")));
        }
        match self.new_layout {
            0 => Err("VK_IMAGE_LAYOUT_UNDEFINED"),
            8 => Err("VK_IMAGE_LAYOUT_PREINITIALIZED"),
            _ => Ok(()),
        }
        .map_err(|found| Error::usage(format!("{place}.new_layout"), found, "the layout that its next use wants"))
    }

    /// # Safety
    /// As [`HostImage::from_raw`] and [`HostImage::with_storage_view`].
    pub(crate) unsafe fn host_image(&self) -> HostImage {
        let side = |layout, stages, access| ImageUse { layout, stages, access };
        let before = side(self.old_layout, self.before_stages, self.before_access);
        let after = side(self.new_layout, self.after_stages, self.after_access);
        // SAFETY: promised by the caller.
        let image = unsafe { HostImage::from_raw(self.image, before, after).with_storage_view(self.storage_view) };
        image.at(self.x, self.y).layer(self.layer).level(self.level)
    }
}

impl From<FrameStatistics> for spgs_statistics {
    fn from(s: FrameStatistics) -> Self {
        Self { visible: s.visible, rejected: s.rejected, instances: s.instances }
    }
}

impl From<Option<Finished>> for spgs_finished {
    fn from(finished: Option<Finished>) -> Self {
        let Some(f) = finished else { return Self::default() };
        Self { serial: f.serial, statistics: f.statistics.into(), overflowed: f.overflowed.into(), reserved: 0 }
    }
}
