//! How a device is chosen and opened.

use std::ffi::CString;
use std::sync::atomic::{AtomicBool, Ordering};

static LOST: AtomicBool = AtomicBool::new(false);

/// From now on devices are opened with breadcrumbs.
pub(super) fn note_loss() {
    LOST.store(true, Ordering::SeqCst);
}

/// Whether this process has lost a device.
pub(super) fn has_lost() -> bool {
    LOST.load(Ordering::SeqCst)
}

/// Whether a device must have proven itself before it is used (see [`crate::self_test`]).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SelfTest {
    /// It is taken as it is.
    Skip,
    /// It is tested at its first use with this driver and these shaders; the verdict is kept.
    Once,
    /// It is tested now, whatever is known of it.
    Again,
}

/// How to make a [`Gpu`](super::Gpu). The defaults come from the environment: `SPGS_DEVICE`, `SPGS_VALIDATION=1`,
/// `SPGS_BREADCRUMBS=0|1`, `SPGS_TIMEOUT_S`, `SPGS_SUBGROUP_SIZE`, `SPGS_SELF_TEST=0`, `SPGS_TEXEL_READS=0`.
#[derive(Debug, Clone)]
pub struct GpuOptions {
    /// Index in `spgs devices`, or part of the device's name. `None`: discrete before integrated before virtual before CPU.
    pub device: Option<String>,
    /// Enable the Khronos validation layer with synchronisation validation; its messages are collected. A process should have one
    /// device at a time then: a layer up to version 1.3.296 can crash when a thread opens or closes a device while another uses
    /// its own.
    pub validation: bool,
    /// With `validation`: GPU-assisted checks (reads and writes past the end of a buffer) instead of synchronisation
    /// validation. `SPGS_GPU_ASSISTED=1`.
    pub gpu_assisted: bool,
    /// Note each operation in host-visible memory, so that a lost device names its last kernel: a small write and a wider
    /// barrier per operation. Off unless `SPGS_BREADCRUMBS=1`; a device that is opened after this process has lost one notes them
    /// anyway.
    pub breadcrumbs: bool,
    /// Bytes of device memory the engine may allocate; `None`: 80 % of the largest device-local heap, or what is free of it
    /// where the device tells, asked again when that runs out ([`super::budget`]).
    pub byte_budget: Option<u64>,
    /// Take a queue that draws too, where there is one: for a window, or for a host that draws on the engine's device
    /// ([`super::queue_family`]).
    pub draws: bool,
    /// Keep compiled pipelines in the user's cache folder.
    pub pipeline_cache: bool,
    /// Seconds before a wait for the device gives up.
    pub timeout_s: f64,
    /// The subgroup size of every kernel, where the device can pin it; `None`: that of
    /// [`CHOICES`](super::subgroup_size::CHOICES). `SPGS_SUBGROUP_SIZE`.
    pub subgroup_size: Option<u32>,
    /// Read through texel buffers where the driver is faster with them ([`super::texels`]). `SPGS_TEXEL_READS=0`: never.
    pub texel_reads: bool,
    /// Pipelines keep what the driver's compiler says of them ([`Gpu::compiled_kernels`](super::Gpu::compiled_kernels)).
    pub statistics: bool,
    /// Instance extensions that the caller needs beside the engine's, for a window's surface; a loader without one of
    /// them is refused.
    pub instance_extensions: Vec<CString>,
    /// Device extensions that the caller needs beside the engine's, such as `VK_KHR_swapchain`; devices without one of
    /// them are not chosen.
    pub device_extensions: Vec<CString>,
    /// Whether [`Gpu::new`](super::Gpu::new) wants a device that has passed the self-test.
    pub self_test: SelfTest,
    /// The device is to train: its training kernels are tested too.
    pub training: bool,
    /// Test seam: SPIR-V words that take the place of a kernel's own.
    #[doc(hidden)]
    pub replace_spirv: Vec<(&'static str, Vec<u32>)>,
}

impl Default for GpuOptions {
    fn default() -> Self {
        let flag = |name: &str, default: bool| std::env::var(name).map_or(default, |v| v != "0" && !v.is_empty());
        let timeout = std::env::var("SPGS_TIMEOUT_S").ok().and_then(|v| v.parse().ok());
        let subgroup_size = std::env::var("SPGS_SUBGROUP_SIZE").ok().and_then(|v| v.parse().ok());
        Self {
            device: std::env::var("SPGS_DEVICE").ok().filter(|v| !v.is_empty()),
            validation: flag("SPGS_VALIDATION", false),
            gpu_assisted: flag("SPGS_GPU_ASSISTED", false),
            breadcrumbs: flag("SPGS_BREADCRUMBS", false),
            byte_budget: None,
            draws: false,
            pipeline_cache: true,
            timeout_s: timeout.unwrap_or(60.0),
            subgroup_size,
            texel_reads: flag("SPGS_TEXEL_READS", true),
            statistics: false,
            instance_extensions: Vec::new(),
            device_extensions: Vec::new(),
            self_test: if flag("SPGS_SELF_TEST", true) { SelfTest::Once } else { SelfTest::Skip },
            training: false,
            replace_spirv: Vec::new(),
        }
    }
}
