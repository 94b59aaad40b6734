//! Formats of the pixels that a frame ends in, as host programs take them.

use super::half::{self, HALF_MAX};

/// Format of the pixels that a frame ends in; always R, G, B = Σ c α T + T·background and A = 1 − T, which is premultiplied
/// colour when the background is black.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[repr(u32)]
pub enum PixelFormat {
    /// `VK_FORMAT_R8G8B8A8_UNORM` (or `_SRGB`: the bytes are the same), clamped to \[0, 1\] and rounded to the nearest level.
    #[default]
    Rgba8 = 0,
    /// `VK_FORMAT_B8G8R8A8_UNORM`, as [`PixelFormat::Rgba8`].
    Bgra8 = 1,
    /// `VK_FORMAT_R16G16B16A16_SFLOAT`, within ±65504.
    Rgba16F = 2,
    /// `VK_FORMAT_R32G32B32A32_SFLOAT`: the engine's own bits.
    Rgba32F = 3,
}

impl PixelFormat {
    /// Bytes of a pixel.
    pub fn bytes(self) -> u64 {
        [4, 4, 8, 16][self as usize]
    }

    /// Whether every device can store it in an image.
    pub(super) fn is_storable(self) -> bool {
        self != Self::Bgra8
    }

    /// A pixel as `blend_packed` stores it; the first [`PixelFormat::bytes`] count.
    pub fn pack(self, value: [f32; 4]) -> [u32; 4] {
        let half = |a: f32, b: f32| half::pack([a, b].map(|v| v.clamp(-HALF_MAX, HALF_MAX)));
        let level = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u32;
        let [r, g, b, a] = value;
        match self {
            Self::Rgba8 => [level(r) | level(g) << 8 | level(b) << 16 | level(a) << 24, 0, 0, 0],
            Self::Bgra8 => [level(b) | level(g) << 8 | level(r) << 16 | level(a) << 24, 0, 0, 0],
            Self::Rgba16F => [half(r, g), half(b, a), 0, 0],
            Self::Rgba32F => value.map(f32::to_bits),
        }
    }

    /// Colour and alpha of a stored pixel.
    pub fn unpack(self, words: &[u32]) -> [f32; 4] {
        let level = |shift: u32| ((words[0] >> shift) & 255) as f32 / 255.0;
        let half = |i: usize| half::to_f32(words[i / 2] >> (16 * (i % 2)) & 0xFFFF);
        match self {
            Self::Rgba8 => [level(0), level(8), level(16), level(24)],
            Self::Bgra8 => [level(16), level(8), level(0), level(24)],
            Self::Rgba16F => [half(0), half(1), half(2), half(3)],
            Self::Rgba32F => std::array::from_fn(|i| f32::from_bits(words[i])),
        }
    }
}
