//! The model reads every kernel that is committed.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::path::Path;

use spgs_model::Program;

#[test]
fn every_committed_kernel_is_read() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../spirv_cache");
    let mut read = 0;
    let mut refused = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if !name.ends_with(".spv") || name.starts_with("painter") {
            continue;
        }
        let bytes = std::fs::read(&path).unwrap();
        let words: Vec<u32> = bytes.chunks_exact(4).map(|b| u32::from_le_bytes(b.try_into().unwrap())).collect();
        read += 1;
        if let Err(error) = Program::new(&words, &[32]) {
            refused.push(format!("{name}: {error}"));
        }
    }
    assert!(read > 50, "only {read} kernels");
    assert!(refused.is_empty(), "{}", refused.join("\n"));
}
