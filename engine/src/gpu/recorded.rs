//! What was recorded, as a model of its cost sees it: no handles, nothing of Vulkan.

use super::commands::Commands;
use super::kernel::Kernel;
use super::memory::{Memory, Slice};
use super::operation::{Grid, Operation, Work};

/// One operation of a recording.
#[derive(Debug, Clone)]
pub struct RecordedOperation {
    /// Its label in timings and plan.
    pub label: String,
    /// Whether a barrier comes before it.
    pub barrier: bool,
    /// What it does.
    pub task: RecordedTask,
}

/// What an operation does.
#[derive(Debug, Clone)]
pub enum RecordedTask {
    /// Runs a kernel.
    Dispatch {
        /// The kernel.
        kernel: &'static Kernel,
        /// Specialisation constants, from id 1 on: the subgroup size is left out.
        constants: Vec<u32>,
        /// Push constants.
        push: Vec<u8>,
        /// Workgroups; `None` where the device decides.
        groups: Option<u64>,
    },
    /// Moves bytes.
    Transfer {
        /// Bytes read.
        read: u64,
        /// Bytes written.
        written: u64,
        /// Whether they come from memory that the host writes.
        from_host: bool,
        /// Whether they go to memory that the host reads.
        to_host: bool,
    },
    /// Makes what was written visible to the host.
    HostRead,
}

impl RecordedOperation {
    fn of(operation: &Operation) -> Self {
        let of_host = |slice: &Slice| slice.buffer.memory() != Memory::Device;
        let task = match &operation.work {
            Work::Dispatch { kernel, constants, push, grid, .. } => RecordedTask::Dispatch {
                kernel,
                constants: constants.clone(),
                push: push.clone(),
                groups: match grid {
                    Grid::Direct(groups) => Some(groups.iter().map(|g| u64::from(*g)).product()),
                    Grid::Indirect(..) => None,
                },
            },
            Work::Fill { slice, .. } | Work::Update { slice, .. } => {
                RecordedTask::Transfer { read: 0, written: slice.bytes, from_host: false, to_host: of_host(slice) }
            }
            Work::Copy { source, destination, .. } => RecordedTask::Transfer {
                read: source.bytes,
                written: source.bytes,
                from_host: of_host(source),
                to_host: of_host(destination),
            },
            Work::CopyToImage { slice, .. } => RecordedTask::Transfer {
                read: slice.bytes,
                written: slice.bytes,
                from_host: of_host(slice),
                to_host: false,
            },
            Work::HostRead => RecordedTask::HostRead,
        };
        Self { label: operation.label.clone(), barrier: operation.barrier.is_some(), task }
    }
}

impl Commands {
    /// Its operations, in order.
    pub fn recorded(&self) -> Vec<RecordedOperation> {
        self.recorded_operations().iter().map(RecordedOperation::of).collect()
    }
}
