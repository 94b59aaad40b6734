//! How matrix products tile their results: the host's side of `glsl/lib/matrix_product.glsl`.

use super::Gpu;

/// How a product tiles its matrices (specialisation constant `STAGE`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Operands in registers, spread by subgroup shuffles: for CPU devices.
    Shuffle = 0,
    /// Operands in shared memory: for GPUs.
    Shared = 1,
}

impl Stage {
    /// The better one for this device.
    pub fn of(gpu: &Gpu) -> Self {
        let info = gpu.info();
        let few_lanes = info.capabilities.subgroup_size <= MOST_SHUFFLING_LANES;
        if info.is_cpu() && few_lanes { Self::Shuffle } else { Self::Shared }
    }

    /// This one or, where these strides and offsets in floats are no multiples of 4, the one that does without loads of four;
    /// and whether there are such loads (specialisation constant `VECTORS`).
    pub fn for_strides(self, strides: &[u32]) -> (Self, bool) {
        let vectors = strides.iter().all(|floats| floats.is_multiple_of(4));
        (if vectors { self } else { Self::Shared }, vectors)
    }

    /// Threads of a workgroup (specialisation constant `THREADS`). Few where each subgroup has a tile of its own, so that even a
    /// small product keeps all cores of a CPU busy and no subgroup goes without.
    pub fn threads(self, subgroup_size: u32) -> u32 {
        match self {
            Self::Shuffle => SHUFFLE_THREADS.max(subgroup_size),
            Self::Shared => PRODUCT_THREADS,
        }
    }
}

/// Lanes up to which kernels that shuffle are written for (`nonrigid_network`).
const MOST_SHUFFLING_LANES: u32 = 16;
/// Most threads per workgroup of the kernels that multiply matrices.
pub const PRODUCT_THREADS: u32 = 256;
/// Of [`Stage::Shuffle`]: two tiles at 8 lanes.
const SHUFFLE_THREADS: u32 = 16;
const SHUFFLE_ROWS: u32 = 16;
const SHUFFLE_COLUMNS: u32 = 8;
const SHARED_TILE: u32 = 32;

/// Workgroups for a product with `rows` × `columns` results, each of `slices` sums.
pub fn product_groups(stage: Stage, subgroup_size: u32, rows: u32, columns: u32, slices: u32) -> u64 {
    let [high, wide, per_group] = match stage {
        Stage::Shuffle => [SHUFFLE_ROWS, SHUFFLE_COLUMNS * subgroup_size, stage.threads(subgroup_size) / subgroup_size],
        Stage::Shared => [SHARED_TILE, SHARED_TILE, 1],
    };
    let tiles = u64::from(rows.div_ceil(high)) * u64::from(columns.div_ceil(wide)) * u64::from(slices);
    tiles.div_ceil(per_group.into())
}
