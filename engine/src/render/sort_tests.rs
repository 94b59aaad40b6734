//! The sort's twins against a stable sort, and the ranking of `sort_scatter` as an executable model for the subgroup
//! sizes that no test device has.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use super::limits::*;
use super::radix_sort::*;
use super::sort_histogram::{SORT_HISTOGRAM, SortHistogramBuffers};
use super::sort_scatter::{SORT_SCATTER, SortScatterBuffers};
use super::sort_spine::{SORT_SPINE, SPINE_GROUPS, SortSpineBuffers};

/// Counts around every boundary of subgroup, workgroup, block and partition.
const COUNTS: [u32; 15] = [0, 1, 7, 8, 31, 32, 33, 255, 256, 257, 4095, 4096, 4097, 65_535, 65_537];
const POISON: u32 = 0x7FC0_DEAD;

pub(super) struct Rng(pub(super) u64);

impl Rng {
    pub(super) fn next(&mut self) -> u32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as u32 ^ (self.0 >> 12) as u32
    }

    /// Uniform in 0..1.
    pub(super) fn unit(&mut self) -> f64 {
        f64::from(self.next()) / 4_294_967_296.0
    }
}

/// Sorts by the twins, pass by pass; everything that a pass need not read is poison.
fn sort_by_twins(
    plan: &SortPlan,
    keys: &[u32],
    values: Option<&[u32]>,
    first_histogram: Option<Vec<u32>>,
) -> (Vec<u32>, Vec<u32>) {
    let n = keys.len() as u32;
    let counters = vec![POISON, n];
    let rows = plan.histogram_rows() as usize * SORT_DIGITS as usize;
    let mut histogram = first_histogram.unwrap_or_else(|| {
        let buffers =
            SortHistogramBuffers { counters: counters.clone(), keys: keys.to_vec(), histogram: vec![POISON; rows] };
        SORT_HISTOGRAM.run_twin(32, (), plan.histogram_push(0, 1), buffers, plan.partitions).histogram
    });
    let (mut keys, mut moved) = (keys.to_vec(), values.unwrap_or_default().to_vec());
    for pass in 0..plan.digits.len() {
        if plan.prescanned {
            let buffers = SortSpineBuffers { counters: counters.clone(), histogram };
            histogram = SORT_SPINE.run_twin(32, (), plan.spine_push(1), buffers, SPINE_GROUPS).histogram;
        }
        let constants = plan.scatter_constants(pass, values.is_some(), false);
        let buffers = SortScatterBuffers {
            counters: counters.clone(),
            histogram,
            keys_out: vec![POISON; keys.len()],
            values_out: values.map(|_| vec![POISON; moved.len()]),
            keys_in: keys,
            values_in: values.map(|_| moved),
            next_histogram: Some(vec![0; rows]),
        };
        let done = SORT_SCATTER.run_twin(32, constants, plan.scatter_push(pass, 1), buffers, plan.partitions + 1);
        (keys, moved) = (done.keys_out, done.values_out.unwrap_or_default());
        histogram = done.next_histogram.unwrap();
    }
    (keys, moved)
}

fn check_sort(keys: &[u32], key_bits: u32, has_values: bool, prescanned: bool) {
    let mut plan = SortPlan::new(keys.len() as u32, key_bits).unwrap();
    plan.prescanned = prescanned;
    let values: Vec<u32> = (0..keys.len() as u32).map(|i| i.wrapping_mul(7) ^ 5).collect();
    let mut expected: Vec<(u32, u32)> = keys.iter().copied().zip(values.iter().copied()).collect();
    expected.sort_by_key(|(key, _)| *key);
    let (sorted, moved) = sort_by_twins(&plan, keys, has_values.then_some(&values), None);
    let context = format!("n={} bits={key_bits} prescanned={prescanned}", keys.len());
    assert!(sorted.iter().zip(&expected).all(|(k, e)| *k == e.0) && sorted.len() == keys.len(), "{context}: keys");
    if has_values {
        assert!(moved.iter().zip(&expected).all(|(v, e)| *v == e.1), "{context}: values or stability");
    }
}

/// Keys that stress a digit: random, all equal, few distinct, sorted, reversed, one outlier.
pub(super) fn distributions(n: u32, key_bits: u32, rng: &mut Rng) -> Vec<Vec<u32>> {
    let mask = if key_bits == 32 { u32::MAX } else { (1 << key_bits) - 1 };
    let mut build = |f: &mut dyn FnMut(u32, &mut Rng) -> u32| (0..n).map(|i| f(i, rng) & mask).collect::<Vec<_>>();
    vec![
        build(&mut |_, r| r.next()),
        build(&mut |_, _| 0xA5A5_A5A5),
        build(&mut |_, r| if r.next() % 16 == 0 { r.next() } else { 7 }),
        build(&mut |i, _| i),
        build(&mut |i, _| n - i),
        build(&mut |i, _| if i == n / 2 { u32::MAX } else { 0 }),
    ]
}

#[test]
fn twins_sort_every_count() {
    let mut rng = Rng(1);
    for n in COUNTS {
        for keys in distributions(n, 32, &mut rng) {
            for prescanned in [false, true] {
                check_sort(&keys, 32, true, prescanned);
            }
        }
        let keys: Vec<u32> = (0..n).map(|_| rng.next()).collect();
        check_sort(&keys, 32, false, false);
    }
}

#[test]
fn twins_sort_every_key_width() {
    let mut rng = Rng(2);
    for key_bits in 1..=32 {
        for keys in distributions(9001, key_bits, &mut rng) {
            check_sort(&keys, key_bits, true, key_bits % 2 == 0);
        }
    }
}

#[test]
fn plan_covers_the_bits_once() {
    for key_bits in 1..=32 {
        let plan = SortPlan::new(1000, key_bits).unwrap();
        let mut next = 0;
        for digit in &plan.digits {
            assert_eq!(digit.shift, next);
            assert!((1..=8).contains(&digit.bits));
            next += digit.bits;
        }
        assert_eq!(next, key_bits);
        assert_eq!(plan.digits.len() as u32, key_bits.div_ceil(8));
    }
    assert!(SortPlan::new(1, 0).is_err());
    assert!(SortPlan::new(1, 33).is_err());
    assert!(SortPlan::new(u32::MAX, 32).is_err());
    assert!(!SortPlan::new(128 * 4096, 32).unwrap().prescanned);
    assert!(SortPlan::new(128 * 4096 + 1, 32).unwrap().prescanned);
}

#[test]
fn small_sorts_have_small_partitions_on_gpus() {
    let of = |capacity| rounds_of(capacity, false);
    assert_eq!([1, 1 << 17, (1 << 17) + 1, 1 << 18, (1 << 18) + 1, u32::MAX].map(of), [4, 4, 8, 8, 16, 16]);
    assert_eq!(rounds_of(1, true), 16);
    for rounds in [4, 8, 16] {
        let plan = SortPlan::with_rounds(5000, 32, rounds).unwrap();
        assert_eq!(5000_u32.div_ceil(1 << plan.partition_shift()), plan.partitions);
    }
}

// ---- the kernel's algorithm, lane by lane, as in glsl/sort_scatter.comp and glsl/lib/subgroup.glsl ----

const THREADS: u32 = SORT_THREADS;

fn words(lanes: u128) -> [u32; 4] {
    std::array::from_fn(|w| (lanes >> (32 * w)) as u32)
}

fn count_lanes(ballot: [u32; 4], size: u32) -> u32 {
    let mut n = ballot[0].count_ones();
    if size > 32 {
        n += ballot[1].count_ones();
    }
    if size > 64 {
        n += ballot[2].count_ones() + ballot[3].count_ones();
    }
    n
}

fn lanes_below_mask(word: u32, lane: u32) -> u32 {
    let first = word * 32;
    if lane >= first + 32 {
        u32::MAX
    } else if lane <= first {
        0
    } else {
        (1 << (lane - first)) - 1
    }
}

fn count_lanes_below(ballot: [u32; 4], lane: u32, size: u32) -> u32 {
    let masked = std::array::from_fn(|w| ballot[w] & lanes_below_mask(w as u32, lane));
    count_lanes(masked, size)
}

fn workgroup_exclusive_add(values: &[u32], size: u32) -> (Vec<u32>, u32) {
    let subgroups = THREADS / size;
    assert!(subgroups <= 64, "scan_totals has 64 entries");
    let inclusive: Vec<Vec<u32>> = values
        .chunks(size as usize)
        .map(|lanes| lanes.iter().scan(0, |sum, v| (*sum += v, Some(*sum)).1).collect())
        .collect();
    let mut totals: Vec<u32> = inclusive.iter().map(|lanes: &Vec<u32>| *lanes.last().unwrap()).collect();
    let mut carry = 0;
    for first in (0..subgroups).step_by(size as usize) {
        let end = subgroups.min(first + size);
        let counts = totals[first as usize..end as usize].to_vec();
        let mut scanned = carry;
        for i in first..end {
            scanned += counts[(i - first) as usize];
            totals[i as usize] = scanned;
        }
        carry += counts.iter().sum::<u32>();
    }
    let out = (0..THREADS as usize)
        .map(|t| {
            let (subgroup, lane) = (t / size as usize, t % size as usize);
            let before = if subgroup == 0 { 0 } else { totals[subgroup - 1] };
            before + inclusive[subgroup][lane] - values[t]
        })
        .collect();
    (out, *totals.last().unwrap())
}

/// Output positions of up to 4,096 keys in one partition, with the subgroups of a turn run in a shuffled order.
fn rank_model(keys: &[u32], digit: Digit, size: u32, rng: &mut Rng) -> Vec<u32> {
    let (subgroups, mask) = (THREADS / size, (1 << digit.bits) - 1);
    let share = (subgroups / 16).max(1);
    let rows = subgroups / share;
    assert!(rows <= 16, "16 KiB of counters");
    let place = |subgroup: u32, round: u32, lane: u32| (subgroup * SORT_ROUNDS * size + round * size + lane) as usize;
    let mut counters = vec![0_u32; (rows * SORT_DIGITS) as usize];
    let mut rank = vec![0_u32; SORT_PARTITION as usize];
    for turn in 0..share {
        let mut order: Vec<u32> = (0..subgroups).filter(|s| s % share == turn).collect();
        for i in (1..order.len()).rev() {
            order.swap(i, rng.next() as usize % (i + 1));
        }
        for subgroup in order {
            let row = subgroup / share * SORT_DIGITS;
            for round in 0..SORT_ROUNDS {
                let digit_of =
                    |lane: u32| keys.get(place(subgroup, round, lane)).map_or(0, |key| key >> digit.shift & mask);
                let valid = |lane: u32| place(subgroup, round, lane) < keys.len();
                let ballot = |f: &dyn Fn(u32) -> bool| (0..size).fold(0_u128, |b, l| b | u128::from(f(l)) << l);
                let votes: Vec<u128> = (0..digit.bits).map(|b| ballot(&|l| digit_of(l) >> b & 1 != 0)).collect();
                let all_valid = ballot(&valid);
                let peers = |lane: u32| {
                    votes.iter().enumerate().fold(all_valid, |peers, (b, vote)| {
                        peers & if digit_of(lane) >> b & 1 != 0 { *vote } else { !vote }
                    })
                };
                let seen: Vec<u32> = (0..size).map(|l| counters[(row + digit_of(l)) as usize]).collect();
                for lane in 0..size {
                    let peers = words(peers(lane));
                    let below = count_lanes_below(peers, lane, size);
                    rank[place(subgroup, round, lane)] = seen[lane as usize] + below;
                    if valid(lane) && below == 0 {
                        counters[(row + digit_of(lane)) as usize] = seen[lane as usize] + count_lanes(peers, size);
                    }
                }
            }
        }
    }
    let all: Vec<u32> =
        (0..SORT_DIGITS).map(|d| keys.iter().filter(|k| **k >> digit.shift & mask == d).count() as u32).collect();
    let (mut base, total) = workgroup_exclusive_add(&all, size);
    assert_eq!(total, keys.len() as u32);
    for row in 0..rows {
        for d in 0..SORT_DIGITS {
            let at = (row * SORT_DIGITS + d) as usize;
            base[d as usize] += std::mem::replace(&mut counters[at], base[d as usize]);
        }
    }
    (0..keys.len() as u32)
        .map(|i| {
            let row = i / (SORT_ROUNDS * size) / share * SORT_DIGITS;
            counters[(row + (keys[i as usize] >> digit.shift & mask)) as usize] + rank[i as usize]
        })
        .collect()
}

#[test]
fn ranking_is_stable_for_every_subgroup_size() {
    let mut rng = Rng(3);
    for size in [4, 8, 16, 32, 64, 128] {
        for n in [0, 1, 63, 129, 2049, 4096] {
            for keys in distributions(n, 32, &mut rng) {
                for digit in [Digit { shift: 0, bits: 8 }, Digit { shift: 27, bits: 5 }] {
                    let to = rank_model(&keys, digit, size, &mut rng);
                    let mut order: Vec<u32> = (0..n).collect();
                    order.sort_by_key(|i| keys[*i as usize] >> digit.shift & ((1 << digit.bits) - 1));
                    for (position, i) in order.into_iter().enumerate() {
                        assert_eq!(to[i as usize], position as u32, "subgroup {size}, n {n}, {digit:?}, key {i}");
                    }
                }
            }
        }
    }
}

#[test]
fn scan_is_right_for_every_subgroup_size() {
    let mut rng = Rng(4);
    for size in [4, 8, 16, 32, 64, 128] {
        let values: Vec<u32> = (0..THREADS).map(|_| rng.next() % 1000).collect();
        let (scan, total) = workgroup_exclusive_add(&values, size);
        let mut sum = 0;
        for (value, scanned) in values.iter().zip(scan) {
            assert_eq!(scanned, sum, "subgroup {size}");
            sum += value;
        }
        assert_eq!(total, sum);
    }
}

#[test]
fn compaction_order_is_index_order_for_every_subgroup_size() {
    let mut rng = Rng(5);
    for size in [4, 8, 16, 32, 64, 128_u32] {
        let visible: Vec<bool> = (0..1024).map(|_| rng.next().is_multiple_of(3)).collect();
        let (rounds, subgroups) = (4, THREADS / size);
        let index = |s: u32, r: u32, lane: u32| s * rounds * size + r * size + lane;
        let ballot = |s: u32, r: u32| {
            words((0..size).fold(0_u128, |b, l| b | u128::from(visible[index(s, r, l) as usize]) << l))
        };
        let mine = |s: u32| (0..rounds).map(|r| count_lanes(ballot(s, r), size)).sum::<u32>();
        let counts: Vec<u32> = (0..THREADS).map(|t| if t % size == 0 { mine(t / size) } else { 0 }).collect();
        let (scanned, _) = workgroup_exclusive_add(&counts, size);
        let mut expected = 0;
        for s in 0..subgroups {
            for r in 0..rounds {
                for lane in 0..size {
                    let before = scanned[(s * size + lane) as usize] - if lane == 0 { 0 } else { mine(s) };
                    let earlier: u32 = (0..r).map(|q| count_lanes(ballot(s, q), size)).sum();
                    let to = before + earlier + count_lanes_below(ballot(s, r), lane, size);
                    if visible[index(s, r, lane) as usize] {
                        assert_eq!(to, expected, "subgroup {size}");
                        expected += 1;
                    }
                }
            }
        }
    }
}
