//! The one error type of the engine. Every variant names the object, the place, what was found and what was expected.

use std::path::{Path, PathBuf};

/// Result of every fallible engine call.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong, grouped as the exit codes of the command line are (see [`Error::exit_code`]).
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The caller asked for something that makes no sense (a usage error).
    #[error("{what}: found {found}, expected {expected}")]
    Usage {
        /// The argument or option.
        what: String,
        /// What was given.
        found: String,
        /// What would have been accepted.
        expected: String,
    },
    /// A file is malformed. `at` is a byte offset, line, element or tensor name.
    #[error("{}: at {at}: found {found}, expected {expected}", path.display())]
    Corrupt {
        /// The file.
        path: PathBuf,
        /// Byte offset, line, element or tensor.
        at: String,
        /// What the file holds there.
        found: String,
        /// What a valid file holds there.
        expected: String,
    },
    /// The operating system refused a file operation.
    #[error("{}: {action}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was being done ("open", "write", "fsync", "rename").
        action: &'static str,
        /// The system's error.
        source: std::io::Error,
    },
    /// A number is not finite where it must be.
    #[error("{what} [{index}] is {value}, expected a finite number")]
    NonFinite {
        /// The array or field.
        what: String,
        /// Element.
        index: usize,
        /// The value, as text ("NaN", "inf").
        value: String,
    },
    /// A request exceeds what the device, the format or the engine can hold.
    #[error("{what}: need {need}, limit is {have}")]
    Limit {
        /// The resource.
        what: String,
        /// Amount needed, in the resource's unit.
        need: u128,
        /// Amount allowed.
        have: u128,
    },
    /// Device or host memory is exhausted, or the byte budget is.
    #[error("out of memory for `{name}`: need {need} bytes, {free} of the {budget} byte budget are free")]
    OutOfMemory {
        /// Name of the allocation.
        name: String,
        /// Bytes asked for.
        need: u64,
        /// Bytes free in the budget.
        free: u64,
        /// The budget.
        budget: u64,
    },
    /// No usable Vulkan device; `reason` lists each device and what it lacks.
    #[error("no usable Vulkan device: {reason}")]
    NoDevice {
        /// Why each candidate was refused.
        reason: String,
    },
    /// A Vulkan call failed.
    #[error("Vulkan: {call} returned {code}")]
    Vulkan {
        /// The call.
        call: &'static str,
        /// The result code, as text.
        code: String,
    },
    /// The device was lost.
    #[error(
        "device lost in submission {submission} (`{label}`); last finished kernel: {last_kernel}; running: {next_kernel}"
    )]
    DeviceLost {
        /// Counter of submissions since the device was made.
        submission: u64,
        /// Name of the recorded commands.
        label: String,
        /// Last kernel whose breadcrumb arrived.
        last_kernel: String,
        /// The kernel after it.
        next_kernel: String,
    },
    /// The device did not finish in time; it hangs, or it compiles or computes for longer than it was given.
    #[error(
        "no answer for {seconds} s (SPGS_TIMEOUT_S gives more) from `{label}`; last finished kernel: {last_kernel}; running: \
         {next_kernel}"
    )]
    TimedOut {
        /// Seconds that were waited.
        seconds: f64,
        /// Name of the recorded commands.
        label: String,
        /// Last kernel whose breadcrumb arrived.
        last_kernel: String,
        /// The kernel after it.
        next_kernel: String,
    },
    /// A device does not compute what it must (see [`crate::self_test`]).
    #[error(
        "device {device} ({driver}) fails the self-test: {why}; update its driver, choose another device (--device, SPGS_DEVICE; \
         `spgs devices` lists them), or go on at your own risk with SPGS_SELF_TEST=0"
    )]
    SelfTest {
        /// Its name.
        device: String,
        /// Name and version of its driver.
        driver: String,
        /// The kernel or check that failed, and the difference.
        why: String,
    },
    /// An error of a step that a text asked for, with its place there.
    #[error("{place}: {error}")]
    At {
        /// File, line and column, or what else names the step.
        place: String,
        /// What went wrong.
        error: Box<Error>,
    },
    /// A kernel's SPIR-V does not match its declaration, or what it computes not its twin.
    #[error("kernel `{kernel}`: {why}")]
    Kernel {
        /// Kernel name.
        kernel: String,
        /// What differs.
        why: String,
    },
}

impl Error {
    /// Exit code of the command line: 2 usage, 3 bad data, 4 limit or out of memory, 5 device lost, 6 not finite;
    /// 1 for anything else (no device, one that fails its self-test, a failing Vulkan call).
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::At { error, .. } => error.exit_code(),
            Self::Usage { .. } => 2,
            Self::Corrupt { .. } | Self::Io { .. } => 3,
            Self::Limit { .. } | Self::OutOfMemory { .. } => 4,
            Self::DeviceLost { .. } => 5,
            Self::NonFinite { .. } => 6,
            Self::NoDevice { .. }
            | Self::Vulkan { .. }
            | Self::TimedOut { .. }
            | Self::SelfTest { .. }
            | Self::Kernel { .. } => 1,
        }
    }

    /// A malformed file.
    pub fn corrupt(path: &Path, at: impl Into<String>, found: impl Into<String>, expected: impl Into<String>) -> Self {
        Self::Corrupt { path: path.into(), at: at.into(), found: found.into(), expected: expected.into() }
    }

    /// A failed file operation.
    pub fn io(path: &Path, action: &'static str, source: std::io::Error) -> Self {
        Self::Io { path: path.into(), action, source }
    }

    /// A usage error.
    pub fn usage(what: impl Into<String>, found: impl Into<String>, expected: impl Into<String>) -> Self {
        Self::Usage { what: what.into(), found: found.into(), expected: expected.into() }
    }
}
