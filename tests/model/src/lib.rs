//! An executable model of subgroups: runs a compute kernel's SPIR-V on the host at any subgroup size from 4 to 128, without a
//! Vulkan device, and says what no software driver can show.
//!
//! - A subgroup runs in lockstep under a mask; lanes that part at a selection or loop meet again at its merge, never before.
//! - Subgroups of a workgroup, and a few workgroups at a time, take turns at random points (memory accesses, barriers); the
//!   same seed gives the same order.
//! - Reported as an error that names the function and the memory: a race (see `run/memory.rs` for the rule), an index past
//!   the end of a buffer or array, a shared word that is read before it is written, a barrier that not all invocations of its
//!   scope reach.
//! - What SPIR-V leaves undefined (a variable before its first store, a shuffle from an inactive lane, a shift by 32) is a
//!   NaN, so that a result that depends on it differs from the twin's.
//!
//! Floats are f32 and rounded at each operation; nothing is contracted.

mod compile;
mod error;
mod facts;
mod module;
mod op;
mod run;

pub use error::{ModelError, Result};

/// A kernel with its specialisation constants.
#[derive(Debug)]
pub struct Program {
    code: compile::Code,
}

/// One dispatch.
#[derive(Debug)]
pub struct Dispatch<'a> {
    /// Workgroups in x, y, z.
    pub groups: [u32; 3],
    /// Push constants.
    pub push: &'a [u8],
    /// Words of each binding; of an image: its texels by rows.
    pub buffers: &'a mut [Vec<u32>],
    /// Texels in a row of the image, if there is one.
    pub image_width: u32,
}

/// How a dispatch is run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Options {
    /// Invocations of a subgroup: a power of two from 4 to 128.
    pub lanes: u32,
    /// Of the order of everything.
    pub seed: u64,
    /// Workgroups that run at the same time.
    pub groups_in_flight: u32,
    /// Most memory accesses of a subgroup before another may go on.
    pub burst: u32,
    /// A subgroup barrier waits for the whole workgroup, as in lavapipe since 25.0.
    pub subgroup_barrier_is_workgroup: bool,
    /// Invocations belong to subgroups in any order. Vulkan promises no order.
    pub shuffle_invocations: bool,
}

impl Options {
    /// The usual run.
    #[must_use]
    pub fn new(lanes: u32, seed: u64) -> Self {
        Self {
            lanes,
            seed,
            groups_in_flight: 3,
            burst: 64,
            subgroup_barrier_is_workgroup: false,
            shuffle_invocations: false,
        }
    }
}

impl Program {
    /// Reads a module. `spec`: specialisation constants by id; those that are missing keep their defaults.
    ///
    /// # Errors
    /// [`ModelError::Unsupported`] for SPIR-V that the model does not know.
    pub fn new(words: &[u32], spec: &[u32]) -> Result<Self> {
        Ok(Self { code: compile::Code::compile(&module::Module::parse(words, spec)?)? })
    }

    /// Runs a dispatch; buffers hold the result, also after an error.
    ///
    /// # Errors
    /// What is wrong with the kernel, or [`ModelError::Unsupported`] for a subgroup size that is no power of two from 4 to
    /// 128.
    pub fn run(&self, dispatch: &mut Dispatch<'_>, options: &Options) -> Result<()> {
        match options.lanes {
            4 => run::run::<4>(&self.code, dispatch, options),
            8 => run::run::<8>(&self.code, dispatch, options),
            16 => run::run::<16>(&self.code, dispatch, options),
            32 => run::run::<32>(&self.code, dispatch, options),
            64 => run::run::<64>(&self.code, dispatch, options),
            128 => run::run::<128>(&self.code, dispatch, options),
            lanes => error::unsupported(format!("a subgroup of {lanes}")),
        }
    }
}
