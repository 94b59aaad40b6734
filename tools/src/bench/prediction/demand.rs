//! What an operation asks of a GPU: workgroups, bytes, instructions, atomics, round trips. Recorded on whatever device ran it,
//! and carried over to the one that is predicted.

use engine::gpu::RecordedTask;
use serde::Serialize;

use super::instructions::{Table, has_loop};
use super::loops::{self, Body, Known, SUBTILES};
use super::subtiles::Subtiles;
use crate::report::measure::Recorded;

/// Round trips to memory of every kernel: one for counts or indices, one for the data that they lead to. Assumption.
const ROUND_TRIPS: f64 = 2.0;
/// Specialisation constant of `sort_scatter` (without the subgroup size): keys per thread.
const SORT_ROUNDS_CONSTANT: usize = 3;
/// The dispatch that sorts long lists on a CPU device; on a GPU one sorts all.
const LONG_LISTS: &str = "sort_tiles long";
/// Threads of the workgroups that blend, and that sum over superpoints.
const BLEND_THREADS: f64 = 128.0;
const SUM_THREADS: u64 = 256;
/// Rows and columns of a tile of a matrix product.
const PRODUCT_TILE: u64 = 32;
/// Bytes of a Gaussian's sums of gradients.
const GRADIENT_ROW_BYTES: u64 = 48;

/// What an operation asks of a GPU.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Demand {
    /// Its label in timings.
    pub(super) label: String,
    /// Whether it waits for what is before it.
    pub(super) barrier: bool,
    /// Bytes read and written that an ideal implementation moves.
    pub(super) bytes: f64,
    /// Of a transfer, whether they go to or come from the host.
    pub(super) over_bus: bool,
    /// Bytes that the host has written for it beforehand, each time.
    pub(super) by_host: f64,
    /// Of a dispatch.
    pub(super) dispatch: Option<DispatchDemand>,
}

/// What a dispatch asks of a GPU.
#[derive(Debug, Clone, Serialize)]
pub(super) struct DispatchDemand {
    /// Workgroups there, and subgroups in all of them.
    pub(super) workgroups: f64,
    pub(super) subgroups: f64,
    /// Invocations of a subgroup.
    pub(super) lanes: f64,
    /// The pipeline of `spgs-dev isa` whose instructions were taken, and how many it has.
    pub(super) compiled: String,
    pub(super) instructions: f64,
    /// Subgroups in flight on a scheduler, by its registers and shared memory.
    pub(super) resident: f64,
    /// Instructions of all subgroups, in units of 32 lanes, with the rounds of loops.
    pub(super) issued: f64,
    /// Instructions of the subgroup that has most, and of the mean one, but for rounds whose cycles were counted.
    pub(super) longest: f64,
    pub(super) mean: f64,
    /// Cycles of those rounds.
    pub(super) longest_cycles: f64,
    pub(super) mean_cycles: f64,
    /// Round trips to memory, one after the other, of the subgroup that has most, and of the mean one.
    pub(super) round_trips: f64,
    pub(super) mean_round_trips: f64,
    /// 32-bit atomics.
    pub(super) atomics: f64,
    /// It has a loop whose rounds nobody counted: the instructions are a lower bound.
    pub(super) uncounted_loop: bool,
}

/// The demand of each operation of a recording.
pub(super) fn of_recording(recorded: &[Recorded], table: Table, subtiles: Subtiles) -> Vec<Demand> {
    let native = recorded.iter().any(is_by_instance);
    let carried = recorded.iter().filter(|r| !(native && sums_instances(r)) && r.operation.label != LONG_LISTS);
    carried.filter_map(|r| demand(r, table, subtiles)).collect()
}

/// Gradients by instance, which a CPU and `--deterministic` have; the GPUs predicted here add them with float atomics.
fn is_by_instance(r: &Recorded) -> bool {
    matches!(&r.operation.task, RecordedTask::Dispatch { kernel, .. } if kernel.name == "blend_backward")
}

/// The kernel that such gradients need besides.
fn sums_instances(r: &Recorded) -> bool {
    matches!(&r.operation.task, RecordedTask::Dispatch { kernel, .. } if kernel.name == "sum_instance_gradients")
}

fn demand(r: &Recorded, table: Table, subtiles: Subtiles) -> Option<Demand> {
    let plain = |bytes: u64, over_bus| Demand {
        label: r.operation.label.clone(),
        barrier: r.operation.barrier,
        bytes: bytes as f64,
        over_bus,
        by_host: 0.0,
        dispatch: None,
    };
    match &r.operation.task {
        // Waiting for the host is counted once, in the constant for submission.
        RecordedTask::HostRead => None,
        RecordedTask::Transfer { .. } if r.operation.label == "fill instance_gradient" => {
            Some(plain(GRADIENT_ROW_BYTES * r.work.get("gaussians"), false))
        }
        RecordedTask::Transfer { written, from_host: true, .. } => {
            Some(Demand { by_host: *written as f64, ..plain(*written, true) })
        }
        RecordedTask::Transfer { read, written, to_host, .. } => {
            Some(plain(if *to_host { *written } else { read + written }, *to_host))
        }
        RecordedTask::Dispatch { kernel, constants, groups, .. } => {
            let name = if is_by_instance(r) { "blend_backward_native" } else { kernel.name };
            let mut demand = plain((kernel.bytes)(&r.work), false);
            demand.label = demand.label.replace("blend_backward", name).replace("native_native", "native");
            let lanes = table.subgroup_size(name);
            let workgroups = workgroups(r, name, *groups, lanes) as f64;
            let threads = if name == "sort_tiles" { table.sort_tiles_threads() } else { kernel.local_size };
            let mut constants = constants.clone();
            if let Some(rounds) = constants.get_mut(SORT_ROUNDS_CONSTANT).filter(|_| name == "sort_scatter") {
                *rounds = loops::sort_rounds(&r.work);
            }
            let uncounted = loops::of_kernel(name).next().is_none() && has_loop(kernel.spirv);
            demand.dispatch = dispatch(r, (name, &constants), table, (workgroups, threads), subtiles)
                .map(|d| DispatchDemand { uncounted_loop: uncounted, ..d });
            Some(demand)
        }
    }
}

/// Instructions, round trips and atomics; `None` for a kernel that no table has.
fn dispatch(
    r: &Recorded,
    (name, constants): (&str, &[u32]),
    table: Table,
    (workgroups, local_size): (f64, u32),
    subtiles: Subtiles,
) -> Option<DispatchDemand> {
    let lanes = f64::from(table.subgroup_size(name));
    let subgroups = workgroups * (f64::from(local_size) / lanes).ceil();
    let compiled = table.compiled(name, constants)?;
    let known = Known { work: &r.work, subgroups, lanes, subtiles };
    let usual = loops::usual_share(name, constants) * compiled.instructions;
    let (mut total, mut longest) = (subgroups * usual, usual);
    let (mut counted, mut longest_cycles, mut mean_cycles) = (0.0, 0.0, 0.0);
    let (mut round_trips, mut mean_round_trips) = (ROUND_TRIPS, ROUND_TRIPS);
    for l in loops::of_kernel(name) {
        let body = match l.body {
            Body::Of(instructions) => instructions,
            Body::Share(share) => share * compiled.instructions,
        };
        let trips = (l.trips)(&known);
        // The first round is in the program's own count.
        let more = [trips.total - subgroups, trips.longest - 1.0].map(|rounds| rounds.max(0.0));
        total += body * more[0];
        match l.alone.filter(|_| table == Table::Nvidia) {
            Some(cycles) => {
                counted += body * more[0];
                longest_cycles += cycles * more[1];
                mean_cycles += cycles * more[0] / subgroups.max(1.0);
            }
            None => longest += body * more[1],
        }
        round_trips += l.loads * trips.longest;
        mean_round_trips += l.loads * (trips.total / subgroups.max(1.0)).min(trips.longest);
    }
    Some(DispatchDemand {
        workgroups,
        subgroups,
        lanes,
        compiled: compiled.name.clone(),
        instructions: compiled.instructions,
        resident: compiled.resident.max(1.0),
        issued: total * lanes / 32.0,
        longest: longest * lanes / 32.0,
        mean: (total - counted) * lanes / 32.0 / subgroups.max(1.0),
        longest_cycles,
        mean_cycles: mean_cycles.min(longest_cycles),
        round_trips,
        mean_round_trips,
        atomics: loops::atomics(name, constants, &known),
        uncounted_loop: false,
    })
}

/// Workgroups on the predicted device: those of indirect dispatches follow from the counts, and some grids from the
/// subgroup size.
fn workgroups(r: &Recorded, name: &str, recorded: Option<u64>, lanes: u32) -> u64 {
    let of = |what: &str| r.work.get(what);
    let tiles = |rows: u64, columns: u64| rows.div_ceil(PRODUCT_TILE) * columns.div_ceil(PRODUCT_TILE);
    match name {
        "sort_scatter" => loops::sort_partitions(&r.work) as u64,
        _ if name.starts_with("blend") => {
            (of("tiles") as f64 * SUBTILES * f64::from(lanes) / BLEND_THREADS).ceil() as u64
        }
        // Tiles of 32×48 pixels of a channel.
        "ssim_forward" | "image_loss" => 3 * of("pixels").div_ceil(32 * 48),
        "linear_forward" => tiles(of("rows"), of("outputs")),
        "linear_backward_input" => tiles(of("rows"), of("inputs")),
        "linear_backward_weight" => {
            tiles(of("outputs"), of("inputs")) * of("rows").div_ceil(of("rows_per_slice").max(1))
        }
        "superpoint_sum" if recorded.is_some_and(|groups| groups < of("superpoints")) => {
            of("superpoints").div_ceil(SUM_THREADS / u64::from(lanes))
        }
        _ => recorded.unwrap_or(1),
    }
}

impl Demand {
    /// Whether it is a dispatch of this kernel.
    pub(super) fn is_of(&self, kernel: &str) -> bool {
        let compiled = self.dispatch.as_ref().map(|d| d.compiled.as_str());
        compiled.and_then(|c| c.split_once('[')).is_some_and(|(name, _)| name == kernel)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use engine::gpu::RecordedOperation;
    use engine::gpu::kernel::Workload;

    use super::*;

    fn work() -> Workload {
        let all = [
            ("instances", 5000),
            ("visible", 1000),
            ("tiles", 100),
            ("gaussians", 2000),
            ("keys", 9000),
            ("pixels", 20000),
        ];
        Workload(all.into())
    }

    fn dispatch(name: &str, groups: Option<u64>) -> Recorded {
        let kernel = engine::kernels().find(|k| k.name == name).unwrap();
        let task =
            RecordedTask::Dispatch { kernel, constants: vec![0; kernel.spec.len() - 1], push: Vec::new(), groups };
        Recorded { operation: RecordedOperation { label: name.into(), barrier: true, task }, work: work() }
    }

    fn transfer(label: &str, from_host: bool) -> Recorded {
        let task = RecordedTask::Transfer { read: 70, written: 70, from_host, to_host: false };
        Recorded { operation: RecordedOperation { label: label.into(), barrier: false, task }, work: work() }
    }

    fn of(recorded: &[Recorded]) -> Vec<Demand> {
        of_recording(recorded, Table::Nvidia, Subtiles { reached: 0.5, ..Subtiles::ALL })
    }

    #[test]
    fn gradients_by_instance_become_those_of_float_atomics() {
        let step = [
            transfer("fill instance_gradient", false),
            dispatch("blend_backward", Some(7)),
            dispatch("sum_instance_gradients", Some(7)),
        ];
        let demands = of(&step);
        let labels: Vec<&str> = demands.iter().map(|d| d.label.as_str()).collect();
        assert_eq!(labels, ["fill instance_gradient", "blend_backward_native"]);
        assert_eq!(demands[0].bytes, 48.0 * 2000.0);
        assert!(demands[1].is_of("blend_backward_native") && demands[1].dispatch.as_ref().unwrap().atomics > 0.0);
        // A recording with float atomics stays as it is.
        let native = [dispatch("blend_backward_native", Some(7)), dispatch("sum_instance_gradients", Some(7))];
        let demands = of(&native);
        assert_eq!((demands.len(), demands[0].label.as_str()), (2, "blend_backward_native"));
    }

    #[test]
    fn grids_are_those_of_the_predicted_device() {
        let groups = |name, recorded| of(&[dispatch(name, recorded)])[0].dispatch.as_ref().unwrap().workgroups;
        // Four subgroups of 32 lanes in a workgroup: a tile each.
        assert_eq!(groups("blend", Some(25)), 100.0);
        // 9,000 keys in partitions of 1,024.
        assert_eq!(groups("sort_scatter", None), 9.0);
        assert_eq!(groups("image_loss", Some(3)), 42.0);
        assert_eq!(groups("emit_tiles", Some(8)), 8.0);
    }

    #[test]
    fn what_the_host_writes_goes_over_the_bus_once() {
        let [from_host, here] = [true, false].map(|from_host| of(&[transfer("copy", from_host)]).remove(0));
        assert_eq!((from_host.bytes, from_host.by_host, from_host.over_bus), (70.0, 70.0, true));
        assert_eq!((here.bytes, here.by_host, here.over_bus), (140.0, 0.0, false));
    }

    #[test]
    fn what_a_splat_takes_alone_is_counted_for_nvidia() {
        let blend = [dispatch("blend", Some(25))];
        let of = |table| of_recording(&blend, table, Subtiles::ALL).remove(0).dispatch.unwrap();
        let [nvidia, amd] = [Table::Nvidia, Table::Amd].map(of);
        assert!(nvidia.longest_cycles > 0.0 && nvidia.mean_cycles <= nvidia.longest_cycles);
        assert_eq!((amd.longest_cycles, amd.mean_cycles), (0.0, 0.0));
        assert!(nvidia.longest < amd.longest, "{nvidia:?} {amd:?}");
    }

    #[test]
    fn loops_that_nobody_counted_are_told() {
        let uncounted = |name| of(&[dispatch(name, Some(1))])[0].dispatch.as_ref().unwrap().uncounted_loop;
        assert!(uncounted("density_scan") && !uncounted("blend") && !uncounted("gather_gradient"));
    }
}
