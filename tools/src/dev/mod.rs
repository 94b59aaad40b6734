//! The tasks of `spgs-dev`.

pub mod isa;
pub mod kernel_docs;
pub mod measurements;
pub mod mutants;
pub mod oracle;
pub mod pictures;
pub mod plan;
pub mod spirv;
pub mod uniform_flow;
