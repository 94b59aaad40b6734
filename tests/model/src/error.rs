//! What the model has to say about a kernel.

/// What went wrong, and where: the function, and the memory by the name of its block.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ModelError {
    /// SPIR-V that the model cannot read or does not know.
    #[error("not modelled: {0}")]
    Unsupported(String),
    /// Two invocations use a word, one of them writes, and nothing orders them.
    #[error("race on `{memory}`[{word}]: {first} and {second}, without a barrier between them")]
    Race {
        /// Buffer or shared variable.
        memory: String,
        /// Word within it.
        word: u32,
        /// The earlier access in this run.
        first: String,
        /// The later one.
        second: String,
    },
    /// An index past the end.
    #[error("`{memory}`[{index}] is past its end ({length}), in {place}")]
    OutOfBounds {
        /// Buffer or variable.
        memory: String,
        /// Word or element.
        index: u32,
        /// How many there are.
        length: u32,
        /// Function.
        place: String,
    },
    /// Shared memory has no value before it is written.
    #[error("`{memory}`[{word}] is read in {place} before anything was written to it")]
    NeverWritten {
        /// Shared variable.
        memory: String,
        /// Word within it.
        word: u32,
        /// Function.
        place: String,
    },
    /// A barrier that not all lanes of a subgroup reach together.
    #[error("{barrier} in flow that is not uniform: {active} of {lanes} lanes of subgroup {subgroup} reach it")]
    DivergentBarrier {
        /// Which barrier.
        barrier: String,
        /// Lanes that reach it.
        active: u32,
        /// Lanes of the subgroup.
        lanes: u32,
        /// The subgroup.
        subgroup: u32,
    },
    /// A barrier that not all subgroups of a workgroup reach.
    #[error("subgroup {subgroup} waits at {barrier}, but subgroup {other} {where_other}")]
    BarrierMismatch {
        /// Which barrier.
        barrier: String,
        /// Who waits.
        subgroup: u32,
        /// Who does not come.
        other: u32,
        /// Where that one is.
        where_other: String,
    },
    /// Far more rounds of loops than any kernel needs.
    #[error("no end after {0} rounds of loops")]
    Endless(u64),
}

/// Result of the model.
pub type Result<T> = std::result::Result<T, ModelError>;

pub(crate) fn unsupported<T>(what: impl Into<String>) -> Result<T> {
    Err(ModelError::Unsupported(what.into()))
}
