//! Compaction, radix sort and tile kernels on the device against their twins, bit for bit.

use engine::gpu::kernel::Kernel;
use engine::gpu::{Buffer, Groups, Memory, Slice};
use engine::render::radix_sort::*;
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

fn run(gpu: &TestGpu, kernel: &'static Kernel, case: KernelCase, context: &str) -> Vec<Vec<u32>> {
    let result = case.run(gpu);
    result.assert_equal(kernel, context);
    result.gpu
}

/// Sorts on the device pass by pass, each pass compared with its twin, and checks the end against a stable sort.
fn sort_and_check(gpu: &TestGpu, keys: &[u32], key_bits: u32, has_values: bool, prescanned: bool, context: &str) {
    let n = keys.len() as u32;
    let context = format!("n={n} bits={key_bits} values={has_values} prescanned={prescanned} {context}");
    let mut plan = SortPlan::new(n.max(1), key_bits).unwrap();
    plan.prescanned = prescanned;
    let rows = plan.histogram_rows() as usize * 256;
    let counters = vec![0, 0, n, 0, 0, 0, 0, 0];
    let push = bytemuck::bytes_of(&plan.histogram_push(2)).to_vec();
    let buffers = vec![counters.clone(), keys.to_vec(), vec![0; rows]];
    let case = KernelCase { kernel: &SORT_HISTOGRAM, spec: vec![], push, buffers, groups: plan.partitions };
    // The count leaves the rows it does not own poisoned, like the totals row; the sort must not read them.
    let mut histogram = run(gpu, &SORT_HISTOGRAM, case, &context).swap_remove(2);
    let mut values: Vec<u32> = (0..n).map(|i| i.wrapping_mul(3) + 1).collect();
    let mut sorted: Vec<(u32, u32)> = keys.iter().copied().zip(values.iter().copied()).collect();
    sorted.sort_by_key(|(k, _)| *k);
    let mut keys = keys.to_vec();
    for pass in 0..plan.digits.len() {
        if prescanned {
            let push = bytemuck::bytes_of(&plan.spine_push(2)).to_vec();
            let buffers = vec![counters.clone(), histogram];
            let case = KernelCase { kernel: &SORT_SPINE, spec: vec![], push, buffers, groups: SPINE_GROUPS };
            histogram = run(gpu, &SORT_SPINE, case, &context).swap_remove(1);
        }
        let push = bytemuck::bytes_of(&plan.scatter_push(pass, 2)).to_vec();
        let spec = plan.scatter_spec(pass, has_values).to_vec();
        let out = vec![0; keys.len()];
        let buffers = vec![counters.clone(), histogram, keys, values, out.clone(), out, vec![0; rows]];
        // One workgroup too many, as a folded grid has.
        let case = KernelCase { kernel: &SORT_SCATTER, spec, push, buffers, groups: plan.partitions + 1 };
        let mut out = run(gpu, &SORT_SCATTER, case, &format!("{context} pass {pass}"));
        histogram = out.swap_remove(6);
        values = if has_values { out.swap_remove(5) } else { vec![0; n as usize] };
        keys = out.swap_remove(4);
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
    let gpu = tests_harness::gpu();
    widths::assert_lanes(&gpu);
    let mut rng = Rng(1);
    for n in COUNTS {
        let keys: Vec<u32> = (0..n).map(|_| rng.next()).collect();
        sort_and_check(&gpu, &keys, 32, true, false, "random");
        sort_and_check(&gpu, &keys, 32, true, true, "random");
    }
}

#[test]
fn sort_every_distribution() {
    let gpu = tests_harness::gpu();
    let mut rng = Rng(2);
    let n = 9001;
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
    let gpu = tests_harness::gpu();
    let mut rng = Rng(3);
    for key_bits in 1..=32 {
        let keys: Vec<u32> = (0..4500).map(|_| rng.next() >> (32 - key_bits)).collect();
        sort_and_check(&gpu, &keys, key_bits, key_bits % 3 != 0, key_bits % 2 == 0, "random");
    }
}

#[test]
fn spine_over_many_partitions() {
    // More partitions than sort_spine has chunks, and a number that the chunks do not divide.
    let gpu = tests_harness::gpu();
    let mut rng = Rng(4);
    let keys: Vec<u32> = (0..133 * 4096 + 5).map(|_| rng.next() & 0xFFF).collect();
    assert!(SortPlan::new(keys.len() as u32, 12).unwrap().prescanned);
    sort_and_check(&gpu, &keys, 12, true, true, "many partitions");
}

#[test]
fn other_subgroup_sizes() {
    widths::repeat_with_other_widths(&["sort_every_count", "sort_every_distribution"]);
}

/// Cost of a whole sort; run with `--ignored --nocapture`.
#[test]
#[ignore = "a measurement"]
fn sort_timings() {
    let gpu = tests_harness::gpu();
    for (what, n, key_bits) in
        [("depth", 50_000, 32), ("tile 400x400", 165_000, 10), ("tile 1080p", 165_000, 13), ("tile 1080p", 500_000, 13)]
    {
        let mut rng = Rng(9);
        let keys: Vec<u32> = (0..n).map(|_| rng.next() >> (32 - key_bits)).collect();
        for prescanned in [false, true] {
            let mut plan = SortPlan::new(n, key_bits).unwrap();
            plan.prescanned = prescanned;
            let (cpu, total, passes) = time_sort(&gpu, &plan, &keys);
            eprintln!(
                "{what}: {n} keys of {key_bits} bits, spine {prescanned}: best {total:.2} ms; mean CPU time {cpu:.2} ms; {passes:?}"
            );
        }
    }
}

/// CPU time of this process so far, in milliseconds: what a CPU device costs, whatever else the machine does.
fn cpu_milliseconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after = stat.rsplit(')').next().unwrap_or_default();
    after.split_whitespace().skip(11).take(2).filter_map(|t| t.parse::<f64>().ok()).sum::<f64>() * 10.0
}

/// Of sort_histogram and all passes: mean CPU milliseconds, and of the fastest run the total and each operation.
fn time_sort(gpu: &TestGpu, plan: &SortPlan, keys: &[u32]) -> (f64, f64, Vec<(String, f64)>) {
    let bytes = 4 * keys.len() as u64;
    let counters = gpu.buffer_with("counters", bytemuck::bytes_of(&[keys.len() as u32, 0, 0, 0])).unwrap();
    let input = gpu.buffer_with("input", bytemuck::cast_slice(keys)).unwrap();
    let make = |name: &str, bytes: u64| gpu.buffer(name, bytes, Memory::Device).unwrap();
    let (keys, values) = ([0, 1].map(|_| make("keys", bytes)), [0, 1].map(|_| make("values", bytes)));
    let histograms: Vec<Buffer> = (0..=plan.digits.len()).map(|_| make("histogram", plan.histogram_bytes())).collect();
    let mut r = gpu.recorder("sort").with_timestamps(true);
    r.copy(input.slice(0, bytes), keys[0].slice(0, bytes)).unwrap();
    for histogram in &histograms {
        r.fill(histogram, 0).unwrap();
    }
    let slices = [&counters, &keys[0], &histograms[0]].map(Slice::from);
    let groups = Groups::Direct(plan.partitions.into());
    r.dispatch(&SORT_HISTOGRAM, &[], bytemuck::bytes_of(&plan.histogram_push(0)), &slices, groups.clone()).unwrap();
    for pass in 0..plan.digits.len() {
        let (from, to) = (pass % 2, (pass + 1) % 2);
        if plan.prescanned {
            let slices = [&counters, &histograms[pass]].map(Slice::from);
            let spine = Groups::Direct(SPINE_GROUPS.into());
            r.dispatch(&SORT_SPINE, &[], bytemuck::bytes_of(&plan.spine_push(0)), &slices, spine).unwrap();
        }
        let buffers = [&counters, &histograms[pass], &keys[from], &values[from], &keys[to], &values[to]];
        let mut slices: Vec<Slice> = buffers.into_iter().map(Slice::from).collect();
        slices.push(Slice::from(&histograms[pass + 1]));
        let spec = plan.scatter_spec(pass, true);
        let push = plan.scatter_push(pass, 0);
        r.dispatch(&SORT_SCATTER, &spec, bytemuck::bytes_of(&push), &slices, groups.clone()).unwrap();
    }
    let mut commands = r.finish().unwrap();
    let mut best = (f64::MAX, Vec::new());
    let runs = 40;
    let start = cpu_milliseconds();
    for _ in 0..runs {
        let submission = gpu.submit(&mut commands).unwrap();
        gpu.wait(submission).unwrap();
        let timings: Vec<_> = commands.timings().unwrap().into_iter().filter(|t| t.label.starts_with("sort")).collect();
        let total: f64 = timings.iter().map(|t| t.us / 1000.0).sum();
        if total < best.0 {
            best = (total, timings.into_iter().map(|t| (t.label, (t.us / 10.0).round() / 100.0)).collect());
        }
    }
    ((cpu_milliseconds() - start) / f64::from(runs), best.0, best.1)
}
