//! Faults planted in the SPIR-V of real kernels are found: a barrier removed, a bound off by one.

use engine::gpu::proof;
use engine::render::radix_sort::SortPlan;
use engine::render::sort_histogram::{SORT_HISTOGRAM, SortHistogramBuffers};
use engine::render::sort_scatter::{SORT_SCATTER, SortScatterBuffers};
use engine::train::density::density_scan::{DENSITY_SCAN, DensityScanBuffers, DensityScanPush};
use tests_harness::KernelCase;
use tests_harness::model::{self, ModelError, Options, Program, instructions};

const NOP: u32 = 0x0001_0000;
const CONTROL_BARRIER: u32 = 224;
const LESS_UINT: u32 = 176;
const LESS_EQUAL_UINT: u32 = 178;

/// Where instructions with this opcode begin.
fn places(words: &[u32], opcode: u32) -> Vec<usize> {
    instructions(words).filter(|(_, i)| i[0] & 0xffff == opcode).map(|(at, _)| at).collect()
}

/// The first error of a kernel with other words, over several orders; and whether a result without one was wrong.
fn found(case: &proof::KernelCase, words: &[u32], lanes: u32, right: &[Vec<u32>]) -> Result<(), String> {
    let program = Program::new(words, &[&[lanes], &case.spec[..]].concat()).unwrap();
    for seed in 0..6 {
        match model::run_program(&program, case, &Options::new(lanes, seed)) {
            Err(error) => return Err(error.to_string()),
            Ok(buffers) if buffers != right => return Err("another result".to_owned()),
            Ok(_) => {}
        }
    }
    Ok(())
}

/// What is found when each barrier of the kernel is removed in turn.
fn without_each_barrier(case: &proof::KernelCase, lanes: u32) -> Vec<Option<String>> {
    let words = engine::gpu::spirv::words(case.kernel).unwrap();
    let right = model::run(case, &Options::new(lanes, 0));
    assert_eq!(found(case, &words, lanes, &right), Ok(()), "{} as it is", case.kernel.name);
    let removed = |at: usize| {
        let mut words = words.clone();
        words[at..at + 4].fill(NOP);
        found(case, &words, lanes, &right).err()
    };
    places(&words, CONTROL_BARRIER).into_iter().map(removed).collect()
}

fn sort_case() -> proof::KernelCase {
    let n = 5000_u32;
    let keys: Vec<u32> = (0..n).map(|i| i.wrapping_mul(2_654_435_761) >> 3).collect();
    // Staged, so that it comes by all of its barriers.
    let plan = SortPlan { staged: true, ..SortPlan::new(n, 32).unwrap() };
    let counters = vec![0, 0, n, 0, 0, 0, 0, 0];
    let rows = plan.histogram_rows() as usize * 256;
    let buffers = SortHistogramBuffers { counters: counters.clone(), keys: keys.clone(), histogram: vec![0; rows] };
    let push = plan.histogram_push(0, 2);
    let histogram = KernelCase { kernel: &SORT_HISTOGRAM, constants: (), push, buffers, groups: plan.partitions };
    let histogram = histogram.run_model(&Options::new(32, 0)).gpu.histogram;
    let out = vec![0; n as usize];
    let buffers = SortScatterBuffers {
        counters,
        histogram,
        keys_in: keys.clone(),
        values_in: Some(keys),
        keys_out: out.clone(),
        values_out: Some(out),
        next_histogram: Some(vec![0; rows]),
    };
    let (constants, push) = (plan.scatter_constants(0, true, true), plan.scatter_push(0, 2));
    KernelCase { kernel: &SORT_SCATTER, constants, push, buffers, groups: plan.partitions }.into()
}

/// Two rounds of 256 blocks: `workgroup_exclusive_add` is called again while its totals may still be read.
fn scan_case() -> proof::KernelCase {
    let push = DensityScanPush { blocks: 600 };
    let buffers = DensityScanBuffers { row_block: (0..600).map(|i| i % 7).collect() };
    KernelCase { kernel: &DENSITY_SCAN, constants: (), push, buffers, groups: 1 }.into()
}

#[test]
fn a_barrier_that_the_sort_lacks_is_found() {
    for lanes in [32, 64, 128] {
        let found = without_each_barrier(&sort_case(), lanes);
        println!("{lanes} lanes: {found:#?}");
        // The first of workgroup_exclusive_add matters where nothing else stands between two calls; there are two calls, far apart.
        let missed: Vec<usize> = (0..found.len()).filter(|&i| found[i].is_none()).collect();
        assert_eq!((found.len(), &missed[..]), (14, &[1, 6][..]), "{lanes} lanes: barriers that are not missed");
        assert!(found.iter().flatten().any(|e| e.contains("race on `rank_rows`")));
        assert!(found.iter().flatten().any(|e| e.contains("`scan_totals`")));
    }
}

#[test]
fn a_barrier_that_a_scan_lacks_is_found() {
    for lanes in [32, 64, 128] {
        let found = without_each_barrier(&scan_case(), lanes);
        println!("{lanes} lanes: {found:#?}");
        assert!(found.len() >= 3 && found.iter().all(Option::is_some), "{lanes} lanes: {found:?}");
        let named = |e: &String| e.contains("`scan_totals`");
        assert!(found.iter().flatten().all(named), "{found:?}");
    }
}

#[test]
fn a_bound_that_is_off_by_one_is_found() {
    let n = 5000_u32;
    let plan = SortPlan::new(n, 32).unwrap();
    let buffers = SortHistogramBuffers {
        counters: vec![0, 0, n, 0],
        keys: vec![7; n as usize],
        histogram: vec![0; plan.histogram_rows() as usize * 256],
    };
    let push = plan.histogram_push(0, 2);
    let case =
        KernelCase { kernel: &SORT_HISTOGRAM, constants: (), push, buffers, groups: plan.partitions }.into_words();
    let words = engine::gpu::spirv::words(&SORT_HISTOGRAM).unwrap();
    let options = Options::new(64, 0);
    model::run(&case, &options);
    let errors: Vec<ModelError> = places(&words, LESS_UINT)
        .into_iter()
        .filter_map(|at| {
            let mut words = words.clone();
            words[at] = (words[at] & 0xffff_0000) | LESS_EQUAL_UINT;
            let program = Program::new(&words, &[64]).unwrap();
            model::run_program(&program, &case, &options).err()
        })
        .collect();
    println!("{errors:#?}");
    let past = |e: &ModelError| matches!(e, ModelError::OutOfBounds { memory, index: 5000, length: 5000, .. } if memory == "keys");
    assert!(errors.iter().any(past), "{errors:?}");
}
