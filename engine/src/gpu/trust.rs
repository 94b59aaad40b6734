//! What a device must have proven before it is used for it.
//!
//! This layer asks; [`crate::self_test`], which knows the kernels, answers. A device without a prover ([`Gpu::open`],
//! [`Gpu::from_host`]) is trusted.

use std::sync::{Mutex, OnceLock};

use serde::{Deserialize, Serialize};

use super::device::{Gpu, lock};
use crate::error::Result;

/// What a device may be used for, each with tests of its own, which are run when it is first used so.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Suite {
    /// Frames of a table of poses, exact. Every device that is opened.
    Frame,
    /// Frames in reduced quality or with depth, and pixels as windows and other programs take them.
    Packed,
    /// Networks F and G that run in every frame.
    Networks,
    /// Soft superpoints.
    Soft,
    /// Deformation fields.
    Fields,
    /// Training of the rigid stage, with density control.
    Training,
    /// Training with soft superpoints.
    #[serde(rename = "soft-training")]
    SoftTraining,
    /// Training of the non-rigid stage.
    Nonrigid,
}

impl Suite {
    /// All of them, in the order in which they are run.
    pub const ALL: [Self; 8] = [
        Self::Frame,
        Self::Packed,
        Self::Networks,
        Self::Soft,
        Self::Fields,
        Self::Training,
        Self::SoftTraining,
        Self::Nonrigid,
    ];

    /// Whether this is about training.
    pub fn trains(self) -> bool {
        matches!(self, Self::Training | Self::SoftTraining | Self::Nonrigid)
    }

    /// `frame`, `packed`, …
    pub fn name(self) -> &'static str {
        match self {
            Self::Frame => "frame",
            Self::Packed => "packed",
            Self::Networks => "networks",
            Self::Soft => "soft",
            Self::Fields => "fields",
            Self::Training => "training",
            Self::SoftTraining => "soft-training",
            Self::Nonrigid => "nonrigid",
        }
    }
}

/// Tests a device for a use.
pub(crate) type Prover = fn(&Gpu, Suite) -> Result<()>;

/// Who is asked, and what was asked already.
#[derive(Default)]
pub(super) struct Trust {
    prover: OnceLock<Prover>,
    asked: Mutex<Vec<Suite>>,
}

impl Gpu {
    /// From now on the prover is asked before the first use of each kind.
    pub(crate) fn trust_after(&self, prover: Prover) {
        let _ = self.0.trust.prover.set(prover);
    }

    /// The tests of a suite are about to run; whether this is the first time. They use the device themselves.
    pub(crate) fn begin_proof(&self, suite: Suite) -> bool {
        let mut asked = lock(&self.0.trust.asked);
        let first = !asked.contains(&suite);
        if first {
            asked.push(suite);
        }
        first
    }

    /// A suite has failed: it is asked for again before the next use.
    pub(crate) fn fail_proof(&self, suite: Suite) {
        lock(&self.0.trust.asked).retain(|asked| *asked != suite);
    }

    /// Called before kernels of a suite are first used. While its tests run, others that ask pass: the tests use the device
    /// in the same way.
    ///
    /// # Errors
    /// `SelfTest` when the device fails, each time.
    pub(crate) fn ready_for(&self, suite: Suite) -> Result<()> {
        let Some(prover) = self.0.trust.prover.get() else { return Ok(()) };
        if !self.begin_proof(suite) {
            return Ok(());
        }
        prover(self, suite).inspect_err(|_| self.fail_proof(suite))
    }
}
