//! The hazard tracker against brute force: random access sequences, every pair of accesses checked.

use engine::gpu::access::{Barrier, HazardTracker, Stages, Use};
use proptest::prelude::*;

const STAGES: [Stages; 4] = [Stages::COMPUTE, Stages::TRANSFER, Stages::INDIRECT, Stages::HOST];

/// One operation's accesses as (buffer, start, length, stage, write).
type Access = (u64, u64, u64, usize, bool);

fn uses(accesses: &[Access]) -> Vec<Use> {
    accesses
        .iter()
        .map(|&(buffer, start, length, stage, write)| Use {
            buffer,
            name: format!("b{buffer}"),
            start,
            end: start + length,
            stage: STAGES[stage],
            // Indirect arguments and the host only read.
            write: write && stage < 2,
        })
        .collect()
}

fn conflict(a: &Use, b: &Use) -> bool {
    a.buffer == b.buffer && a.start < b.end && b.start < a.end && (a.write || b.write)
}

/// Whether some chain of barriers in `barriers[first + 1..=second]` orders access `a` of operation `first` before access
/// `b` of operation `second`: brute force over barriers, following execution chains and one flush.
fn ordered(barriers: &[Option<Barrier>], first: usize, second: usize, a: &Use, b: &Use) -> bool {
    // Stages that run after `a` and see it (write) or merely run after it (read).
    let mut after = Stages::NONE;
    let mut visible = Stages::NONE;
    for barrier in barriers[first + 1..=second].iter().flatten() {
        if barrier.source.contains(a.stage) {
            after = after.union(barrier.destination);
            if barrier.flush {
                visible = visible.union(barrier.destination);
            }
        }
    }
    if a.write { visible.contains(b.stage) } else { after.contains(b.stage) }
}

/// Overwritten accesses are ordered through the access that overwrote them.
fn ordered_through(
    all: &[Vec<Use>],
    barriers: &[Option<Barrier>],
    first: usize,
    second: usize,
    a: &Use,
    b: &Use,
) -> bool {
    if ordered(barriers, first, second, a, b) {
        return true;
    }
    (first + 1..second).any(|middle| {
        all[middle].iter().any(|m| {
            m.write
                && m.buffer == a.buffer
                && m.start <= a.start
                && a.end <= m.end
                && ordered_through(all, barriers, first, middle, a, m)
                && ordered_through(all, barriers, middle, second, m, b)
        })
    })
}

fn run(all: &[Vec<Use>]) -> Vec<Option<Barrier>> {
    let mut tracker = HazardTracker::default();
    all.iter().enumerate().map(|(i, u)| tracker.step(&format!("#{i}"), u)).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 10_000, ..ProptestConfig::default() })]

    #[test]
    fn no_barrier_is_missing_and_none_is_idle(
        operations in prop::collection::vec(
            prop::collection::vec((0_u64..8, 0_u64..6, 1_u64..6, 0_usize..4, any::<bool>()), 1..5), 1..40)
    ) {
        let all: Vec<Vec<Use>> = operations.iter().map(|o| uses(o)).collect();
        let barriers = run(&all);
        for second in 0..all.len() {
            for first in 0..second {
                for a in &all[first] {
                    for b in &all[second] {
                        if conflict(a, b) {
                            prop_assert!(ordered_through(&all, &barriers, first, second, a, b),
                                "operation {second} {b:?} is not ordered after {first} {a:?}: {barriers:?}");
                        }
                    }
                }
            }
            // Minimal: a barrier that is there answers a conflict that earlier barriers left open.
            if barriers[second].is_some() {
                let mut without = barriers.clone();
                without[second] = None;
                let needed = (0..second).any(|first| all[first].iter().any(|a| all[second].iter().any(|b|
                    conflict(a, b) && !ordered(&without, first, second, a, b))));
                prop_assert!(needed, "the barrier before {second} is idle: {:?}", barriers[second]);
            }
        }
    }
}

#[test]
fn the_brute_force_check_can_fail() {
    let all: Vec<Vec<Use>> = [[(0, 0, 4, 0, true)], [(0, 2, 4, 0, true)]].iter().map(|o| uses(o)).collect();
    let barriers = run(&all);
    assert!(barriers[1].as_ref().is_some_and(|b| b.flush), "write after write needs a flush, which the layer misses");
    assert!(!ordered_through(&all, &[None, None], 0, 1, &all[0][0], &all[1][0]));
}

#[test]
fn indirect_arguments_need_their_own_stage() {
    let all: Vec<Vec<Use>> = [vec![(0, 0, 16, 0, true)], vec![(0, 0, 16, 0, false)], vec![(0, 0, 12, 2, false)]]
        .iter()
        .map(|o| uses(o))
        .collect();
    let barriers = run(&all);
    assert_eq!(barriers[1].as_ref().map(|b| b.destination), Some(Stages::COMPUTE));
    assert_eq!(barriers[2].as_ref().map(|b| b.destination), Some(Stages::INDIRECT));
}

#[test]
fn write_after_read_is_execution_only() {
    let all: Vec<Vec<Use>> = [[(0, 0, 4, 0, false)], [(0, 0, 4, 1, true)]].iter().map(|o| uses(o)).collect();
    let barrier = run(&all)[1].clone();
    assert!(barrier.is_some_and(|b| !b.flush && b.source == Stages::COMPUTE && b.destination == Stages::TRANSFER));
}
