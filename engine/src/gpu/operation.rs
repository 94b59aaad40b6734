//! What a recording is made of.

use super::access::{Barrier, Use};
use super::kernel::Kernel;
use super::memory::{Buffer, Slice};
use super::pipeline::Pipeline;

pub(super) enum Work {
    Fill {
        slice: Slice,
        value: u32,
    },
    /// `slot_bytes`: the destination moves by that much from slot to slot.
    Copy {
        source: Slice,
        destination: Slice,
        slot_bytes: u64,
    },
    /// Bytes that are given when the sequence is encoded.
    Update {
        slice: Slice,
        slot_bytes: u64,
    },
    /// To an image that is given when the sequence is encoded; `size` in pixels.
    CopyToImage {
        slice: Slice,
        size: [u32; 2],
    },
    Dispatch {
        kernel: &'static Kernel,
        /// Specialisation constants from id 1 on.
        constants: Vec<u32>,
        pipeline: Pipeline,
        push: Vec<u8>,
        slices: Vec<Slice>,
        grid: Grid,
        /// It writes an image that is given when the sequence is encoded, and gets its first pixel as push constants.
        to_image: bool,
    },
    HostRead,
}

impl Work {
    /// What it reads and writes.
    pub(super) fn buffers(&self) -> Vec<&Buffer> {
        match self {
            Self::Fill { slice, .. } | Self::Update { slice, .. } | Self::CopyToImage { slice, .. } => {
                vec![&slice.buffer]
            }
            Self::Copy { source, destination, .. } => vec![&source.buffer, &destination.buffer],
            Self::Dispatch { slices, .. } => slices.iter().map(|s| &s.buffer).collect(),
            Self::HostRead => Vec::new(),
        }
    }
}

pub(super) enum Grid {
    Direct([u32; 3]),
    Indirect(Buffer, u64),
}

pub(super) struct Operation {
    pub(super) label: String,
    pub(super) work: Work,
    pub(super) uses: Vec<Use>,
    pub(super) barrier: Option<Barrier>,
}
