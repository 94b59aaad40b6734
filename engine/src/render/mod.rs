//! Scene(t) + camera → image, on the GPU.
//!
//! ```text
//! [deform_network] → deform_project → [scan_tiles → emit_tiles] → sort_tiles → blend
//! ```
//!
//! A scene with a deformation field runs it first (`field_*`), one with network G `nonrigid_network`.
//!
//! [`Renderer`] uploads a scene once, records the frame once per image size and replays it: only the `Frame`
//! of each view is written by the host. Nothing is read back inside a frame; the counters are looked at after it, and a
//! frame that needed more tile instances than the buffers hold is run again with larger ones.
//!
//! What may be given up for speed is in [`Quality`]: a list of knobs and three presets. The default, [`Quality::EXACT`], is
//! the definition of the image; programs that show images want [`Quality::HIGH`], which differs from it invisibly.
//!
//! [`View`] records the same frame into another program's command buffer and image; [`embed`] says how.

#[doc(hidden)]
pub mod angle;
#[doc(hidden)]
pub mod arithmetic_rate;
#[doc(hidden)]
pub mod blend;
#[doc(hidden)]
pub mod blend_image;
#[doc(hidden)]
pub mod blend_packed;
#[doc(hidden)]
pub mod blend_rgba16f;
#[doc(hidden)]
pub mod blend_rgba32f;
#[doc(hidden)]
pub mod blend_rgba8;
#[doc(hidden)]
pub mod blend_states;
pub(crate) mod capacity;
#[doc(hidden)]
pub mod copy_rate;
#[doc(hidden)]
pub mod deform_network;
#[doc(hidden)]
pub mod deform_project;
pub(crate) mod deformation;
mod device_time;
pub mod display;
#[doc(hidden)]
pub mod ellipse;
pub mod embed;
#[doc(hidden)]
pub mod emit_tiles;
#[doc(hidden)]
pub mod field;
#[doc(hidden)]
pub mod frame;
#[doc(hidden)]
pub mod half;
#[doc(hidden)]
pub mod limits;
#[doc(hidden)]
pub mod linear_forward;
#[doc(hidden)]
pub mod mean_storage;
#[doc(hidden)]
pub mod nonrigid_network;
pub(crate) mod pipeline;
mod pixel_format;
pub(crate) mod pose_table;
pub mod quality;
#[doc(hidden)]
pub mod quaternion;
#[doc(hidden)]
pub mod radix_sort;
mod renderer;
#[doc(hidden)]
pub mod scan_tiles;
pub(crate) mod scene_buffers;
#[doc(hidden)]
pub mod segments;
#[doc(hidden)]
pub mod sh_storage;
pub mod sort_histogram;
pub mod sort_scatter;
pub mod sort_spine;
#[cfg(test)]
mod sort_tests;
#[doc(hidden)]
pub mod sort_tiles;
#[doc(hidden)]
pub mod splat;
#[doc(hidden)]
pub mod superpoint_motion;
#[cfg(test)]
mod tile_tests;
#[doc(hidden)]
pub mod tiles;
#[doc(hidden)]
pub mod twin;
pub(crate) mod work_buffers;

pub use embed::{Extent, Finished, Loading, Recorded, SceneHandle, SceneOptions, Target, View, ViewOptions};
pub use field::FieldEvaluator;
#[doc(hidden)]
pub use pipeline::KERNELS;
pub use pixel_format::PixelFormat;
pub use quality::Quality;
pub use renderer::{FrameId, FrameStatistics, MOST_BESIDE, MemoryUse, Picked, RenderOptions, Renderer};
