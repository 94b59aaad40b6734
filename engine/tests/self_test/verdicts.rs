//! What the self-test says of this device, and how long it takes.

use engine::gpu::{Gpu, GpuOptions, SelfTest};
use engine::self_test::{Suite, runs};

use crate::{open, options};

/// Seconds of a suite once the kernels are compiled; one run of these must be within, because other tests run meanwhile.
const SECONDS: f64 = 0.3;
const RUNS: usize = 40;

#[test]
fn this_device_passes() {
    let gpu = open(&options());
    // The layer takes longer than the kernels; users run without it.
    let timed = open(&GpuOptions { validation: false, ..options() });
    for suite in Suite::ALL {
        let verdict = gpu.self_test(suite).unwrap();
        assert!(verdict.passed() && verdict.suite == suite);
        let cold = timed.self_test(suite).unwrap().seconds;
        let mut warm = f64::INFINITY;
        for _ in 0..RUNS {
            warm = warm.min(timed.self_test(suite).unwrap().seconds);
            if warm <= SECONDS {
                break;
            }
        }
        println!("{}: {cold:.3} s, then {warm:.3} s with compiled kernels", suite.name());
        assert!(warm <= SECONDS, "{}: {warm} s, at most {SECONDS} expected", suite.name());
    }
    let before = runs();
    Gpu::new(&options()).unwrap();
    assert!(runs() > before, "a device of which nothing is known is tested");
}

/// Wherever the time ends: on software devices the second one ends in a step, the last one everywhere in the first wait.
#[test]
fn a_time_out_is_told_as_one() {
    let outcomes = [0.03, 0.01, 0.003, 1e-7].map(|timeout_s| {
        let gpu = open(&GpuOptions { timeout_s, self_test: SelfTest::Skip, ..options() });
        gpu.self_test(Suite::Training).map_err(|e| e.to_string())
    });
    for said in outcomes.iter().filter_map(|outcome| outcome.as_ref().err()) {
        println!("{said}");
        assert!(said.contains("SPGS_TIMEOUT_S"), "{said}");
    }
    assert!(outcomes[3].is_err(), "no device answers in 100 ns");
}
