//! # spgs engine: dynamic 3D Gaussian scenes on raw Vulkan
//!
//! This page is the architecture. A scene (Gaussians, superpoint motion) and a camera go in, an image comes out; every
//! kernel has a CPU twin, and every image is measured against an f64 reference.
//!
//! ```text
//! model file ── file ──► scene::Scene ──► render::Renderer ──► image::Image ── file::picture ──► PNG, EXR
//! camera file ── data ─► scene::Camera ──┘        │
//!                                                 └ measured against reference::render (f64, CPU)
//! ```
//!
//! Images for a window never leave the device (feature `window`, used by `spgs view`): kernel `display` makes 8-bit pixels of a
//! frame, [`render::display::Screen`] keeps them, `gpu::presenter` copies them into the window's image and paints the interface
//! over them.
//!
//! The [`manual`] says how to use all of this; the page ends with a [glossary](#glossary).
//!
//! ## Modules, lowest first
//!
//! An import may only point downwards; a test reads the sources and enforces it.
//!
//! | module | what it holds |
//! |---|---|
//! | [`manual`] | the engine's pages of the manual, as `spgs help TOPIC` prints them |
//! | [`error`] | the one error type; its variants are the exit codes of the command line |
//! | [`gpu`] | device, buffers, kernels, barriers, submission; the only module that names `ash` or writes `unsafe`; knows nothing of Gaussians |
//! | [`scene`] | plain data: Gaussians, superpoints, key-time table, networks, deformation fields, cameras; synthetic scenes |
//! | [`image`] | float images and their comparison |
//! | [`mod@reference`] | the f64 reference: the definition of the image |
//! | [`mod@file`], [`data`] | model files and images; data sets of posed images, camera files |
//! | [`metrics`] | how far an image is from its ground truth: PSNR, SSIM, MS-SSIM, FLIP, LPIPS, flicker |
//! | [`render`] | scene(t) + camera → image on the GPU: kernels, their twins, the frame; [`render::embed`]: frames in other programs |
//! | [`train`] | posed images → scene on the GPU: loss, backward kernels, Adam, density, checkpoints |
//! | [`edit`] | select Gaussians; move, turn, scale, recolour, retime, merge them |
//! | [`confidence`] | how far off each pixel may be, by what training views show of each Gaussian |
//! | [`distill`] | the motion of any model as superpoints, within a bound in pixels |
//! | [`pose`] | how superpoints and cameras stand in new photos |
//! | [`self_test`] | whether a device computes what it must: every kernel of a frame or a step on a small scene; [`gpu::Gpu::new`] |
//!
//! ## A frame
//!
//! One command buffer, recorded once per image size and submitted again and again, several in flight. Nothing is read
//! back inside it, and three dispatches of it wait for each other.
//!
//! ```text
//! fill            one fill clears the arena: counters, block sums, tile counts
//! deform_network  only when network F is live: pose of each superpoint at time t
//! nonrigid_network, field_*     only for scenes with network G or a deformation field: offsets of each Gaussian at time t
//! deform_project  pose, project, SH colour, cull, one (depth, Gaussian) per tile that a Gaussian reaches, appended to the
//!                 tile's list (fused)
//! sort_tiles      each list by depth, ties by Gaussian, in shared memory
//! blend           front to back, one subgroup per subtile of pixels
//! ```
//!
//! The lists are filled in whatever order atomics have and sorted after that, each for itself: no sort of all instances, whose passes
//! would wait for each other. No two members of a list are equal, so the same scene gives the same bits on every run. The radix sort
//! (`sort_histogram`, `sort_spine`, `sort_scatter`) orders what training sums by superpoint.
//!
//! Each tile has room of one size for its list, half as much again as the longest list needed. Where that would take more than
//! 128 MiB, and in training, the lists lie one behind the other: then `deform_project` counts for each tile, `scan_tiles` adds up
//! where the lists begin, and `emit_tiles` fills them.
//!
//! Capacity: counts are 64-bit. A frame that needs more tile instances than there is room for writes nothing past a
//! buffer, sets a bit, and is drawn again with larger buffers; what can never fit is [`Error::Limit`] with the numbers.
//!
//! ## Inside another program
//!
//! [`gpu::host`] takes a host's device (or lends ours), [`render::embed`] records frames into its command buffers and
//! images. A frame is the same list of operations either way, a [`gpu::Sequence`]: descriptor sets and barriers are made once;
//! encoding it writes commands and allocates nothing. What differs from frame to frame (camera, time, poses) travels inside the
//! command buffer by `vkCmdUpdateBuffer`, so that any number of frames may be in flight; kernel `blend_packed` ends in the
//! format of the host's image, which a copy then fills. Package `spgs-capi` (engine/capi) gives the same calls to C; its
//! header is `spgs.h`.
//!
//! ## A kernel is declared once
//!
//! [`gpu::kernel::Kernel`] names the GLSL file, push constants, bindings with what is done to them, CPU twin, tolerance and
//! bytes moved. From it follow the pipeline, the check against the SPIR-V (names, access, layouts, constants), the
//! barriers, the GPU-against-twin test, the bench row and the table of `spgs-dev docs`. To add one: `glsl/<folder>/<name>.comp`, a
//! `static` beside its twin in [`render`] or [`train`], a line in that module's `KERNELS`, and `spgs-dev spirv`. Kernels,
//! twins and buffers are public for tests and tools, but no part of the interface: these pages do not show them.
//!
//! ## Conventions
//!
//! - Camera axes: x right, y down, z forward; pixel centres at +0.5; quaternions w, x, y, z.
//! - Raw parameters carry their transform in the name: `log_scale`, `opacity_logit`.
//! - `a_from_b` is an array indexed by b; plurals are arrays; counts are `n` of something or the plural's length.
//! - Subgroup size is specialisation constant 0 of every kernel: 4 to 128, never assumed 32, and chosen per kernel where the
//!   driver can pin it ([`gpu::subgroup_size`]). Rendering uses no float atomics; training uses them where the device is faster
//!   with them, unless it is to be deterministic.
//! - Barriers and subgroup operations sit in flow that is uniform for the workgroup and the subgroup, functions before them have
//!   one way out, and a kernel that works by subgroups numbers its threads by them: `spgs-dev spirv --check` proves it.
//!
//! ## Glossary
//!
//! | word | meaning |
//! |---|---|
//! | Gaussian | one ellipsoid of the scene: centre, scale, rotation, opacity, colour as SH |
//! | splat | a Gaussian projected into an image |
//! | SH | spherical harmonics: colour that depends on the view direction |
//! | superpoint | a group of Gaussians that move together rigidly |
//! | soft superpoints | Gaussians that move with up to four superpoints each, by weights |
//! | pose | rotation and translation of a superpoint at a time |
//! | key-time table | poses of all superpoints at key times; between them they are interpolated |
//! | network F | gives the pose of a superpoint at any time; training bakes it into the key-time table |
//! | network G | gives offsets of each Gaussian at any time, for motion that is not rigid |
//! | deformation field | motion of each Gaussian by another method (Deformable-3DGS, 4D-GS, SC-GS) |
//! | association | which superpoints a Gaussian follows while training, with weights |
//! | tile, tile instance | a square of 16×16 pixels; a pair of a splat and a tile that it touches |
//! | α, T | opacity of a splat in a pixel; transmittance, the share of light that still passes |
//! | kernel, twin | a compute shader; the CPU function that computes the same, for tests |
//! | subgroup, lane | invocations that run together, 4 to 128 of them; one of them |
//! | f64 reference | the image by its definition, computed in f64 on the CPU ([`mod@reference`]) |
//! | ground truth | an image of a data set that a render is compared with |
//! | oracle | images and gradients of an independent float64 implementation (`spgs-dev oracle-check`) |
//! | knob, preset | one setting that trades error for speed; a named set of them ([`render::Quality`]) |
//! | rejected | counted, named in a warning, and left out: a Gaussian that cannot be drawn, a file's unknown part |
//! | lavapipe | Mesa's Vulkan driver for CPUs |

#![deny(unsafe_code)]

pub mod confidence;
pub mod data;
pub mod distill;
pub mod edit;
pub mod error;
pub mod file;
#[allow(unsafe_code, reason = "raw Vulkan calls")]
pub mod gpu;
pub mod image;
pub mod manual;
pub mod metrics;
pub mod pose;
pub mod reference;
pub mod render;
pub mod scene;
pub mod self_test;
pub mod train;

pub use error::{Error, Result};

/// Every kernel of the engine: of metrics, of the renderer, of the self-test, then of training.
pub fn kernels() -> impl Iterator<Item = &'static gpu::kernel::Kernel> {
    let rest = metrics::lpips::KERNELS.iter().chain(render::KERNELS).chain(self_test::KERNELS);
    rest.copied().chain(train::kernels())
}
