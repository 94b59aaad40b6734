//! Which kernels the model has run.

use std::collections::BTreeSet;

use tests_harness::model::kernels_that_meet;

/// After the kernel tests ran on the model with `SPGS_TEST_MODEL_LOG` (ci/model), every kernel whose invocations meet is in
/// that log at 32, 64 and 128 lanes.
#[test]
fn every_kernel_whose_invocations_meet_ran_on_the_model() {
    let kernels = kernels_that_meet();
    assert!(kernels.contains("sort_scatter") && kernels.contains("blend") && kernels.len() > 25, "{kernels:?}");
    let Some(path) = std::env::var_os("SPGS_TEST_MODEL_LOG") else {
        eprintln!("SKIPPED: SPGS_TEST_MODEL_LOG is not set; ci/model runs the kernels on the model and sets it");
        return;
    };
    let log = std::fs::read_to_string(path).unwrap();
    let ran: BTreeSet<&str> = log.lines().collect();
    for lanes in [32, 64, 128] {
        let missing: Vec<_> = kernels.iter().filter(|k| !ran.contains(format!("{lanes} {k}").as_str())).collect();
        assert!(missing.is_empty(), "no test ran these on the model with {lanes} lanes: {missing:?}");
    }
}
