//! What the self-test says of this device, and how long it takes.

use engine::gpu::Gpu;
use engine::self_test::{Suite, runs};

use crate::{open, options};

/// Seconds of a suite once the kernels are compiled, in an optimised build.
const SECONDS: f64 = 0.3;

#[test]
fn this_device_passes() {
    let gpu = open(&options());
    for suite in Suite::ALL {
        let cold = gpu.self_test(suite).unwrap();
        let warm = gpu.self_test(suite).unwrap();
        println!("{}: {:.3} s, then {:.3} s with compiled kernels", suite.name(), cold.seconds, warm.seconds);
        assert!(warm.passed() && warm.suite == suite);
        // Twins and the reference run on the CPU too: only an optimised build says how long users wait.
        assert!(cfg!(debug_assertions) || warm.seconds <= SECONDS, "{} s, at most {SECONDS} expected", warm.seconds);
    }
    let before = runs();
    Gpu::new(&options()).unwrap();
    assert!(runs() > before, "a device of which nothing is known is tested");
}
