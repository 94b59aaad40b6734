//! Constants that kernels share with the host; the Rust side of `glsl/lib/limits.glsl` (a test compares the two).

/// Pixels per tile edge.
pub const TILE_SIZE: u32 = 16;
/// Threads of every workgroup of the sort and tile kernels.
pub const SORT_THREADS: u32 = 256;
/// Most keys per thread of `sort_scatter`.
pub const SORT_ROUNDS: u32 = 16;
/// Keys per workgroup of `sort_scatter`: the largest partition.
pub const SORT_PARTITION: u32 = 4096;
/// Columns of a histogram row, whatever the digit's width.
pub const SORT_DIGITS: u32 = 256;
/// Elements per block sum of `instance_block`.
pub const SCAN_BLOCK: u32 = 256;
/// Block sums per super sum.
pub const SCAN_SUPER: u32 = 256;
/// Words from the counter of a tile to that of the next: atomics on the same line of memory (128 bytes on NVIDIA) wait for each
/// other.
pub const TILE_PITCH: u32 = 32;

/// First bit of the quadrants in an instance of a tile list ([`Ellipse::quadrants_of_tile`](super::ellipse::Ellipse)); below
/// it is the Gaussian.
pub const INSTANCE_QUADRANT_SHIFT: u32 = 28;
/// Bits of the Gaussian in an instance: 2^28 − 1. More than that many splats of 48 bytes fit into no binding, whose range is a
/// 32-bit number of bytes.
pub const INSTANCE_GAUSSIAN: u32 = (1 << INSTANCE_QUADRANT_SHIFT) - 1;
/// All four quadrants of a tile.
pub const ALL_QUADRANTS: u32 = 15;

/// `counters[0]`: visible Gaussians.
pub const COUNT_VISIBLE: u32 = 0;
/// `counters[1]`: low word of the 64-bit number of tile instances.
pub const COUNT_INSTANCES_LOW: u32 = 1;
/// `counters[2]`: high word of it.
pub const COUNT_INSTANCES_HIGH: u32 = 2;
/// `counters[3]`: failure bits.
pub const COUNT_FAILED: u32 = 3;
/// `counters[4]`: Gaussians rejected because they are not finite.
pub const COUNT_REJECTED: u32 = 4;
/// `counters[5]`: instances to process; 0 when the frame failed; of frames with `scan_tiles`.
pub const COUNT_INSTANCES: u32 = 5;
/// `counters[6]`: pairs of the longest list, where it takes more than three quarters of its room (`Frame::tile_room`).
pub const COUNT_LONGEST: u32 = 6;

/// Failure bit: more instances than the buffers hold, or than there is room for in a list.
pub const FAILED_INSTANCES: u32 = 1;

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]
    use super::*;

    #[test]
    fn glsl_has_the_same_constants() {
        let glsl =
            concat!(include_str!("../../../glsl/lib/limits.glsl"), include_str!("../../../glsl/lib/ellipse.glsl"));
        let value = |name: &str| -> u32 {
            let line = glsl
                .lines()
                .find(|l| l.starts_with(&format!("const uint {name} =")))
                .unwrap_or_else(|| panic!("neither limits.glsl nor ellipse.glsl has {name}"));
            line.split('=').nth(1).unwrap().split('u').next().unwrap().trim().parse().unwrap()
        };
        for (name, rust) in [
            ("TILE_SIZE", TILE_SIZE),
            ("SORT_THREADS", SORT_THREADS),
            ("SORT_ROUNDS", SORT_ROUNDS),
            ("SORT_PARTITION", SORT_PARTITION),
            ("SORT_DIGITS", SORT_DIGITS),
            ("SCAN_BLOCK", SCAN_BLOCK),
            ("SCAN_SUPER", SCAN_SUPER),
            ("TILE_PITCH", TILE_PITCH),
            ("INSTANCE_QUADRANT_SHIFT", INSTANCE_QUADRANT_SHIFT),
            ("INSTANCE_GAUSSIAN", INSTANCE_GAUSSIAN),
            ("COUNT_VISIBLE", COUNT_VISIBLE),
            ("COUNT_INSTANCES_LOW", COUNT_INSTANCES_LOW),
            ("COUNT_INSTANCES_HIGH", COUNT_INSTANCES_HIGH),
            ("COUNT_FAILED", COUNT_FAILED),
            ("COUNT_REJECTED", COUNT_REJECTED),
            ("COUNT_INSTANCES", COUNT_INSTANCES),
            ("COUNT_LONGEST", COUNT_LONGEST),
            ("FAILED_INSTANCES", FAILED_INSTANCES),
        ] {
            assert_eq!(value(name), rust, "{name}");
        }
        assert_eq!(SORT_PARTITION, SORT_THREADS * SORT_ROUNDS);
    }
}
