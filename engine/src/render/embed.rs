//! The renderer inside another program: scenes on its device, frames in its command buffers, pictures in its images.
//!
//! ```no_run
//! # fn main() -> engine::Result<()> {
//! use engine::gpu::{Gpu, GpuOptions, HostCommandBuffer, HostDevice, HostImage, ImageUse};
//! use engine::render::{PixelFormat, SceneHandle, SceneOptions, Target, View, ViewOptions};
//! # let (instance, physical_device, device, queue, command_buffer, image) = (0, 0, 0, 0, 0, 0);
//! # let scene = engine::scene::synthetic::demo_scene();
//! # let camera = engine::scene::synthetic::demo_camera(0.0, 640, 480);
//!
//! // Once: the host's device, a scene on it, a view.
//! let host = HostDevice {
//!     get_instance_proc_addr: None,
//!     api_version: 0x0040_3000, // VK_API_VERSION_1_3
//!     instance,
//!     physical_device,
//!     device,
//!     queue,
//!     queue_family: 0,
//!     queue_lock: None,
//! };
//! // SAFETY: the handles are this program's own and outlive `gpu`; the device has what `host_requirements` lists.
//! let gpu = unsafe { Gpu::from_host(&host, &GpuOptions::default())? };
//! let scene = SceneHandle::upload(&gpu, &scene, &SceneOptions::default())?;
//! let options = ViewOptions { format: PixelFormat::Rgba16F, in_flight: 2, ..ViewOptions::default() };
//! let mut view = View::new(&gpu, &scene, &options)?;
//! view.warm_up(&camera, 0.0)?;
//!
//! // In every frame, between vkBeginCommandBuffer and vkEndCommandBuffer, outside of a render pass:
//! // SAFETY: the command buffer is being recorded, the image is 640×480 RGBA16F with usage TRANSFER_DST.
//! let (commands, color) = unsafe {
//!     let color = HostImage::from_raw(image, ImageUse::DISCARD_AFTER_SAMPLING, ImageUse::FRAGMENT_SAMPLED);
//!     (HostCommandBuffer::from_raw(command_buffer), color)
//! };
//! view.record(&commands, &camera, 0.25, &Target { color, depth: None })?;
//! # Ok(())
//! # }
//! ```
//!
//! # What is recorded, and what the host does around it
//!
//! A frame is about 15 compute dispatches between barriers. Its pixels reach the image in one of two ways:
//!
//! - **Copied** (the default): one copy per image from a buffer in which `blend_packed` has left the pixels in the image's format.
//!   That works for every colour format, for swapchains too (sRGB and BGRA among them), and needs no view of the host's images.
//! - **Stored** ([`ViewOptions::storage`]): the last kernel writes the host's image through a view that comes with it
//!   ([`HostImage::with_storage_view`](crate::gpu::HostImage::with_storage_view)). No copy, a third of the bytes. For RGBA8, RGBA16F and RGBA32F, which every device can
//!   store; of half floats the device rounds to nearest or towards zero. Depth is always copied.
//!
//! Around it:
//!
//! - **Before**: the image is in [`ImageUse::layout`](crate::gpu::ImageUse) of `before`; its stages and accesses are waited for, then the
//!   layout becomes `TRANSFER_DST_OPTIMAL` (`GENERAL` when it is stored to). The wait is at the start of the frame, so that it
//!   overlaps with nothing of it.
//! - **After**: the layout is that of `after`, and the pixels are visible to its stages and accesses. No further barrier is
//!   needed on the same queue; another queue waits for a semaphore, and another family takes ownership.
//! - **Semaphores** are the host's: the engine neither waits for nor signals any in `record`. For a swapchain, wait for the
//!   acquisition at stage `TRANSFER`, `COMPUTE_SHADER` for an image that is stored to (or `ALL_COMMANDS`), and name that stage
//!   in `before`, as [`ImageUse::UNDEFINED`](crate::gpu::ImageUse::UNDEFINED) does: the change of layout waits for it then, too.
//! - **Memory**: each view has its own intermediate buffers, shared by its frames: the barrier at the start of each frame
//!   orders them after one another. One view may be recorded several times into one command buffer.
//! - **Nothing waits and nothing is allocated** in `record`, on the host or on the device, once a view has seen its image
//!   size and its largest frame.
//! - **Frames in flight**: when `record` is called for the (k + [`ViewOptions::in_flight`])-th time, the commands of the
//!   k-th call have finished. That is a host with as many fences as frames in flight, which it has anyway. Only by this
//!   promise the view knows when it may free buffers and read counters.
//! - **Growth**: a frame that needs more tile instances than the buffers hold, all together or in one tile, shows the background
//!   only. Room that becomes scarce is made larger before that. The call that
//!   finds this out, `in_flight` calls later, makes larger buffers and records with them; the old ones go when they are
//!   not in use any more. [`View::warm_up`] finds the size beforehand, so that no frame is lost.
//! - **Trust**: a host's device is taken as it is. [`Gpu::self_test`](crate::gpu::Gpu::self_test) says whether its driver computes what it
//!   must ([`crate::self_test`]); it takes a fraction of a second, and nothing else may work on the engine's queue meanwhile.
//! - **Threads**: [`Gpu`](crate::gpu::Gpu) and [`SceneHandle`] are `Send` and `Sync`; [`View`] and [`Loading`] are `Send`. Different views
//!   may be recorded on different threads at the same time, also of one scene, into command buffers of different pools.
//!   Views of one scene that has network F or G or a deformation field share its output and its intermediate buffers, so their
//!   command buffers execute one after another, as those of one view do ([`SceneHandle::one_after_another`] says whether it
//!   is so); those of other scenes may overlap.
//!
//! # What a scene tells
//!
//! [`SceneHandle::extent`]: the first and last time of its motion, and a ball that holds most of it, for a time line and a first
//! camera. `time` of `record` is not bound to that range: see [`View::record`]. [`SceneHandle::rejected`] and
//! [`SceneHandle::warnings`] say what reading its file left out. A scene is shown by views of the [`Gpu`](crate::gpu::Gpu) that it
//! was uploaded with, or of a clone.
//!
//! # Depth
//!
//! With [`ViewOptions::depth`], a second image (`R32_SFLOAT`) gets Σ z α T: camera-space z (along the viewing direction, in
//! world units), weighted as the colour is. Divided by A of the same pixel it is the mean depth of what is seen there:
//! a mesh in front of it hides the scene, a mesh behind it is seen through it. For a depth buffer with the projection
//! matrix P: z_ndc = (P₂₂ z + P₂₃) / (P₃₂ z + P₃₃) with z measured as P expects it.
//!
//! # Stability of this interface
//!
//! [`crate::render::embed`], [`crate::gpu::host`] and the C header `spgs.h` follow semantic versioning from version 1.0 on: within a
//! major version no function, field or value changes its meaning or goes away, structures of the header only grow at their
//! end (they carry their size), and the images keep their definition. Before 1.0, minor versions may change them; the
//! CHANGELOG says how. What is not documented, kernels and buffers in particular, may change at any time.

mod check;
mod extent;
mod options;
mod scene;
mod view;

pub use extent::Extent;
pub use options::{Finished, Recorded, Target, ViewOptions};
pub use scene::{Loading, SceneHandle, SceneOptions};
pub use view::View;

/// What the module's page says of threads, checked by the compiler.
const _: () = {
    const fn send<T: Send>() {}
    const fn sync<T: Sync>() {}
    send::<crate::gpu::Gpu>();
    sync::<crate::gpu::Gpu>();
    send::<SceneHandle>();
    sync::<SceneHandle>();
    send::<View>();
    send::<Loading>();
    send::<crate::gpu::Sequence>();
    sync::<crate::gpu::Sequence>();
};
