//! The tables of what GPU compilers make of the kernels: complete, judged rightly, and in step with the choice of subgroup
//! sizes. The compilers themselves run in `spgs-dev isa --check`.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use engine::gpu::subgroup_size::{AMD, CHOICES};
use engine::gpu::{Kernel, Statistic};
use tools::dev::isa::{self, Row, Statistics, Target};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
}

fn golden(name: &str) -> Vec<Row> {
    isa::golden(root(), isa::target(name).unwrap()).unwrap()
}

#[test]
fn every_kernel_and_every_constant_is_compiled() {
    for target in isa::RADV {
        let rows = golden(target.name);
        for kernel in engine::kernels() {
            let own: Vec<&Row> = rows.iter().filter(|r| r.kernel == kernel.name).collect();
            // Native atomics are a capability of some GPUs only.
            if kernel.name == "blend_backward_native" && target.gpu != "navi31" {
                continue;
            }
            assert!(!own.is_empty(), "{}: {} is never compiled", target.name, kernel.name);
            for (i, constant) in kernel.spec[1..].iter().enumerate() {
                let values: BTreeSet<u32> = own.iter().map(|r| r.constants[i]).collect();
                let fixed = isa::limits::one_value(kernel.name, constant);
                assert!(
                    fixed || values.len() > 1,
                    "{}: {constant} of {} is always {values:?}",
                    target.name,
                    kernel.name
                );
            }
        }
    }
}

#[test]
fn nothing_is_broken_and_no_exception_is_idle() {
    let mut used = BTreeSet::new();
    for target in isa::RADV {
        for row in golden(target.name) {
            assert_eq!(isa::limits::broken(&target, &row), None);
            used.extend(isa::limits::exception(&target, &row).filter(|_| row.statistics.occupancy < target.floor));
        }
    }
    for (i, exception) in isa::limits::EXCEPTIONS.iter().enumerate() {
        let absent = !isa::RADV.iter().any(|t| t.name.starts_with(exception.target));
        assert!(absent || used.contains(&i), "{exception:?} excepts nothing");
    }
}

fn planted() -> (tempfile::TempDir, Target, Vec<Row>) {
    let folder = tempfile::tempdir().unwrap();
    let target = *isa::target("radv_navi31_32").unwrap();
    let reported = [("VGPRs", 48.0), ("Subgroups per SIMD", 16.0), ("Instructions", 400.0), ("Latency", 1000.0)];
    let statistics = Statistics::new(&reported.map(|(name, value)| Statistic { name: name.into(), value }));
    let rows = vec![Row { kernel: "blend".into(), constants: vec![0, 1], statistics }];
    isa::write(folder.path(), &target, "a GPU", &rows).unwrap();
    (folder, target, rows)
}

#[test]
fn what_became_worse_is_named() {
    let (folder, target, rows) = planted();
    let errors = |rows: &[Row]| isa::check(folder.path(), &target, "a GPU", rows).unwrap().errors;
    assert_eq!(errors(&rows), Vec::<String>::new());
    type Fault = fn(&mut Statistics);
    let faults: [(Fault, &str); 6] = [
        (|s| s.spills = 1.0, "spills 1 registers"),
        (|s| s.scratch = 16.0, "keeps 16 bytes in memory"),
        (|s| s.occupancy = 7.0, "has 7 subgroups in flight, expected at least 8"),
        (|s| s.occupancy = 12.0, "occupancy is 12, golden 16"),
        (|s| s.registers = 64.0, "registers is 64, golden 48"),
        (|s| s.instructions = 450.0, "instructions is 450, golden 400"),
    ];
    for (fault, expected) in faults {
        let mut worse = rows.clone();
        fault(&mut worse[0].statistics);
        let found = errors(&worse);
        assert!(found.iter().any(|e| e.contains(expected)), "{expected}: {found:?}");
    }
    let mut worse = rows.clone();
    worse[0].statistics.instructions = 450.0;
    let other = isa::check(folder.path(), &target, "a GPU, newer", &worse).unwrap();
    assert!(other.errors.is_empty() && other.other_compiler.is_some(), "a newer compiler is held to the limits only");
    worse[0].statistics.spills = 1.0;
    assert!(!isa::check(folder.path(), &target, "a GPU, newer", &worse).unwrap().errors.is_empty());
    let mut slack = rows.clone();
    (slack[0].statistics.registers, slack[0].statistics.instructions) = (56.0, 439.0);
    assert_eq!(errors(&slack), Vec::<String>::new());
    let mut other = rows.clone();
    other[0].constants[1] = 2;
    let found = errors(&other);
    assert!(found[0].contains("blend[0 2] is not in the golden file"), "{found:?}");
    assert!(found[1].contains("blend[0 1] is in the golden file only"), "{found:?}");
}

/// Estimated cost of the same work with either size: the rows that differ in nothing but the pixels of a lane.
fn costs(kernel: &Kernel, gpu: &str) -> [f64; 2] {
    let lanes = kernel.spec.iter().position(|c| *c == "PIXELS_PER_LANE");
    let of_size = |size: u32| -> BTreeMap<Vec<u32>, f64> {
        let own = golden(&format!("radv_{gpu}_{size}")).into_iter().filter(|r| r.kernel == kernel.name);
        own.map(|mut row| {
            let pixels = lanes.map_or(1, |i| std::mem::replace(&mut row.constants[i - 1], 0));
            (row.constants, row.statistics.cost / f64::from(pixels))
        })
        .collect()
    };
    let [narrow, wide] = [32, 64].map(of_size);
    let both = narrow.iter().filter_map(|(key, cost)| wide.get(key).map(|other| [*cost, *other]));
    both.fold([0.0; 2], |sum, pair| [sum[0] + pair[0], sum[1] + pair[1]])
}

#[test]
fn subgroup_sizes_on_amd_are_those_of_the_estimates() {
    // The self-test's own runs once, and should see what most kernels see.
    let once = |kernel: &Kernel| engine::self_test::KERNELS.iter().any(|k| k.name == kernel.name);
    for kernel in engine::kernels().filter(|k| !once(k)) {
        let own = CHOICES.iter().filter(|c| c.vendor == AMD);
        let choice = own.clone().find(|c| c.kernels.is_empty() || c.kernels.contains(&kernel.name)).unwrap();
        let [mut narrow, mut wide] = [0.0; 2];
        for gpu in ["navi31", "navi21"] {
            let [a, b] = costs(kernel, gpu);
            (narrow, wide) = (narrow + a, wide + b);
        }
        let (chosen, other) = if choice.size == 32 { (narrow, wide) } else { (wide, narrow) };
        println!("{:28} {} lanes: {:6.3} of the other", kernel.name, choice.size, chosen / other);
        assert!(chosen <= 1.05 * other, "{}: {} lanes cost {chosen}, the other size {other}", kernel.name, choice.size);
    }
}
