//! From projected Gaussians to the tile lists, kernel by kernel beside the twins, on the device or on the executable model.

use engine::gpu::interface::Interface;
use engine::render::deform_project::DeformProjectBuffers;
use engine::render::emit_tiles::{EMIT_TILES, EmitTiles, EmitTilesBuffers, EmitTilesConstants, EmitTilesPush};
use engine::render::frame::Frame;
use engine::render::limits::TILE_PITCH;
use engine::render::scan_tiles::{SCAN_TILES, ScanTilesBuffers, ScanTilesConstants};
use engine::render::sort_tiles::{self, SORT_TILES, SortTilesBuffers};

use crate::model::Options;
use crate::{KernelCase, TestGpu};

/// What runs a kernel and compares it with its twin.
pub trait Runner {
    /// What the kernel leaves.
    ///
    /// # Panics
    /// When it differs from what the twin leaves.
    fn check<I: Interface>(&self, case: KernelCase<I>) -> I::Buffers<Vec<u32>>;
    /// Whether it is a CPU, and the threads of a workgroup of `sort_tiles`.
    fn kind(&self) -> (bool, u32);
}

impl Runner for TestGpu {
    fn check<I: Interface>(&self, case: KernelCase<I>) -> I::Buffers<Vec<u32>> {
        case.check(self, "chain")
    }

    fn kind(&self) -> (bool, u32) {
        let device = || (self.info().is_cpu(), sort_tiles::threads(self.info(), self.subgroup_size_of(&SORT_TILES)));
        crate::model::options().map_or_else(device, |options| options.kind())
    }
}

impl Runner for Options {
    fn check<I: Interface>(&self, case: KernelCase<I>) -> I::Buffers<Vec<u32>> {
        let result = case.run_model(self);
        result.assert_equal(&format!("{self:?}"));
        result.gpu
    }

    fn kind(&self) -> (bool, u32) {
        match self.lanes {
            lanes @ ..16 => (true, lanes),
            32 => (false, 128),
            _ => (false, 256),
        }
    }
}

/// Pairs of a long list, in tests: some are.
const LONG_LIST: u32 = 300;

/// What `deform_project` leaves.
#[derive(Debug, Clone)]
pub struct TileChain {
    /// With the capacity.
    pub frame: Frame,
    /// `[8]`
    pub counters: Vec<u32>,
    /// `[N]`
    pub tile_count: Vec<u32>,
    /// `[N]` splats.
    pub splats: Vec<u32>,
    /// Changes from tile to tile.
    pub tile_change: Vec<u32>,
    /// Sums over blocks of Gaussians.
    pub instance_block: Vec<u32>,
    /// Where its super sums start.
    pub block_capacity: u32,
    /// Of `emit_tiles`.
    pub constants: EmitTilesConstants,
}

/// What the chain leaves.
#[derive(Debug)]
pub struct TileLists {
    /// `[8]`
    pub counters: Vec<u32>,
    /// `[T][2]`
    pub ranges: Vec<u32>,
    /// `[instances]`
    pub values: Vec<u32>,
}

impl TileLists {
    /// The list of each tile.
    pub fn lists(&self) -> impl Iterator<Item = &[u32]> {
        self.ranges.chunks_exact(2).map(|range| &self.values[range[0] as usize..range[1] as usize])
    }
}

impl TileChain {
    /// The words of the frame.
    pub fn frame_words(&self) -> Vec<u32> {
        bytemuck::cast_slice(&[self.frame]).to_vec()
    }

    /// `emit_tiles` after `scan_tiles`.
    pub fn emission(&self, runner: &impl Runner) -> KernelCase<EmitTiles> {
        let tile_start = vec![0; self.frame.tile_count as usize + 1];
        let (counters, tile_change) = (self.counters.clone(), self.tile_change.clone());
        let indirect = Some(vec![0; 3]);
        let buffers = ScanTilesBuffers { frame: self.frame_words(), counters, tile_change, tile_start, indirect };
        let constants = ScanTilesConstants { long: LONG_LIST };
        let scanned = runner.check(KernelCase { kernel: &SCAN_TILES, constants, push: (), buffers, groups: 1 });
        let buffers = EmitTilesBuffers {
            frame: self.frame_words(),
            counters: scanned.counters,
            tile_count: self.tile_count.clone(),
            splats: self.splats.clone(),
            instance_block: self.instance_block.clone(),
            tile_start: scanned.tile_start,
            pairs: vec![0; 2 * self.frame.instance_capacity.max(1) as usize],
            tile_end: scanned.tile_change,
            gaussian_of_slot: None,
            first_slot: None,
        };
        let push = EmitTilesPush { block_capacity: self.block_capacity };
        // One more than there are: a grid may be folded.
        let groups = self.frame.gaussians.div_ceil(256).max(1) + 1;
        KernelCase { kernel: &EMIT_TILES, constants: self.constants, push, buffers, groups }
    }

    /// The whole chain.
    pub fn run(&self, runner: &impl Runner) -> TileLists {
        let emitted = runner.check(self.emission(runner));
        let counters = emitted.counters.clone();
        let SortTilesBuffers { ranges, values, .. } = sort(runner, unsorted(emitted), false);
        TileLists { counters, ranges, values }
    }
}

/// What `sort_tiles` takes from `emit_tiles`.
pub fn unsorted(emitted: EmitTilesBuffers<Vec<u32>>) -> SortTilesBuffers<Vec<u32>> {
    let EmitTilesBuffers { frame, counters, tile_start, pairs, tile_end, .. } = emitted;
    let tiles = tile_end.len() / TILE_PITCH as usize - 1;
    let (ranges, values) = (vec![0; 2 * tiles], vec![0; pairs.len() / 2]);
    SortTilesBuffers { frame, tile_start: Some(tile_start), pairs, values, tile_end, ranges, counters }
}

/// What `sort_tiles` takes from a `deform_project` that fills lists.
///
/// # Panics
/// When it does not.
pub fn filled(done: DeformProjectBuffers<Vec<u32>>) -> SortTilesBuffers<Vec<u32>> {
    let DeformProjectBuffers { frame, counters, tile_end, pairs, .. } = done;
    let (tiles, pairs) = (tile_end.len() / TILE_PITCH as usize - 1, pairs.unwrap());
    let (ranges, values) = (vec![0; 2 * tiles], vec![0; pairs.len() / 2]);
    SortTilesBuffers { frame, tile_start: None, pairs, values, tile_end, ranges, counters }
}

/// The same lists, each in room of its own for so many pairs, as `deform_project` leaves them.
///
/// # Panics
/// When there is too little room.
pub fn with_room(lists: &SortTilesBuffers<Vec<u32>>, room: u32) -> SortTilesBuffers<Vec<u32>> {
    let starts = lists.tile_start.as_deref().unwrap();
    let tiles = starts.len() - 1;
    let mut pairs = vec![0; 2 * tiles * room as usize];
    let mut counts = Vec::new();
    for (tile, range) in starts.windows(2).enumerate() {
        let list = &lists.pairs[2 * range[0] as usize..2 * range[1] as usize];
        pairs[2 * tile * room as usize..][..list.len()].copy_from_slice(list);
        counts.push(range[1] - range[0]);
    }
    counts.push(0);
    let mut frame: Frame = bytemuck::cast_slice(&lists.frame)[0];
    frame.tile_room = room;
    let values = vec![0; pairs.len() / 2];
    let frame = bytemuck::cast_slice(&[frame]).to_vec();
    SortTilesBuffers { frame, tile_start: None, pairs, values, tile_end: spread(&counts), ..lists.clone() }
}

/// Counters of tiles from words side by side.
pub fn spread(words: &[u32]) -> Vec<u32> {
    let mut spread = vec![0; words.len() * TILE_PITCH as usize];
    spread.iter_mut().step_by(TILE_PITCH as usize).zip(words).for_each(|(to, word)| *to = *word);
    spread
}

/// The lists of pairs in their order, and where they are.
pub fn sort(
    runner: &impl Runner,
    mut buffers: SortTilesBuffers<Vec<u32>>,
    with_slots: bool,
) -> SortTilesBuffers<Vec<u32>> {
    // One more than there are: a grid may be folded.
    let groups = buffers.ranges.len() as u32 / 2 + 1;
    let (is_cpu, threads) = runner.kind();
    for constants in sort_tiles::dispatches(is_cpu, threads, u32::MAX, with_slots) {
        buffers = runner.check(KernelCase { kernel: &SORT_TILES, constants, push: (), buffers, groups });
    }
    buffers
}
