//! Compaction, radix sort and tile kernels on the device against their twins, bit for bit.

use engine::render::radix_sort::{DeviceSort, SortPlan, rank_by_ballot};
use engine::render::sort_histogram::{SORT_HISTOGRAM, SortHistogramBuffers};
use engine::render::sort_scatter::{SORT_SCATTER, SortScatterBuffers};
use engine::render::sort_spine::{SORT_SPINE, SPINE_GROUPS, SortSpineBuffers};
use tests_harness::{KernelCase, TestGpu, widths};

/// Element counts around every boundary of subgroup, workgroup, block and partition.
const COUNTS: [u32; 15] = [0, 1, 7, 8, 31, 32, 33, 255, 256, 257, 4095, 4096, 4097, 65_535, 65_537];

struct Rng(u64);

impl Rng {
    fn next(&mut self) -> u32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as u32 ^ (self.0 >> 12) as u32
    }
}

/// Sorts on the device pass by pass, each pass compared with its twin, and checks the end against a stable sort.
fn sort_and_check(gpu: &TestGpu, keys: &[u32], key_bits: u32, has_values: bool, prescanned: bool, context: &str) {
    // Both ways of ranking must give the same bits wherever both work.
    let fewest_lanes = rank_by_ballot(gpu.subgroup_size_of(&SORT_SCATTER));
    for (by_ballot, rounds, staged) in [
        (true, 16, false),
        (fewest_lanes, 16, false),
        (fewest_lanes, 4, false),
        (true, 8, true),
        (fewest_lanes, 16, true),
    ] {
        let plan = SortPlan::with_rounds(keys.len().max(1) as u32, key_bits, rounds).unwrap();
        sort_and_check_by(gpu, keys, &SortPlan { prescanned, staged, ..plan }, has_values, by_ballot, context);
    }
}

fn sort_and_check_by(gpu: &TestGpu, keys: &[u32], plan: &SortPlan, has_values: bool, by_ballot: bool, context: &str) {
    let n = keys.len() as u32;
    let context = format!("{context}, n={n} values={has_values} ballot={by_ballot} {plan:?}");
    let rows = plan.histogram_rows() as usize * 256;
    let counters = vec![0, 0, n, 0, 0, 0, 0, 0];
    let buffers = SortHistogramBuffers { counters: counters.clone(), keys: keys.to_vec(), histogram: vec![0; rows] };
    let push = plan.histogram_push(0, 2);
    let case = KernelCase { kernel: &SORT_HISTOGRAM, constants: (), push, buffers, groups: plan.partitions };
    // The count leaves the rows it does not own poisoned, like the totals row; the sort must not read them.
    let mut histogram = case.check(gpu, &context).histogram;
    let mut values: Vec<u32> = (0..n).map(|i| i.wrapping_mul(3) + 1).collect();
    let mut sorted: Vec<(u32, u32)> = keys.iter().copied().zip(values.iter().copied()).collect();
    sorted.sort_by_key(|(k, _)| *k);
    let mut keys = keys.to_vec();
    for pass in 0..plan.digits.len() {
        if plan.prescanned {
            let buffers = SortSpineBuffers { counters: counters.clone(), histogram };
            let push = plan.spine_push(2);
            let case = KernelCase { kernel: &SORT_SPINE, constants: (), push, buffers, groups: SPINE_GROUPS };
            histogram = case.check(gpu, &context).histogram;
        }
        let with_next = pass + 1 < plan.digits.len();
        let buffers = SortScatterBuffers {
            counters: counters.clone(),
            histogram,
            keys_out: vec![0; keys.len()],
            values_out: has_values.then(|| vec![0; keys.len()]),
            keys_in: keys,
            values_in: has_values.then_some(values),
            next_histogram: with_next.then(|| vec![0; rows]),
        };
        let constants = plan.scatter_constants(pass, has_values, by_ballot);
        // One workgroup too many, as a folded grid has.
        let (push, groups) = (plan.scatter_push(pass, 2), plan.partitions + 1);
        let case = KernelCase { kernel: &SORT_SCATTER, constants, push, buffers, groups };
        let out = case.check(gpu, &format!("{context} pass {pass}"));
        histogram = out.next_histogram.unwrap_or_default();
        values = out.values_out.unwrap_or_default();
        keys = out.keys_out;
        keys.truncate(n as usize);
        values.truncate(n as usize);
    }
    assert!(keys.iter().zip(&sorted).all(|(k, (s, _))| k == s), "{context}: keys out of order");
    if has_values {
        assert!(values.iter().zip(&sorted).all(|(v, (_, s))| v == s), "{context}: values not stable");
    }
}

#[test]
fn sort_every_count() {
    let gpu = tests_harness::shared_gpu();
    widths::assert_lanes(&gpu);
    let mut rng = Rng(1);
    let counts: &[u32] = if tests_harness::small() { &[0, 1, 33, 257, 4097] } else { &COUNTS };
    for &n in counts {
        let keys: Vec<u32> = (0..n).map(|_| rng.next()).collect();
        sort_and_check(&gpu, &keys, 32, true, false, "random");
        sort_and_check(&gpu, &keys, 32, true, true, "random");
    }
}

#[test]
fn sort_every_distribution() {
    let gpu = tests_harness::shared_gpu();
    let mut rng = Rng(2);
    let n = if tests_harness::small() { 4500 } else { 9001 };
    let mut build = |f: &dyn Fn(u32, u32) -> u32| (0..n).map(|i| f(i, rng.next())).collect::<Vec<_>>();
    for (name, keys) in [
        ("equal", build(&|_, _| 0xA5A5_A5A5)),
        ("skewed", build(&|_, r| if r % 16 == 0 { r } else { 7 })),
        ("ascending", build(&|i, _| i)),
        ("descending", build(&|i, _| n - i)),
        ("one outlier", build(&|i, _| if i == n / 2 { u32::MAX } else { 0 })),
        ("runs", build(&|i, _| i / 1000 * 77)),
    ] {
        sort_and_check(&gpu, &keys, 32, true, false, name);
        sort_and_check(&gpu, &keys, 32, false, true, name);
    }
}

#[test]
fn sort_every_key_width() {
    let gpu = tests_harness::shared_gpu();
    let mut rng = Rng(3);
    for key_bits in (1..=32).filter(|bits| !tests_harness::small() || [1, 8, 9, 24].contains(bits)) {
        let keys: Vec<u32> = (0..4500).map(|_| rng.next() >> (32 - key_bits)).collect();
        sort_and_check(&gpu, &keys, key_bits, key_bits % 3 != 0, key_bits % 2 == 0, "random");
    }
}

#[test]
fn spine_over_many_partitions() {
    // More partitions than sort_spine has chunks, and a number that the chunks do not divide.
    let gpu = tests_harness::shared_gpu();
    let mut rng = Rng(4);
    let partitions = if tests_harness::small() { 67 } else { 133 };
    let keys: Vec<u32> = (0..partitions * 4096 + 5).map(|_| rng.next() & 0xFFF).collect();
    assert!(tests_harness::small() || SortPlan::new(keys.len() as u32, 12).unwrap().prescanned);
    sort_and_check(&gpu, &keys, 12, true, true, "many partitions");
}

/// Sorts with few partitions and with many; digits counted by the pass before or apart and partitions put in order before they are
/// written, as a GPU has them in large sorts.
#[test]
fn device_sorts_are_stable_whoever_counts_the_digits() {
    let gpu = tests_harness::shared_gpu();
    let mut random = Rng(11);
    for (count, rounds) in [(1_u32, 16), (5_000, 4), (200_000, 4), (200_000, 16)] {
        let keys: Vec<u32> = (0..count).map(|_| random.next() & 0x000f_ffff).collect();
        let mut expected: Vec<(u32, u32)> = keys.iter().copied().zip(0..).collect();
        expected.sort_by_key(|(key, _)| *key);
        for (counted_apart, staged) in [(false, false), (true, false), (false, true), (true, true)] {
            let plan = SortPlan { counted_apart, staged, ..SortPlan::with_rounds(count, 20, rounds).unwrap() };
            let mut sort = DeviceSort::with_plan(&gpu, &keys, &plan).unwrap();
            for _ in 0..2 {
                sort.run().unwrap();
            }
            let [sorted, values] = sort.download().unwrap();
            let found: Vec<(u32, u32)> = sorted.into_iter().zip(values).collect();
            let first = found.iter().zip(&expected).position(|(f, e)| f != e).map(|i| (i, found[i], expected[i]));
            assert!(first.is_none(), "{plan:?}: {first:?}");
        }
    }
    let plan = SortPlan::with_rounds(8, 20, 4).unwrap();
    assert!(DeviceSort::with_plan(&gpu, &[1, 2], &plan).is_err());
}
