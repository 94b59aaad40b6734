//! Structures, constants and functions of `spgs.h` are those of the library.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use super::*;

fn header() -> String {
    std::fs::read_to_string(package().join("include/spgs.h")).unwrap()
}

#[test]
fn structures_have_the_librarys_layout() {
    let mut source = String::from("#include <stddef.h>\n#include <stdio.h>\n#include \"spgs.h\"\nint main(void) {\n");
    let mut expected = String::new();
    for (name, size, members) in spgs::LAYOUT {
        writeln!(source, "printf(\"{name} %zu\\n\", sizeof({name}));").unwrap();
        writeln!(expected, "{name} {size}").unwrap();
        for (member, offset) in *members {
            writeln!(source, "printf(\"{name}.{member} %zu\\n\", offsetof({name}, {member}));").unwrap();
            writeln!(expected, "{name}.{member} {offset}").unwrap();
        }
    }
    let constants = [
        ("SPGS_OK", 0),
        ("SPGS_ERROR", 1),
        ("SPGS_USAGE", 2),
        ("SPGS_BAD_DATA", 3),
        ("SPGS_LIMIT", 4),
        ("SPGS_DEVICE_LOST", 5),
        ("SPGS_NOT_FINITE", 6),
        ("SPGS_PANIC", 7),
        ("SPGS_NOT_READY", 8),
        ("SPGS_RGBA8", engine::render::PixelFormat::Rgba8 as i32),
        ("SPGS_BGRA8", engine::render::PixelFormat::Bgra8 as i32),
        ("SPGS_RGBA16F", engine::render::PixelFormat::Rgba16F as i32),
        ("SPGS_RGBA32F", engine::render::PixelFormat::Rgba32F as i32),
    ];
    for (name, value) in constants {
        writeln!(source, "printf(\"{name} %d\\n\", (int){name});").unwrap();
        writeln!(expected, "{name} {value}").unwrap();
    }
    source.push_str("return 0; }\n");
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("layout.c");
    std::fs::write(&file, source).unwrap();
    let output = run(&compile(&file, folder.path(), &[]), &[]);
    assert_eq!(String::from_utf8_lossy(&output.stdout), expected);
    // No structure of the header is missing in the table.
    let declared = header().lines().filter(|l| l.starts_with("typedef struct") && l.ends_with('{')).count();
    assert_eq!(declared, spgs::LAYOUT.len());
}

#[test]
fn the_library_exports_the_headers_functions() {
    let text = header();
    let declared: BTreeSet<String> = text
        .split("SPGS_API ")
        .skip(1)
        .filter_map(|rest| rest.split('(').next()?.rsplit([' ', '*']).next().map(str::to_owned))
        .filter(|name| name.starts_with("spgs_"))
        .collect();
    let output =
        Command::new("nm").args(["-D", "--defined-only"]).arg(library_folder().join("libspgs.so")).output().unwrap();
    let symbols = String::from_utf8(output.stdout).unwrap();
    let exported: BTreeSet<String> = symbols
        .lines()
        .filter_map(|l| l.split_whitespace().nth(2))
        .filter(|name| name.starts_with("spgs_"))
        .map(str::to_owned)
        .collect();
    assert!(declared.len() > 20, "{declared:?}");
    assert_eq!(declared, exported);
}

#[test]
fn the_header_is_c_plus_plus_too() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("header.cpp");
    std::fs::write(&file, "#include \"spgs.h\"\nint main() { return spgs_version() == 0; }\n").unwrap();
    let output = Command::new("c++")
        .args(["-Wall", "-Wextra", "-Werror", "-pedantic", "-fsyntax-only", "-I"])
        .arg(package().join("include"))
        .arg(&file)
        .output()
        .expect("c++ (ci/setup installs it)");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}
