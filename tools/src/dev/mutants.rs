//! `spgs-dev mutants`: plants single faults in the GLSL and runs the tests that cover the kernel. A fault that no test sees
//! is a hole in the tests, or a change that means nothing.
//!
//! `lexer` splits a shader into tokens, `sites` lists what can be changed, `plant` compiles a mutant, `cover` knows
//! which test runs which kernel, `suite` runs tests from outside, `judge` decides whether a mutant is seen, `results`
//! remembers, `equivalent` lists mutants that change nothing. No Rust is compiled for a mutant: the tests read its SPIR-V from a folder (`SPGS_TEST_SPIRV`).

mod cover;
mod equivalent;
mod judge;
mod lexer;
mod plant;
mod results;
mod sites;
mod store;
mod suite;
pub mod task;
