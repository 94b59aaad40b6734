//! The C interface: `include/spgs.h` is its documentation. Each function checks its pointers, calls the Rust API and turns
//! the result into a status; nothing unwinds across the border.
#![allow(clippy::missing_safety_doc, reason = "spgs.h says what each call demands")]

mod gpu;
mod scene;
mod status;
mod texts;
mod types;
mod view;

pub use gpu::*;
pub use scene::*;
pub use status::{spgs_message, spgs_version};
pub use types::*;
pub use view::*;
