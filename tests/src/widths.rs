//! Subgroup sizes other than the device's own: lavapipe has 4, 8 or 16 lanes by `LP_NATIVE_VECTOR_WIDTH`. The gate
//! (`ci/test`) runs every kernel test at each.

/// The device has the lanes that `SPGS_TEST_LANES` says, if it is set.
///
/// # Panics
/// When it has not.
pub fn assert_lanes(gpu: &engine::gpu::Gpu) {
    if let Ok(lanes) = std::env::var("SPGS_TEST_LANES") {
        assert_eq!(gpu.subgroup_size().to_string(), lanes, "subgroup size");
    }
}
