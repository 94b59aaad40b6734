//! The hazard tracker against brute force: random access sequences, every pair of accesses checked.

use engine::gpu::access::{Barrier, HazardTracker, Stages, Use};
use engine::gpu::schedule::{self, Cost};
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

    #[test]
    fn what_runs_beside_each_other_does_not_conflict(
        operations in prop::collection::vec(
            (0_u32..60, prop::collection::vec((0_u64..10, 0_u64..6, 1_u64..4, 0_usize..4, any::<bool>()), 1..4)), 1..40)
    ) {
        let all: Vec<Vec<Use>> = operations.iter().map(|(_, o)| uses(o)).collect();
        let costs = costs(operations.iter().map(|(cost, _)| *cost));
        let order = order(&all, &costs);
        prop_assert_eq!(fault_of(&all, &order), None);
        // Nothing is lost, and no more barriers than the longest chain has links.
        let mut seen: Vec<usize> = order.iter().map(|(i, _)| *i).collect();
        seen.sort_unstable();
        prop_assert!(seen.into_iter().eq(0..all.len()));
        let barriers = order.iter().filter(|(_, barrier)| barrier.is_some()).count();
        prop_assert_eq!(barriers + 1, longest_chain(&all));
        let in_order = run(&all).iter().flatten().count();
        prop_assert!(barriers <= in_order, "{} barriers, {} in the order of the recording", barriers, in_order);
    }
}

fn costs(times: impl IntoIterator<Item = u32>) -> Vec<Cost> {
    times.into_iter().map(|time| Cost { time, share: 50 }).collect()
}

fn order(all: &[Vec<Use>], costs: &[Cost]) -> Vec<(usize, Option<Barrier>)> {
    let labelled: Vec<(&str, &[Use])> = all.iter().map(|uses| ("operation", uses.as_slice())).collect();
    schedule::order(&labelled, costs)
}

/// Operations of the longest chain in which each conflicts with the one before it.
fn longest_chain(all: &[Vec<Use>]) -> usize {
    let mut length: Vec<usize> = Vec::new();
    for second in all {
        let waits = |first: &&[Use]| first.iter().any(|a| second.iter().any(|b| conflict(a, b)));
        let before = all.iter().zip(&length).filter(|(first, _)| waits(&first.as_slice()));
        let longest = before.map(|(_, length)| *length).max().unwrap_or(0);
        length.push(longest + 1);
    }
    length.into_iter().max().unwrap_or(0)
}

/// The first pair of operations that conflict and are not ordered as they were recorded.
fn fault_of(all: &[Vec<Use>], order: &[(usize, Option<Barrier>)]) -> Option<[usize; 2]> {
    let arranged: Vec<Vec<Use>> = order.iter().map(|(i, _)| all[*i].clone()).collect();
    let barriers: Vec<Option<Barrier>> = order.iter().map(|(_, barrier)| barrier.clone()).collect();
    for second in 0..order.len() {
        for first in 0..second {
            for a in &arranged[first] {
                for b in arranged[second].iter().filter(|b| conflict(a, b)) {
                    let kept = order[first].0 < order[second].0;
                    if !kept || !ordered_through(&arranged, &barriers, first, second, a, b) {
                        return Some([order[first].0, order[second].0]);
                    }
                }
            }
        }
    }
    None
}

#[test]
fn a_wrong_order_and_a_missing_barrier_are_noticed() {
    // Two chains, of three operations and of two.
    let chains =
        [[(0, 0, 4, 0, true)], [(0, 0, 4, 0, false)], [(0, 0, 4, 0, true)], [(1, 0, 4, 0, true)], [(1, 0, 4, 0, true)]];
    let all: Vec<Vec<Use>> = chains.iter().map(|o| uses(o)).collect();
    let good = order(&all, &costs([10, 10, 10, 1, 1]));
    let places: Vec<(usize, bool)> = good.iter().map(|(i, barrier)| (*i, barrier.is_some())).collect();
    assert_eq!(places, [(0, false), (3, false), (1, true), (4, false), (2, true)]);
    assert_eq!(fault_of(&all, &good), None);
    for index in [2, 4] {
        let mut bad = good.clone();
        bad[index].1 = None;
        assert!(fault_of(&all, &bad).is_some(), "no barrier at {index}");
    }
    for index in 0..2 {
        let mut bad = good.clone();
        bad.swap(index, index + 2);
        let barrier = bad[index].1.take();
        bad[2].1 = barrier.or(bad[2].1.take());
        assert!(fault_of(&all, &bad).is_some(), "{index} changed places: {bad:?}");
    }
}

#[test]
fn the_dearest_off_the_longest_chain_runs_beside_its_dearest() {
    let write = |buffer| vec![(buffer, 0, 4, 0, true)];
    // A chain of four on buffer 0; two that wait for nobody.
    let all: Vec<Vec<Use>> = [0, 0, 0, 0, 1, 2].map(write).iter().map(|o| uses(o)).collect();
    let uses: Vec<&[Use]> = all.iter().map(Vec::as_slice).collect();
    assert_eq!(schedule::levels(&uses, &costs([5, 30, 20, 5, 18, 25])), [vec![0], vec![1, 5], vec![2, 4], vec![3]]);
    // Fills and copies do not choose.
    assert_eq!(schedule::levels(&uses, &costs([5, 30, 20, 5, 0, 0])), [vec![0, 4, 5], vec![1], vec![2], vec![3]]);
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
