//! What the compilers' tables do not say: how often loops run, and the atomics. A table counts a loop's body once.
//!
//! Trips follow from the frame's counted work (instances, visible Gaussians, keys …). Instructions per trip are counted in NAK's
//! assembly for Turing where that is said, with both sides of branches that lanes take differently; the others, and the spread
//! between lanes, are assumptions, read off the GLSL. They are printed with every prediction.

use engine::gpu::kernel::Workload;
use engine::render::limits::SORT_THREADS;
use engine::render::radix_sort::rounds_of;

use super::subtiles::Subtiles;

/// How many more pairs the superpoint with most Gaussians has than the mean one: assumption.
const LARGEST_SUPERPOINT: f64 = 3.0;
/// How much more work the busiest lane of a subgroup has than the mean one: assumption.
const BUSIEST_LANE: f64 = 3.0;
/// Subtiles of 8×8 pixels, one per subgroup of 32 lanes with two pixels each, in a tile.
pub(super) const SUBTILES: f64 = 4.0;
/// Of a splat: half of 160 by the delays in NAK's assembly for two, the loop's branches with them, and half of 90 of waits, an
/// assumption: 30 for shared memory, 60 for four times exp2, partly hidden.
const BLEND_CYCLES: f64 = 125.0;
/// Of a batch of splats: counted.
const BLEND_BATCH: f64 = 130.0;
/// Round trips that a batch waits for: it was fetched while the one before was blended, which mostly takes as long; the rest is an assumption.
const BATCH_LOADS: f64 = 0.25;
/// Rows of a histogram that a workgroup of `sort_scatter` adds up in a round.
const ROWS_OF_ROUND: f64 = 32.0;
/// The push constant `totals_row` of a sort without `sort_spine`.
const NOT_PRESCANNED: u64 = u32::MAX as u64;
/// Most tiles of a splat that one thread emits.
const SERIAL_TILES: f64 = 16.0;
/// Pairs that a thread of `sort_tiles` has on their way at a time, and most buckets.
const SORT_TILES_AT_ONCE: f64 = 4.0;
const SORT_TILES_BUCKETS: f64 = 1024.0;
/// Depth of one round of a matrix product.
const PRODUCT_DEPTH: f64 = 64.0;

/// Keys per thread that a sort of this work has on a GPU.
pub(super) fn sort_rounds(work: &Workload) -> u32 {
    rounds_of(u32::try_from(work.get("keys")).unwrap_or(u32::MAX), false)
}

/// Its partitions.
pub(super) fn sort_partitions(work: &Workload) -> f64 {
    work.get("keys").div_ceil((sort_rounds(work) * SORT_THREADS).into()).max(1) as f64
}

/// What is known of a dispatch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Known<'a> {
    /// Amounts of work, with the numbers of its push constants.
    pub(super) work: &'a Workload,
    /// Subgroups of the dispatch.
    pub(super) subgroups: f64,
    /// Lanes of a subgroup.
    pub(super) lanes: f64,
    /// What blending does with the lists of tiles.
    pub(super) subtiles: Subtiles,
}

impl Known<'_> {
    fn of(&self, name: &str) -> f64 {
        self.work.get(name) as f64
    }

    /// Whether `sort_spine` has added up the partitions of a sort beforehand.
    fn is_prescanned(&self) -> bool {
        self.work.0.get("totals_row").is_some_and(|row| *row != NOT_PRESCANNED)
    }

    /// Tiles of a splat.
    fn tiles_per_splat(&self) -> f64 {
        self.of("instances") / self.of("visible").max(1.0)
    }

    /// Splats of a tile.
    fn splats_per_tile(&self) -> f64 {
        self.of("instances") / self.of("tiles").max(1.0)
    }
}

/// Rounds of a loop: of all subgroups together, and of the one that has most.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Trips {
    pub(super) total: f64,
    pub(super) longest: f64,
}

fn each(subgroups: f64, trips: f64) -> Trips {
    Trips { total: subgroups * trips, longest: trips }
}

/// Instructions of one round.
#[derive(Debug, Clone, Copy)]
pub(super) enum Body {
    /// So many.
    Of(f64),
    /// This share of the whole program.
    Share(f64),
}

/// A loop.
pub(super) struct Loop {
    kernels: &'static [&'static str],
    /// A round, in words.
    pub(super) round: &'static str,
    pub(super) body: Body,
    /// Cycles of a round of a subgroup that is alone, by NAK's delays and waits; without, as many as an instruction takes in
    /// code without loops.
    pub(super) alone: Option<f64>,
    /// Round trips to memory that one round waits for.
    pub(super) loads: f64,
    pub(super) trips: fn(&Known<'_>) -> Trips,
}

impl Loop {
    /// The kernels that have it.
    pub(super) fn kernels(&self) -> &'static [&'static str] {
        self.kernels
    }
}

impl Body {
    /// For people.
    pub(super) fn describe(self) -> String {
        match self {
            Self::Of(instructions) => format!("{instructions} instructions"),
            Self::Share(share) => format!("{share} of the program's instructions"),
        }
    }
}

const BLEND: &[&str] = &["blend", "blend_packed", "blend_rgba8", "blend_rgba16f", "blend_rgba32f", "blend_states"];
const BLEND_BACKWARD: &[&str] = &["blend_backward", "blend_backward_native"];

fn batches(k: &Known<'_>) -> Trips {
    let total = SUBTILES * (k.of("instances") / k.lanes + 0.5 * k.of("tiles"));
    Trips { total, longest: (k.subtiles.longest * k.splats_per_tile() / k.lanes).ceil() }
}

fn hits(k: &Known<'_>) -> Trips {
    let total = SUBTILES * k.of("instances") * k.subtiles.reached * k.subtiles.blended;
    Trips { total, longest: k.subtiles.most * k.splats_per_tile() }
}

fn pairs(k: &Known<'_>) -> Trips {
    let pairs = k.of("gaussians") * k.of("neighbors").max(1.0);
    let longest = LARGEST_SUPERPOINT * pairs / k.of("superpoints").max(1.0) / 256.0;
    Trips { total: pairs / k.lanes, longest }
}

/// Threads of the workgroup that sorts a tile's list.
fn sort_threads(k: &Known<'_>) -> f64 {
    (k.subgroups * k.lanes / k.of("tiles").max(1.0)).max(1.0)
}

/// Rounds of `sort_tiles` with so many pairs for each thread: of mean lists, and of the longest one.
fn sort_rounds_of(k: &Known<'_>, pairs: f64) -> Trips {
    let rounds = |splats: f64| (splats / pairs / sort_threads(k)).ceil().max(1.0);
    Trips {
        total: k.subgroups * rounds(k.splats_per_tile()),
        longest: rounds(k.subtiles.longest * k.splats_per_tile()),
    }
}

/// Times that a thread waits for pairs.
fn pair_loads(k: &Known<'_>) -> Trips {
    let rounds = |splats: f64| (splats / SORT_TILES_AT_ONCE / sort_threads(k)).ceil().max(1.0);
    let loads = |rounds: f64| if rounds > 1.0 { 3.0 * rounds } else { 1.0 };
    let longest = loads(rounds(k.subtiles.longest * k.splats_per_tile()));
    Trips { total: k.subgroups * loads(rounds(k.splats_per_tile())), longest }
}

/// The same with the buckets that a thread has: one for each pair, more or less.
fn bucket_rounds(k: &Known<'_>) -> Trips {
    let rounds = |splats: f64| (splats.min(SORT_TILES_BUCKETS) / sort_threads(k)).ceil().max(1.0);
    Trips {
        total: k.subgroups * rounds(k.splats_per_tile()),
        longest: rounds(k.subtiles.longest * k.splats_per_tile()),
    }
}

/// What a loop of `emit_tiles` makes in a `deform_project` that fills lists: as many rounds, or none.
fn with_lists(k: &Known<'_>, rounds: f64) -> Trips {
    each(k.subgroups, if k.of("tile_room") > 0.0 { rounds } else { 0.0 })
}

/// Rows of tiles of the splat that has most of a subgroup's.
fn rows_of_busiest(k: &Known<'_>) -> f64 {
    BUSIEST_LANE * k.tiles_per_splat().sqrt()
}

/// Shares of programs that their usual paths have, one round of each loop with it: counted in NAK's assembly for Turing. In
/// `sort_tiles` the rest is for longer lists and for depths that are all alike, in `emit_tiles` for splats of more than 16 tiles; a
/// `deform_project` that fills lists has its own program and that of `emit_tiles`.
pub(super) const USUAL_PATHS: &[(&str, f64)] = &[
    ("sort_tiles", 700.0 / 3433.0),
    ("emit_tiles", 500.0 / 1808.0),
    (PROJECT_WITH_LISTS, (1380.0 + 500.0 / 1808.0 * 2176.0) / 4004.0),
];
const PROJECT_WITH_LISTS: &str = "deform_project";
/// Its constant LISTS.
const LISTS_CONSTANT: usize = 11;

/// The share of a kernel.
pub(super) fn usual_share(kernel: &str, constants: &[u32]) -> f64 {
    if kernel == PROJECT_WITH_LISTS && constants.get(LISTS_CONSTANT) != Some(&1) {
        return 1.0;
    }
    USUAL_PATHS.iter().find(|(name, _)| *name == kernel).map_or(1.0, |(_, share)| *share)
}

/// The loops that take time in frames and training steps.
pub(super) const LOOPS: &[Loop] = &[
    Loop {
        kernels: BLEND,
        round: "a batch of splats chosen for a subtile (counted), a quarter of a round trip to memory besides,",
        body: Body::Of(BLEND_BATCH),
        alone: None,
        loads: BATCH_LOADS,
        trips: batches,
    },
    Loop {
        kernels: BLEND,
        round: "a splat blended into a subtile's pixels (counted: 95 for two)",
        body: Body::Of(50.0),
        alone: Some(BLEND_CYCLES),
        loads: 0.0,
        trips: hits,
    },
    Loop {
        kernels: BLEND_BACKWARD,
        round: "a batch of splats tested against a subtile",
        body: Body::Of(90.0),
        alone: None,
        loads: 3.0,
        trips: batches,
    },
    Loop {
        kernels: BLEND_BACKWARD,
        round: "a splat replayed on a subtile's pixels and summed over the subgroup",
        body: Body::Of(125.0),
        alone: None,
        loads: 0.0,
        trips: hits,
    },
    Loop {
        kernels: &["deform_project"],
        round: "a row of tiles counted (counted), as many as the busiest lane has",
        body: Body::Of(100.0),
        alone: None,
        loads: 0.0,
        trips: |k| each(k.subgroups, rows_of_busiest(k)),
    },
    Loop {
        kernels: &["emit_tiles"],
        round: "a row of tiles found (counted), as many as the busiest lane has",
        body: Body::Of(160.0),
        alone: None,
        loads: 0.0,
        trips: |k| each(k.subgroups, rows_of_busiest(k)),
    },
    Loop {
        kernels: &["deform_project"],
        round: "the same where it fills lists",
        body: Body::Of(160.0),
        alone: None,
        loads: 0.0,
        trips: |k| with_lists(k, rows_of_busiest(k)),
    },
    Loop {
        kernels: &["sort_tiles"],
        round: "four pairs of a thread ranged, counted and placed in buckets (counted)",
        body: Body::Of(240.0),
        alone: None,
        loads: 0.0,
        trips: |k| sort_rounds_of(k, SORT_TILES_AT_ONCE),
    },
    Loop {
        kernels: &["sort_tiles"],
        round: "four pairs of a thread from memory: once where it keeps them, else three times",
        body: Body::Of(0.0),
        alone: None,
        loads: 1.0,
        trips: pair_loads,
    },
    Loop {
        kernels: &["sort_tiles"],
        round: "a pair's place among those of its bucket (counted: 44, and 20 for each of four there, as many as the busiest lane has)",
        body: Body::Of(124.0),
        alone: None,
        loads: 0.0,
        trips: |k| sort_rounds_of(k, 1.0),
    },
    Loop {
        kernels: &["sort_tiles"],
        round: "a bucket of a thread cleared, summed and given its begin (counted)",
        body: Body::Of(32.0),
        alone: None,
        loads: 0.0,
        trips: bucket_rounds,
    },
    Loop {
        kernels: &["emit_tiles"],
        round: "a tile instance put into the queue, as many as the busiest lane has",
        body: Body::Of(22.0),
        alone: None,
        loads: 0.0,
        trips: |k| each(k.subgroups, (BUSIEST_LANE * k.tiles_per_splat()).min(SERIAL_TILES)),
    },
    Loop {
        kernels: &["deform_project"],
        round: "the same where it fills lists",
        body: Body::Of(22.0),
        alone: None,
        loads: 0.0,
        trips: |k| with_lists(k, (BUSIEST_LANE * k.tiles_per_splat()).min(SERIAL_TILES)),
    },
    Loop {
        kernels: &["emit_tiles"],
        round: "a tile instance taken from the queue and appended, an even share of the workgroup's",
        body: Body::Of(45.0),
        alone: None,
        loads: 1.0,
        trips: |k| each(k.subgroups, k.tiles_per_splat().ceil()),
    },
    Loop {
        kernels: &["deform_project"],
        round: "the same where it fills lists",
        body: Body::Of(45.0),
        alone: None,
        loads: 1.0,
        trips: |k| with_lists(k, k.tiles_per_splat().ceil()),
    },
    Loop {
        kernels: &["sort_scatter"],
        round: "the digit counts of 32 partitions added up, eight loads of a thread at a time",
        body: Body::Of(180.0),
        alone: None,
        loads: 1.0,
        trips: |k| {
            each(k.subgroups, if k.is_prescanned() { 0.0 } else { (sort_partitions(k.work) / ROWS_OF_ROUND).ceil() })
        },
    },
    Loop {
        kernels: &["sort_histogram"],
        round: "a key counted",
        body: Body::Of(12.0),
        alone: None,
        loads: 0.25,
        trips: |k| each(k.subgroups, f64::from(sort_rounds(k.work))),
    },
    Loop {
        kernels: &["nearest_superpoints"],
        round: "a superpoint compared with the bound; two of 32 put into the list",
        body: Body::Of(19.0),
        alone: None,
        loads: 1.0 / 256.0,
        trips: |k| each(k.subgroups, k.of("superpoints")),
    },
    Loop {
        kernels: &["superpoint_sum"],
        round: "a pair of a Gaussian and a superpoint added",
        body: Body::Of(60.0),
        alone: None,
        loads: 2.0,
        trips: pairs,
    },
    Loop {
        kernels: &["sum_instance_gradients"],
        round: "an instance's row added, as many as the busiest lane has",
        body: Body::Of(8.0),
        alone: None,
        loads: 1.0,
        trips: |k| each(k.subgroups, BUSIEST_LANE * k.tiles_per_splat()),
    },
    Loop {
        kernels: &["linear_forward"],
        round: "64 inputs of a layer",
        body: Body::Share(0.5),
        alone: None,
        loads: 1.0,
        trips: |k| each(k.subgroups, (k.of("inputs") / PRODUCT_DEPTH).ceil()),
    },
    Loop {
        kernels: &["linear_backward_input"],
        round: "64 outputs of a layer",
        body: Body::Share(0.5),
        alone: None,
        loads: 1.0,
        trips: |k| each(k.subgroups, (k.of("outputs") / PRODUCT_DEPTH).ceil()),
    },
    Loop {
        kernels: &["linear_backward_weight"],
        round: "64 rows of a batch",
        body: Body::Share(0.5),
        alone: None,
        loads: 1.0,
        trips: |k| each(k.subgroups, (k.of("rows_per_slice") / PRODUCT_DEPTH).ceil()),
    },
    Loop {
        kernels: &["deform_network"],
        round: "a multiply-add of network F",
        body: Body::Of(1.5),
        alone: None,
        loads: 0.0,
        trips: |k| {
            let total = k.of("network_products") * k.of("superpoints") / k.lanes;
            Trips { total, longest: total / k.subgroups.max(1.0) }
        },
    },
];

/// The loops of a kernel.
pub(super) fn of_kernel(kernel: &str) -> impl Iterator<Item = &'static Loop> {
    LOOPS.iter().filter(move |l| l.kernels.contains(&kernel))
}

/// 32-bit atomics of a dispatch: of a sort's counts, one per key; of gradients, ten sums per splat and subtile.
pub(super) fn atomics(kernel: &str, constants: &[u32], k: &Known<'_>) -> f64 {
    match kernel {
        // HAS_NEXT
        "sort_scatter" if constants.get(1) == Some(&0) => 0.0,
        "sort_scatter" | "sort_histogram" => k.of("keys"),
        "emit_tiles" => k.of("instances"),
        "deform_project" if k.of("tile_room") > 0.0 => k.of("instances"),
        // Two per row of tiles.
        "deform_project" => 2.0 * k.of("visible") * k.tiles_per_splat().sqrt(),
        // A pair twice, in shared memory, which is not slower.
        "sort_tiles" => 0.0,
        "blend_backward_native" => 10.0 * hits(k).total,
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    fn work() -> Workload {
        Workload([("instances", 6400), ("tiles", 100), ("visible", 1600), ("keys", 5000), ("superpoints", 7)].into())
    }

    fn known(work: &Workload) -> Known<'_> {
        let subtiles = Subtiles { reached: 0.5, blended: 0.75, longest: 3.0, most: 2.0 };
        Known { work, subgroups: 10.0, lanes: 32.0, subtiles }
    }

    #[test]
    fn loops_are_of_kernels_of_the_engine() {
        for l in LOOPS {
            for kernel in l.kernels {
                assert!(engine::kernels().any(|k| k.name == *kernel), "{kernel}");
            }
            let work = work();
            let known = known(&work);
            let trips = (l.trips)(&known);
            assert!(trips.total >= 0.0 && trips.longest.is_finite(), "{}: {trips:?}", l.round);
        }
    }

    #[test]
    fn trips_follow_the_counted_work() {
        let work = work();
        let known = known(&work);
        assert_eq!(hits(&known), Trips { total: 4.0 * 6400.0 * 0.5 * 0.75, longest: 128.0 });
        assert_eq!(batches(&known), Trips { total: 4.0 * 250.0, longest: 6.0 });
        assert_eq!(atomics("sort_scatter", &[1, 1, 1], &known), 5000.0);
        assert_eq!(atomics("sort_scatter", &[1, 0, 1], &known), 0.0);
        assert_eq!(usual_share("deform_project", &[0; 12]), 1.0);
        assert!(usual_share("deform_project", &[1; 12]) < 0.6);
        assert_eq!(atomics("deform_project", &[], &known), 2.0 * 1600.0 * 2.0);
        assert_eq!(atomics("blend_backward_native", &[], &known), 10.0 * 9600.0);
        let partitions = of_kernel("sort_scatter").next().unwrap();
        // 5,000 keys are five partitions of 1,024: one round.
        assert_eq!((partitions.trips)(&known).longest, 1.0);
    }
}
