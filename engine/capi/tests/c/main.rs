//! The C interface as a C compiler sees it: the header is in step with the library, the example host compiles without a
//! warning, runs without a validation message and draws what the Rust host draws; misuse gets a status.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
#![allow(clippy::undocumented_unsafe_blocks, reason = "calls of the C interface")]

#[path = "../../../examples/host/composite.rs"]
mod composite;
mod frames;
mod header;
mod host;
mod misuse;
mod scenes;
#[path = "../../../examples/host/vulkan.rs"]
mod vulkan;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The folder of this package.
fn package() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// The folder with the shared library that Cargo built for these tests.
fn library_folder() -> PathBuf {
    let exe = std::env::current_exe().unwrap();
    let deps = exe.parent().unwrap();
    let age = |folder: &Path| std::fs::metadata(folder.join("libspgs.so")).and_then(|m| m.modified()).ok();
    let folders = [deps.to_path_buf(), deps.parent().unwrap().to_path_buf()];
    let newest = folders.into_iter().filter(|f| age(f).is_some()).max_by_key(|f| age(f));
    newest.expect("libspgs.so is built with the tests")
}

/// Compiles a C program against the header and the library.
fn compile(source: &Path, folder: &Path, libraries: &[&str]) -> PathBuf {
    let program = folder.join("program");
    let output = Command::new("cc")
        .args(["-std=c11", "-Wall", "-Wextra", "-Werror", "-pedantic", "-I"])
        .arg(package().join("include"))
        .arg(source)
        .arg("-o")
        .arg(&program)
        .arg("-L")
        .arg(library_folder())
        .args(libraries)
        .output()
        .expect("cc (ci/setup installs it)");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    // What the program asks for is the library's soname.
    let named = folder.join("libspgs.so.0");
    if !named.exists() {
        std::fs::copy(library_folder().join("libspgs.so"), named).unwrap();
    }
    program
}

fn run(program: &Path, arguments: &[&str]) -> Output {
    Command::new(program).args(arguments).env("LD_LIBRARY_PATH", program.parent().unwrap()).output().unwrap()
}
