//! Not-finite reports of the training kernels: the Rust mirror of `glsl/lib/status.glsl`.

/// Parameter groups that can be reported, in the order of the status words.
pub const GROUPS: [&str; 10] = [
    "mean",
    "log_scale",
    "rotation",
    "opacity_logit",
    "sh",
    "network F",
    "association",
    "network G",
    "image gradient",
    "pose",
];
/// Words of the `status` buffer: count and first index per group.
pub const STATUS_WORDS: usize = 2 * GROUPS.len();

/// The state before anything is reported.
pub fn clear() -> [u32; STATUS_WORDS] {
    std::array::from_fn(|i| if i % 2 == 0 { 0 } else { u32::MAX })
}

/// Adds a report to a twin's `status` words.
pub fn report(words: &mut [u32], group: usize, index: u32) {
    words[2 * group] += 1;
    words[2 * group + 1] = words[2 * group + 1].min(index);
}

/// The first group with a report: its name, how many, and the first index.
pub fn first(words: &[u32]) -> Option<(&'static str, u32, u32)> {
    let found = GROUPS.iter().zip(words.chunks_exact(2)).find(|(_, w)| w[0] > 0);
    found.map(|(name, w)| (*name, w[0], w[1]))
}
