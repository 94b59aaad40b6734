//! The GPU layer: raw Vulkan through `ash`. The only module that may name `ash` or write `unsafe`; it knows nothing of
//! Gaussians.
//!
//! [`Gpu`] opens a device ([`capability::REQUIREMENTS`] is the table of what it must have). [`Kernel`] declares a compute
//! shader once. [`Recorder`] collects operations, derives the barriers from the declared accesses (`access`) and, where that is
//! asked for, an order in which independent ones run beside each other (`schedule`), and becomes
//! [`Commands`], which are submitted again and again, several in flight, or a [`Sequence`], which is written into the
//! command buffers of another program ([`host`]).

#[doc(hidden)]
pub mod access;
mod account;
mod barrier;
pub mod budget;
mod cache_folder;
pub mod capability;
mod commands;
mod device;
pub mod host;
mod instance;
#[doc(hidden)]
pub mod interface;
pub mod kernel;
mod memory;
#[doc(hidden)]
pub mod mmap;
mod operation;
mod options;
#[cfg(feature = "window")]
pub mod painter;
mod pipeline;
#[cfg(feature = "window")]
pub mod presenter;
#[doc(hidden)]
pub mod product;
#[doc(hidden)]
pub mod proof;
pub mod queue_family;
pub mod reconvergence;
mod recorded;
mod recorder;
#[doc(hidden)]
pub mod schedule;
mod sequence;
#[doc(hidden)]
pub mod spirv;
mod statistics;
pub mod subgroup_size;
#[cfg(feature = "window")]
mod surface;
#[cfg(feature = "window")]
mod swapchain;
pub mod texels;
#[cfg(feature = "window")]
mod texture;
mod timestamps;
mod trust;

pub use cache_folder::cache_folder;
pub use capability::{Capabilities, DeviceInfo};
pub use commands::{Commands, Submission};
pub(crate) use device::cache_path;
pub use device::{Gpu, devices};
pub use host::{HostCommandBuffer, HostDevice, HostImage, ImageUse, QueueLock};
pub use kernel::Kernel;
pub use memory::{Buffer, Memory, Slice};
pub use options::{GpuOptions, SelfTest};
pub use recorded::{RecordedOperation, RecordedTask};
pub use recorder::{Groups, Recorder, SLICE_ALIGNMENT};
pub use sequence::Sequence;
pub use statistics::{CompiledKernel, Statistic};
#[cfg(feature = "window")]
pub use surface::{Surface, WindowHandle};
pub use timestamps::Timing;
pub use trust::Suite;
