//! Subgroup sizes other than the device's own: lavapipe has 4, 8 or 16 lanes by `LP_NATIVE_VECTOR_WIDTH`, which the
//! driver reads when it starts, so the tests run again in processes of their own.

const CHILD: &str = "SPGS_TEST_LANES";

/// Runs these tests of the calling test binary again with 4 and with 16 lanes. Does nothing in such a child, or when
/// the device is not lavapipe.
///
/// # Panics
/// When a child fails, or does not have the lanes asked for.
pub fn repeat_with_other_widths(tests: &[&str]) {
    if std::env::var_os(CHILD).is_some() || !crate::gpu().info().is_cpu() {
        return;
    }
    for (width, lanes) in [("128", "4"), ("512", "16")] {
        let program = std::env::current_exe().unwrap_or_else(|e| panic!("the test binary: {e}"));
        let output = std::process::Command::new(program)
            .arg("--exact")
            .args(tests)
            .env("LP_NATIVE_VECTOR_WIDTH", width)
            .env(CHILD, lanes)
            .output()
            .unwrap_or_else(|e| panic!("child with {lanes} lanes: {e}"));
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success(), "{lanes} lanes: {text}{}", String::from_utf8_lossy(&output.stderr));
        let ran = format!("{} passed", tests.len());
        assert!(text.contains(&ran), "{lanes} lanes: expected {ran}, found {text}");
    }
}

/// The device of a child has the lanes that the parent asked for; call it in the tests that are repeated.
///
/// # Panics
/// When it has not.
pub fn assert_lanes(gpu: &engine::gpu::Gpu) {
    if let Ok(lanes) = std::env::var(CHILD) {
        assert_eq!(gpu.subgroup_size().to_string(), lanes, "subgroup size");
    }
}
