//! The architecture as a test: imports of the engine's modules and of the tools' folders only point downwards, `ash` and
//! `unsafe` stay in the GPU module, and the names of shaders, SPIR-V and Rust agree.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod paths;
mod text;
mod tools_tree;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use text::{code_only, tokens};

/// Modules of `engine`, lowest first; those of one line may not import each other.
const LAYERS: &[&[&str]] = &[
    &["manual"],
    &["error"],
    &["gpu"],
    &["scene"],
    &["image"],
    &["reference"],
    &["file"],
    &["data"],
    &["metrics"],
    &["render"],
    &["train"],
    &["confidence"],
    &["edit"],
    &["distill"],
    &["pose"],
    &["self_test"],
];
/// Names that the crate root re-exports, and where they live.
const ROOT_NAMES: &[(&str, &str)] = &[
    ("Error", "error"),
    ("Result", "error"),
    ("gpu_buffers", "gpu"),
    ("gpu_constants", "gpu"),
    ("gpu_struct", "gpu"),
    ("kernel", "gpu"),
    ("kernels", "self_test"),
];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_path_buf()
}

fn files(folder: &Path, extension: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display())) {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path, extension));
        } else if path.extension().is_some_and(|e| e == extension) {
            found.push(path);
        }
    }
    found.sort();
    found
}

fn stems(folder: &str, extension: &str) -> BTreeSet<String> {
    let all = files(&root().join(folder), extension);
    all.iter().map(|p| p.file_stem().unwrap().to_string_lossy().into_owned()).collect()
}

fn rank(module: &str) -> Option<usize> {
    LAYERS.iter().position(|layer| layer.contains(&module))
}

/// Top-level names that the path or brace group at `at` (after `crate::`) reaches.
fn heads(t: &[String], at: usize) -> Vec<String> {
    if t.get(at).map(String::as_str) != Some("{") {
        return t.get(at).cloned().into_iter().collect();
    }
    let (mut depth, mut names, mut expects) = (0, Vec::new(), true);
    for token in &t[at..] {
        match token.as_str() {
            "{" => depth += 1,
            "}" => depth -= 1,
            "," if depth == 1 => expects = true,
            name if depth == 1 && expects => {
                names.push(name.to_owned());
                expects = false;
            }
            _ => {}
        }
        if depth == 0 {
            break;
        }
    }
    names
}

/// Every top-level module of the engine that a file names, through `crate::` or by climbing with `super::`.
fn imports(module: &[String], code: &str) -> Vec<String> {
    let t = tokens(code);
    let is = |i: usize, s: &str| t.get(i).is_some_and(|x| x == s);
    let mut inline: Vec<usize> = Vec::new();
    let (mut depth, mut found, mut i) = (0_usize, Vec::new(), 0);
    while i < t.len() {
        match t[i].as_str() {
            "{" => {
                depth += 1;
                if i >= 2 && is(i - 2, "mod") {
                    inline.push(depth);
                }
            }
            "}" => {
                if inline.last() == Some(&depth) {
                    inline.pop();
                }
                depth = depth.saturating_sub(1);
            }
            "crate" if is(i + 1, "::") => found.extend(heads(&t, i + 2)),
            "super" if is(i + 1, "::") && !(i >= 2 && is(i - 1, "::") && is(i - 2, "super")) => {
                let mut levels = 0;
                while is(i, "super") && is(i + 1, "::") {
                    (levels, i) = (levels + 1, i + 2);
                }
                let own = module.len() + inline.len();
                assert!(levels <= own, "super:: climbs out of the crate in {module:?}");
                if levels == own {
                    found.extend(heads(&t, i));
                }
                continue;
            }
            _ => {}
        }
        i += 1;
    }
    found
}

/// `engine/src/file/ply/read.rs` → `[file, ply, read]`; `mod.rs` and `lib.rs` name their folder.
fn module_path(source: &Path, file: &Path) -> Vec<String> {
    let relative = file.strip_prefix(source).unwrap().with_extension("");
    let mut path: Vec<String> = relative.iter().map(|p| p.to_string_lossy().into_owned()).collect();
    if path.last().is_some_and(|p| p == "mod" || p == "lib") {
        path.pop();
    }
    path
}

/// The upward imports of one file.
fn violations(module: &[String], code: &str) -> Vec<String> {
    let Some(own) = module.first() else { return Vec::new() };
    let own_rank = rank(own).unwrap_or_else(|| panic!("module `{own}` has no place in LAYERS"));
    let mut wrong = Vec::new();
    for name in imports(module, code) {
        let target = ROOT_NAMES.iter().find(|(n, _)| *n == name).map_or(name.as_str(), |(_, m)| *m);
        match rank(target) {
            Some(r) if target == own.as_str() || r < own_rank => {}
            Some(_) => wrong.push(format!("`{}` imports `{target}`, which is not below it", module.join("::"))),
            None => wrong.push(format!("`{}` names crate::{name}, which has no place in LAYERS", module.join("::"))),
        }
    }
    wrong
}

#[test]
fn imports_point_downwards() {
    let source = root().join("engine/src");
    let all = files(&source, "rs");
    assert!(all.len() > 20, "found only {} files", all.len());
    let wrong: Vec<String> = all
        .iter()
        .flat_map(|f| violations(&module_path(&source, f), &code_only(&std::fs::read_to_string(f).unwrap())))
        .collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn the_import_check_sees_every_way_to_write_one() {
    let module = |text: &str| text.split("::").map(str::to_owned).collect::<Vec<_>>();
    for upward in [
        "use crate::render::Renderer;",
        "use crate::{error::Error, render};",
        "use crate::{\n    error::{Error, Result},\n    render::Renderer,\n};",
        "fn f() { crate::file::load(); }",
        "use super::super::render;",
        "mod tests { use super::super::super::data::Camera; }",
        "use super::super::{render, error};",
    ] {
        assert!(!violations(&module("scene::camera"), upward).is_empty(), "{upward}");
    }
    for fine in [
        "use crate::Error; use super::gaussians;",
        "// use crate::render;\n/* use crate::data; */",
        "let s = \"crate::render\"; let r = r#\"crate::file\"#; let c = '\"';",
        "mod tests { use super::super::motion; }",
        "use crate::gpu::{Buffer, render_pass};",
    ] {
        assert!(violations(&module("scene::camera"), &code_only(fine)).is_empty(), "{fine}");
    }
}

#[test]
fn only_the_gpu_module_names_ash_or_writes_unsafe() {
    let root = root();
    let gpu = root.join("engine/src/gpu");
    let mut unsafe_words = 0;
    for folder in ["engine/src", "tools", "tests"] {
        for file in files(&root.join(folder), "rs") {
            let code = code_only(&std::fs::read_to_string(&file).unwrap());
            let t = tokens(&code);
            let has = |word: &str| t.iter().any(|x| x == word);
            if file.starts_with(&gpu) {
                unsafe_words += usize::from(has("unsafe"));
            } else {
                assert!(!has("unsafe"), "{} writes `unsafe`", file.display());
                let names_ash =
                    t.windows(2).any(|w| (w[0] == "ash" && w[1] == "::") || (w[0] == "use" && w[1] == "ash"));
                assert!(!names_ash, "{} names `ash`", file.display());
            }
        }
    }
    assert!(unsafe_words > 0, "the scan found no `unsafe` where there is some");
}

#[test]
fn files_and_functions_stay_readable() {
    for folder in ["engine/src", "tools/src", "tests/src", "tests/tests"] {
        for file in files(&root().join(folder), "rs") {
            let lines = std::fs::read_to_string(&file).unwrap().lines().count();
            assert!(lines <= 500, "{}: {lines} lines, at most 500 expected", file.display());
        }
    }
}

#[test]
fn shaders_spirv_and_rust_have_the_same_names() {
    let root = root();
    let shaders = files(&root.join("glsl"), "comp");
    let glsl: BTreeSet<String> =
        shaders.iter().map(|p| p.file_stem().unwrap().to_string_lossy().into_owned()).collect();
    assert_eq!(glsl.len(), shaders.len(), "two shaders of one name");
    assert!(!glsl.is_empty());
    // The shaders of the one graphics pipeline keep their stage in the name.
    let painter = ["painter.frag", "painter.vert"].map(str::to_owned);
    let compiled: BTreeSet<String> = glsl.iter().cloned().chain(painter).collect();
    assert_eq!(compiled, stems("spirv_cache", "spv"), "glsl/*/*.comp and spirv_cache/*.spv");
    let rust: String =
        files(&root.join("engine/src"), "rs").iter().map(|f| std::fs::read_to_string(f).unwrap()).collect();
    for name in &glsl {
        let declared = format!("static {}: ", name.to_uppercase());
        assert!(rust.contains(&declared), "no `{declared}` in engine/src");
        let homes = |folder: &str| files(&root.join("engine/src").join(folder), "rs");
        let own = ["render", "train", "metrics", "self_test"].into_iter().flat_map(homes);
        let count = own.filter(|p| p.file_stem().is_some_and(|stem| stem.to_str() == Some(name.as_str()))).count();
        assert_eq!(count, 1, "files {name}.rs of kernels in engine/src");
        let named = format!("name: \"{name}\"");
        assert!(rust.contains(&named), "no `{named}` in engine/src");
    }
}

#[test]
fn every_shader_include_is_used() {
    let root = root();
    let mut used: BTreeMap<String, usize> = BTreeMap::new();
    for file in files(&root.join("glsl"), "comp").into_iter().chain(files(&root.join("glsl"), "glsl")) {
        for line in std::fs::read_to_string(&file).unwrap().lines() {
            if let Some(name) = line.trim().strip_prefix("#include \"").and_then(|r| r.split(".glsl\"").next()) {
                *used.entry(name.trim_start_matches("lib/").to_owned()).or_default() += 1;
            }
        }
    }
    let includes = stems("glsl/lib", "glsl");
    assert_eq!(used.into_keys().collect::<BTreeSet<_>>(), includes, "included names and glsl/lib/*.glsl");
}
