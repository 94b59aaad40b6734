//! What the self-test says of this device, and how long it takes.

use engine::gpu::Gpu;
use engine::self_test::{Suite, runs};

use crate::{open, options};

/// Seconds of a suite once the kernels are compiled; one run of these must be within, because other tests run meanwhile.
const SECONDS: f64 = 0.3;
const RUNS: usize = 30;

#[test]
fn this_device_passes() {
    let gpu = open(&options());
    for suite in Suite::ALL {
        let cold = gpu.self_test(suite).unwrap();
        assert!(cold.passed() && cold.suite == suite);
        let mut warm = f64::INFINITY;
        for _ in 0..RUNS {
            warm = warm.min(gpu.self_test(suite).unwrap().seconds);
            if warm <= SECONDS {
                break;
            }
        }
        println!("{}: {:.3} s, then {warm:.3} s with compiled kernels", suite.name(), cold.seconds);
        assert!(warm <= SECONDS, "{}: {warm} s, at most {SECONDS} expected", suite.name());
    }
    let before = runs();
    Gpu::new(&options()).unwrap();
    assert!(runs() > before, "a device of which nothing is known is tested");
}
