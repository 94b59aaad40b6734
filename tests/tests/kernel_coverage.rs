//! No kernel goes without a case against its twin, at any subgroup size that the gate runs.

use std::collections::BTreeSet;

/// Kernels that store to an image of a host's, which a kernel case has not: the test `embed` compares their images with those
/// of the kernels that store to buffers, and the model runs them beside their twins.
const STORE_TO_IMAGES: [&str; 3] = ["blend_rgba8", "blend_rgba16f", "blend_rgba32f"];

/// After the kernel tests ran at the subgroup sizes `SPGS_TEST_COVERED_LANES` (such as `4,8,16`) with `SPGS_TEST_COVERAGE`
/// (ci/test), every kernel of the engine is in that log at each.
#[test]
fn every_kernel_ran_beside_its_twin() {
    let kernels: BTreeSet<&str> = engine::kernels().map(|k| k.name).filter(|k| !STORE_TO_IMAGES.contains(k)).collect();
    assert!(kernels.len() > 50, "{kernels:?}");
    let (Some(path), Ok(sizes)) = (std::env::var_os("SPGS_TEST_COVERAGE"), std::env::var("SPGS_TEST_COVERED_LANES"))
    else {
        eprintln!("SKIPPED: SPGS_TEST_COVERAGE and SPGS_TEST_COVERED_LANES are not set; ci/test sets them");
        return;
    };
    let log = std::fs::read_to_string(path).unwrap();
    let lines: Vec<serde_json::Value> = log.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    for lanes in sizes.split(',').map(|size| size.parse::<u64>().unwrap()) {
        let at_size = lines.iter().filter(|line| line["lanes"] == lanes);
        let compared = at_size.flat_map(|line| line["compared"].as_array().unwrap());
        let ran: BTreeSet<&str> = compared.map(|name| name.as_str().unwrap()).collect();
        let missing: Vec<_> = kernels.difference(&ran).collect();
        assert!(missing.is_empty(), "no case of these ran at subgroup size {lanes}: {missing:?}");
    }
}
