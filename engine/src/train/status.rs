//! Not-finite reports of the training kernels: the Rust mirror of `glsl/lib/status.glsl`.

use crate::scene::parameter::PARAMETERS;

/// Groups that can be reported after the Gaussians' [`PARAMETERS`], in the order of the status words.
const OTHER: [&str; 5] = ["network F", "association", "network G", "image gradient", "pose"];
/// Group of network F.
pub const NETWORK_F: usize = PARAMETERS.len();
/// Group of the association.
pub const ASSOCIATION: usize = NETWORK_F + 1;
/// Group of network G.
pub const NETWORK_G: usize = NETWORK_F + 2;
/// Group of the image's gradient.
pub const IMAGE_GRADIENT: usize = NETWORK_F + 3;
/// Group of the poses.
pub const POSE: usize = NETWORK_F + 4;
/// Words of the `status` buffer: count and first index per group, to a multiple of 16 bytes, as buffers are.
pub const STATUS_WORDS: usize = (2 * (PARAMETERS.len() + OTHER.len())).next_multiple_of(4);

/// The state before anything is reported.
pub fn clear() -> [u32; STATUS_WORDS] {
    std::array::from_fn(|i| if i % 2 == 0 { 0 } else { u32::MAX })
}

/// Adds a report to a twin's `status` words.
pub fn report(words: &mut [u32], group: usize, index: u32) {
    words[2 * group] += 1;
    words[2 * group + 1] = words[2 * group + 1].min(index);
}

/// All reports of two `status` buffers.
pub(super) fn joined(a: &[u32], b: &[u32]) -> Vec<u32> {
    let join = |(i, (a, b)): (usize, (&u32, &u32))| if i % 2 == 0 { a.saturating_add(*b) } else { *a.min(b) };
    a.iter().zip(b).enumerate().map(join).collect()
}

/// The first group with a report: its name, how many, and the first index.
pub fn first(words: &[u32]) -> Option<(&'static str, u32, u32)> {
    let names = PARAMETERS.iter().map(|p| p.name).chain(OTHER);
    let found = names.zip(words.chunks_exact(2)).find(|(_, w)| w[0] > 0);
    found.map(|(name, w)| (name, w[0], w[1]))
}
