//! Model files (`.safetensors`, 3DGS `.ply`) and pictures, read strictly and written durably.

pub mod durable;
pub mod ply;
