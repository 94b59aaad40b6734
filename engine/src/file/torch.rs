//! PyTorch weights (`.pth`, `.pt`): a zip of a pickle and raw arrays, read without ever running code.
//!
//! A pickle is a program for a stack machine that can call any function. `pickle` understands the few instructions that
//! weights need, and a call only of `OrderedDict`, `_rebuild_tensor_v2`, `_rebuild_parameter` and `torch.Size`, whose
//! results are plain data here; anything else is an error that names it. Nothing is imported, and memory is bounded by
//! the size of the pickle; arrays stay in the file until they are asked for.

mod pickle;
mod tensors;

pub use tensors::Weights;

/// Name of the pickle in the archive.
const PICKLE: &str = "data.pkl";

/// The folder within an archive that holds the pickle.
pub(crate) fn prefix(names: &[String]) -> Option<String> {
    let found = names.iter().filter(|n| n.rsplit('/').next() == Some(PICKLE)).min_by_key(|n| n.len())?;
    Some(found[..found.len() - PICKLE.len()].to_owned())
}
