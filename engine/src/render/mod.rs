//! Scene(t) + camera → image, on the GPU.
//!
//! ```text
//! [deform_network] → deform_project → compact → sort_scatter ×4 (depth) → sum_tile_counts → emit_tiles
//!                  → sort_scatter ×1..3 (tile id) → tile_ranges → blend
//! ```
//!
//! A scene with a deformation field runs it first ([`field`]), one with network G `nonrigid_network`.
//!
//! [`Renderer`] uploads a scene once, records the frame once per image size and replays it: only the [`frame::Frame`]
//! of each view is written by the host. Nothing is read back inside a frame; the counters are looked at after it, and a
//! frame that needed more tile instances than the buffers hold is run again with larger ones.
//!
//! What may be given up for speed is in [`Quality`]: a list of knobs and three presets. The default, [`Quality::EXACT`], is
//! the definition of the image; programs that show images want [`Quality::HIGH`], which differs from it invisibly.
//!
//! [`View`] records the same frame into another program's command buffer and image; [`embed`] says how.

pub mod angle;
pub mod blend;
pub mod blend_image;
pub(crate) mod bounds;
mod capacity;
pub mod compact;
pub mod deform_network;
pub mod deform_project;
pub mod display;
pub mod ellipse;
pub mod embed;
pub mod field;
pub mod frame;
pub mod half;
pub mod limits;
pub mod linear_forward;
pub mod mean_storage;
pub mod nonrigid_network;
pub(crate) mod pipeline;
pub(crate) mod pose_table;
pub mod quality;
pub mod quaternion;
pub mod radix_sort;
pub mod rate;
mod renderer;
pub(crate) mod scene_buffers;
pub mod sh_storage;
#[cfg(test)]
mod sort_tests;
pub mod splat;
#[cfg(test)]
mod tile_tests;
pub mod tiles;
pub mod twin;
pub(crate) mod work_buffers;

pub use blend::PixelFormat;
pub use embed::{Extent, Finished, Loading, Recorded, SceneHandle, SceneOptions, Target, View, ViewOptions};
pub use field::FieldEvaluator;
pub use pipeline::KERNELS;
pub use quality::Quality;
pub use renderer::{FrameId, FrameStatistics, MemoryUse, Picked, RenderOptions, Renderer};
