//! Accessors for CPU twins: their buffers are 32-bit words, as the GPU sees them.

/// Word `i` as a float.
pub fn f32_at(words: &[u32], i: usize) -> f32 {
    f32::from_bits(words[i])
}

/// `vec2` number `i` of a buffer of `vec2`.
pub fn vec2_at(words: &[u32], i: usize) -> [f32; 2] {
    [f32_at(words, 2 * i), f32_at(words, 2 * i + 1)]
}

/// `vec4` number `i` of a buffer of `vec4`.
pub fn vec4_at(words: &[u32], i: usize) -> [f32; 4] {
    std::array::from_fn(|j| f32_at(words, 4 * i + j))
}

/// Stores a float in word `i`.
pub fn set_f32(words: &mut [u32], i: usize, value: f32) {
    words[i] = value.to_bits();
}

/// Stores `vec4` number `i` of a buffer of `vec4`.
pub fn set_vec4(words: &mut [u32], i: usize, value: [f32; 4]) {
    for (j, v) in value.into_iter().enumerate() {
        words[4 * i + j] = v.to_bits();
    }
}

/// The struct that starts at word `at`.
pub fn struct_at<T: bytemuck::AnyBitPattern>(words: &[u32], at: usize) -> T {
    bytemuck::pod_read_unaligned(&bytemuck::cast_slice(&words[at..])[..size_of::<T>()])
}

/// Group counts of a folded grid of `n` workgroups, as `folded_groups` in `glsl/lib/dispatch.glsl` makes them.
pub fn folded_groups(n: u32) -> [u32; 3] {
    let x = n.min(65_535);
    [x, if x == 0 { 0 } else { n.div_ceil(x) }, 1]
}
