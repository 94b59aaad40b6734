//! `spgs-dev spirv`: compiles `glsl/*/*.comp` (and `painter.vert`, `painter.frag`) to `spirv_cache/*.spv` with shaderc and keeps a manifest of hashes, so that
//! users need no shader compiler and CI can prove that what is committed is fresh.
//!
//! SPIR-V 1.5 for Vulkan 1.2 without debug information: the dialect that naga reads. Drivers optimise it; what they would
//! first do with each copy of a function, `spirv-opt` does once here ([`PASSES`]), and a software driver makes the pipelines
//! of a training run in half the time.
//! Either way the kernels' flow is checked: see [`crate::dev::uniform_flow`].
//!
//! Shaderc is called through its own program `glslc`: Debian's `libshaderc` cannot be linked (undefined glslang symbols).
//! `glslc -O` takes the names away, which the declarations are checked against.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

use engine::error::{Error, Result};
use engine::scene::parameter;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use crate::dev::uniform_flow;

/// Flags of the compiler, as recorded in the manifest.
pub const FLAGS: &[&str] = &["--target-env=vulkan1.2", "--target-spv=spv1.5", "-O0", "-Werror", "-Iglsl"];
/// Passes of `spirv-opt`: functions into their callers, variables into values. None changes arithmetic. Functions that return
/// early stay functions: merging their returns takes a switch around the body.
pub const PASSES: &[&str] = &[
    "--eliminate-dead-branches",
    "--inline-entry-points-exhaustive",
    "--eliminate-dead-functions",
    "--eliminate-dead-code-aggressive",
    "--private-to-local",
    "--eliminate-local-single-block",
    "--eliminate-local-single-store",
    "--eliminate-dead-code-aggressive",
    "--vector-dce",
    "--convert-local-access-chains",
    "--eliminate-local-single-block",
    "--eliminate-local-single-store",
    "--eliminate-dead-code-aggressive",
];
/// Constants of the kernels that the table of parameters gives.
const PARAMETERS: &str = "glsl/lib/parameters.glsl";
const MANIFEST: &str = "manifest.json";
const MAX_INCLUDE_DEPTH: usize = 16;

/// What is recorded for one kernel.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Entry {
    /// SHA-256 of the GLSL with its includes expanded.
    pub source_sha256: String,
    /// SHA-256 of the SPIR-V.
    pub spirv_sha256: String,
}

/// `spirv_cache/manifest.json`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Manifest {
    /// Compiler and version.
    pub compiler: String,
    /// Its flags.
    pub flags: Vec<String>,
    /// Passes of `spirv-opt` after it.
    pub passes: Vec<String>,
    /// By kernel name.
    pub kernels: BTreeMap<String, Entry>,
}

/// What `spirv` and `spirv --check` did.
#[derive(Debug, Default)]
pub struct Outcome {
    /// One line per kernel that was written or is stale.
    pub lines: Vec<String>,
    /// Number of kernels.
    pub kernels: usize,
    /// Whether something is stale.
    pub stale: bool,
}

/// Compiles everything and writes `spirv_cache/`. `root` is the folder of the workspace.
pub fn write(root: &Path) -> Result<Outcome> {
    let compiler = Compiler::find_or_say("spgs-dev spirv")?;
    let mut outcome = Outcome::default();
    let constants = root.join(PARAMETERS);
    if std::fs::read_to_string(&constants).ok().as_deref() != Some(&parameter::glsl()) {
        std::fs::write(&constants, parameter::glsl()).map_err(|e| Error::io(&constants, "write", e))?;
        outcome.lines.push(format!("{PARAMETERS}: written"));
    }
    let mut kernels = BTreeMap::new();
    let cache = root.join("spirv_cache");
    for (name, path) in sources(root)? {
        let expanded = expand(&path, root, 0)?;
        let spirv = compiler.compile(&path, root)?;
        kernels
            .insert(name.clone(), Entry { source_sha256: sha256(expanded.as_bytes()), spirv_sha256: sha256(&spirv) });
        let target = cache.join(format!("{name}.spv"));
        if std::fs::read(&target).ok().as_deref() != Some(spirv.as_slice()) {
            std::fs::write(&target, &spirv).map_err(|e| Error::io(&target, "write", e))?;
            outcome.lines.push(format!("{name}: written, {} bytes", spirv.len()));
        }
    }
    for name in orphans(&cache, &kernels)? {
        let path = cache.join(format!("{name}.spv"));
        std::fs::remove_file(&path).map_err(|e| Error::io(&path, "remove", e))?;
        outcome.lines.push(format!("{name}: removed, no {name}.comp in a folder of glsl"));
    }
    outcome.kernels = kernels.len();
    let manifest = Manifest { compiler: compiler.version, flags: owned(FLAGS), passes: owned(PASSES), kernels };
    let path = cache.join(MANIFEST);
    let text = serde_json::to_string_pretty(&manifest).map_err(|e| Error::io(&path, "encode", e.into()))? + "\n";
    std::fs::write(&path, text).map_err(|e| Error::io(&path, "write", e))?;
    Ok(outcome)
}

/// Proves freshness: hashes always; with the shader compiler, also that compiling again gives the same bytes (only when
/// its version is the recorded one: another version may encode the same program differently).
pub fn check(root: &Path) -> Result<Outcome> {
    let cache = root.join("spirv_cache");
    let manifest = read_manifest(&cache.join(MANIFEST))?;
    let mut outcome = Outcome::default();
    for (what, found, expected) in [("compiled", &manifest.flags, FLAGS), ("optimised", &manifest.passes, PASSES)] {
        if *found != owned(expected) {
            outcome.stale(format!("manifest: {what} with {found:?}, expected {expected:?}"));
        }
    }
    let constants = root.join(PARAMETERS);
    if std::fs::read_to_string(&constants).map_err(|e| Error::io(&constants, "read", e))? != parameter::glsl() {
        outcome.stale(format!("{PARAMETERS}: not what the table of parameters says"));
    }
    let compiler = Compiler::find();
    let recompile = compiler.as_ref().filter(|c| c.version == manifest.compiler);
    let sources = sources(root)?;
    for (name, path) in &sources {
        outcome.kernels += 1;
        let Some(entry) = manifest.kernels.get(name) else {
            outcome.stale(format!("{name}: not in the manifest"));
            continue;
        };
        if sha256(expand(path, root, 0)?.as_bytes()) != entry.source_sha256 {
            outcome.stale(format!("{name}: the GLSL or an include changed since it was compiled"));
            continue;
        }
        let target = cache.join(format!("{name}.spv"));
        let committed = std::fs::read(&target).map_err(|e| Error::io(&target, "read", e))?;
        if sha256(&committed) != entry.spirv_sha256 {
            outcome.stale(format!("{name}: the SPIR-V is not the one in the manifest"));
        } else if let Some(compiler) = recompile
            && compiler.compile(path, root)? != committed
        {
            outcome.stale(format!("{name}: compiling it again gives other bytes"));
        }
    }
    for name in manifest.kernels.keys().filter(|n| !sources.iter().any(|(s, _)| s == *n)) {
        outcome.stale(format!("{name}: in the manifest, but there is no {name}.comp in a folder of glsl"));
    }
    for name in orphans(&cache, &manifest.kernels)? {
        outcome.stale(format!("{name}: spirv_cache/{name}.spv is not in the manifest"));
    }
    let how = match (recompile, &compiler) {
        (Some(c), _) => format!("hashes and bytes compared ({})", c.version),
        (None, Some(c)) => {
            format!("hashes compared; bytes not: this is {}, the cache is of {}", c.version, manifest.compiler)
        }
        (None, None) => "hashes compared; bytes not: no programs `glslc` and `spirv-opt`".to_owned(),
    };
    outcome.lines.push(how);
    Ok(outcome)
}

/// Subgroup and workgroup operations of the committed kernels in flow that is not uniform for their scope, one line each; see
/// [`uniform_flow`].
pub fn check_flow(root: &Path) -> Result<Vec<String>> {
    let cache = root.join("spirv_cache");
    let mut lines = Vec::new();
    // The shaders of the graphics pipeline have two stems.
    for (name, path) in stems(&cache, "spv")?.into_iter().filter(|(name, _)| !name.contains('.')) {
        let spirv = std::fs::read(&path).map_err(|e| Error::io(&path, "read", e))?;
        lines.extend(uniform_flow::violations(&path, &spirv)?.into_iter().map(|line| format!("{name}: {line}")));
    }
    Ok(lines)
}

impl Outcome {
    fn stale(&mut self, line: String) {
        self.stale = true;
        self.lines.push(format!("{line}; run spgs-dev spirv"));
    }
}

/// Reads the manifest.
pub fn read_manifest(path: &Path) -> Result<Manifest> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
    serde_json::from_str(&text).map_err(|e| {
        Error::corrupt(path, format!("line {}", e.line()), e.to_string(), "a manifest written by spgs-dev spirv")
    })
}

/// Name and path of every `glsl/*/*.comp`, sorted by name.
/// Kernels by their stem, the shaders of the graphics pipeline by their whole name.
pub(super) fn sources(root: &Path) -> Result<Vec<(String, PathBuf)>> {
    let glsl = root.join("glsl");
    let entries = std::fs::read_dir(&glsl).map_err(|e| Error::io(&glsl, "list", e))?;
    let mut found = Vec::new();
    for entry in entries {
        let folder = entry.map_err(|e| Error::io(&glsl, "list", e))?.path();
        if !folder.is_dir() {
            continue;
        }
        found.extend(stems(&folder, "comp")?);
        for stage in ["vert", "frag"] {
            found.extend(stems(&folder, stage)?.into_iter().map(|(stem, path)| (format!("{stem}.{stage}"), path)));
        }
    }
    found.sort();
    Ok(found)
}

fn orphans(cache: &Path, kernels: &BTreeMap<String, Entry>) -> Result<Vec<String>> {
    Ok(stems(cache, "spv")?.into_iter().map(|(name, _)| name).filter(|n| !kernels.contains_key(n)).collect())
}

fn stems(folder: &Path, extension: &str) -> Result<Vec<(String, PathBuf)>> {
    let entries = std::fs::read_dir(folder).map_err(|e| Error::io(folder, "list", e))?;
    let mut found = Vec::new();
    for entry in entries {
        let path = entry.map_err(|e| Error::io(folder, "list", e))?.path();
        if path.extension().is_some_and(|e| e == extension)
            && let Some(stem) = path.file_stem()
        {
            found.push((stem.to_string_lossy().into_owned(), path.clone()));
        }
    }
    found.sort();
    Ok(found)
}

/// The files that make a kernel: its own and all that it includes.
pub(super) fn files(path: &Path, root: &Path) -> Result<BTreeSet<PathBuf>> {
    let mut found = BTreeSet::new();
    let mut waiting = vec![path.to_owned()];
    while let Some(path) = waiting.pop() {
        let text = std::fs::read_to_string(&path).map_err(|e| Error::io(&path, "read", e))?;
        waiting.extend(text.lines().filter_map(included).map(|file| resolve(&path, root, file)));
        found.insert(path);
        waiting.retain(|path| !found.contains(path));
    }
    Ok(found)
}

/// Where an included file is: beside the including one, else in `glsl/`, as for the compiler.
fn resolve(path: &Path, root: &Path, file: &str) -> PathBuf {
    let beside = path.with_file_name(file);
    if beside.is_file() { beside } else { root.join("glsl").join(file) }
}

/// The source with `#include "…"` replaced by the file, recursively.
fn expand(path: &Path, root: &Path, depth: usize) -> Result<String> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
    if depth > MAX_INCLUDE_DEPTH {
        return Err(Error::corrupt(path, "#include", "a cycle", format!("at most {MAX_INCLUDE_DEPTH} levels")));
    }
    let mut out = String::with_capacity(text.len());
    for line in text.lines() {
        match included(line) {
            Some(file) => {
                out.push_str(&expand(&resolve(path, root, file), root, depth + 1)?);
            }
            None => {
                out.push_str(line);
                out.push('\n');
            }
        }
    }
    Ok(out)
}

/// The file of an `#include "file"` line.
fn included(line: &str) -> Option<&str> {
    let rest = line.trim().strip_prefix("#include")?.trim();
    rest.strip_prefix('"')?.split('"').next()
}

/// Lower-case hexadecimal SHA-256.
pub fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

fn owned(words: &[&str]) -> Vec<String> {
    words.iter().map(|&word| word.to_owned()).collect()
}

/// Shaderc's compiler program, and the optimiser of SPIRV-Tools.
#[derive(Debug)]
pub(super) struct Compiler {
    /// Versions of shaderc, SPIRV-Tools, glslang and `spirv-opt`.
    version: String,
}

impl Compiler {
    /// The `glslc` and `spirv-opt` of the search path.
    fn find() -> Option<Self> {
        let asked = |program| Command::new(program).arg("--version").output().ok().filter(|o| o.status.success());
        let text = String::from_utf8_lossy(&asked("glslc")?.stdout).into_owned();
        let mut version: Vec<&str> = text.lines().take_while(|line| !line.trim().is_empty()).map(str::trim).collect();
        // Some versions say it on standard error.
        let said = asked("spirv-opt")?;
        let text = String::from_utf8_lossy(&[said.stdout, said.stderr].concat()).into_owned();
        let optimiser = format!("spirv-opt {}", text.split_whitespace().nth(1).unwrap_or("of no version"));
        version.push(&optimiser);
        Some(Self { version: version.join("; ") })
    }

    /// [`Self::find`], or what to install for this task.
    pub(super) fn find_or_say(task: &str) -> Result<Self> {
        Self::find().ok_or_else(|| {
            Error::usage(task, "no programs `glslc` and `spirv-opt`", "both (ci/setup --tests installs them)")
        })
    }

    /// Compiles a shader of the workspace in `root` with [`FLAGS`].
    pub(super) fn compile(&self, path: &Path, root: &Path) -> Result<Vec<u8>> {
        self.compile_with(path, root, &[])
    }

    /// [`Self::compile`] with more flags, which come last.
    pub(super) fn compile_with(&self, path: &Path, root: &Path, flags: &[&str]) -> Result<Vec<u8>> {
        let failed = |e: &dyn std::fmt::Display| Error::corrupt(path, "compilation", e.to_string(), "valid GLSL");
        let out = tempfile::NamedTempFile::new().map_err(|e| Error::io(path, "make a temporary file for", e))?;
        let relative = path.strip_prefix(root).unwrap_or(path);
        let ran = Command::new("glslc")
            .current_dir(root)
            .args(FLAGS)
            .args(flags)
            .arg(relative)
            .arg("-o")
            .arg(out.path())
            .output()
            .map_err(|e| failed(&e))?;
        if !ran.status.success() {
            return Err(failed(&String::from_utf8_lossy(&ran.stderr)));
        }
        let ran = Command::new("spirv-opt")
            .args(PASSES)
            .arg(out.path())
            .arg("-o")
            .arg(out.path())
            .output()
            .map_err(|e| failed(&format_args!("spirv-opt (package spirv-tools): {e}")))?;
        if !ran.status.success() {
            return Err(failed(&String::from_utf8_lossy(&ran.stderr)));
        }
        std::fs::read(out.path()).map_err(|e| Error::io(out.path(), "read", e))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    fn project() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for sub in ["glsl/lib", "glsl/render", "spirv_cache"] {
            std::fs::create_dir_all(folder.path().join(sub)).unwrap();
        }
        std::fs::write(folder.path().join(PARAMETERS), parameter::glsl()).unwrap();
        std::fs::write(folder.path().join("glsl/lib/b.glsl"), "const uint B = 2u;\n").unwrap();
        std::fs::write(folder.path().join("glsl/lib/a.glsl"), "#include \"b.glsl\"\n").unwrap();
        std::fs::write(
            folder.path().join("glsl/render/k.comp"),
            "#version 460\n#include \"lib/a.glsl\"\nvoid main() {}\n",
        )
        .unwrap();
        std::fs::write(folder.path().join("spirv_cache/k.spv"), b"module").unwrap();
        let source = expand(&folder.path().join("glsl/render/k.comp"), folder.path(), 0).unwrap();
        assert_eq!(source, "#version 460\nconst uint B = 2u;\nvoid main() {}\n");
        let entry = Entry { source_sha256: sha256(source.as_bytes()), spirv_sha256: sha256(b"module") };
        let kernels = BTreeMap::from([("k".to_owned(), entry)]);
        // Another compiler version: bytes cannot be compared, hashes are.
        let manifest = Manifest { compiler: "none".into(), flags: owned(FLAGS), passes: owned(PASSES), kernels };
        let text = serde_json::to_string(&manifest).unwrap();
        std::fs::write(folder.path().join("spirv_cache/manifest.json"), text).unwrap();
        folder
    }

    #[test]
    fn an_untouched_cache_is_fresh() {
        let outcome = check(project().path()).unwrap();
        assert!(!outcome.stale, "{:?}", outcome.lines);
        assert_eq!(outcome.kernels, 1);
    }

    #[test]
    fn every_kind_of_staleness_is_seen() {
        let touch: [(&str, &str); 6] = [
            (PARAMETERS, "const uint PLANE_MEAN = 1u;\n"),
            ("glsl/lib/b.glsl", "const uint B = 3u;\n"),
            ("glsl/render/k.comp", "#version 460\nvoid main() {}\n"),
            ("spirv_cache/k.spv", "other"),
            ("glsl/render/new.comp", "void main() {}\n"),
            ("spirv_cache/orphan.spv", "x"),
        ];
        for (file, content) in touch {
            let folder = project();
            std::fs::write(folder.path().join(file), content).unwrap();
            assert!(check(folder.path()).unwrap().stale, "{file}");
        }
        let folder = project();
        std::fs::remove_file(folder.path().join("glsl/render/k.comp")).unwrap();
        assert!(check(folder.path()).unwrap().stale, "removed source");
    }

    #[test]
    fn an_include_cycle_is_an_error() {
        let folder = project();
        std::fs::write(folder.path().join("glsl/lib/b.glsl"), "#include \"lib/a.glsl\"\n").unwrap();
        assert!(check(folder.path()).is_err());
    }
}
