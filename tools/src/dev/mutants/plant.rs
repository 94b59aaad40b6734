//! A mutant's shaders: the text is changed in a copy of `glsl/` and compiled as `spgs-dev spirv` does.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use engine::error::{Error, Result};

use super::sites::{self, Site};
use crate::dev::spirv::{self, Compiler};

/// A fault in a file of `glsl/`.
#[derive(Debug, Clone)]
pub(super) struct Mutant {
    /// The file, relative to the folder of the workspace.
    pub(super) file: PathBuf,
    /// The file as it is.
    pub(super) text: std::rc::Rc<str>,
    /// The change.
    pub(super) site: Site,
    /// Names of the kernels that include the file.
    pub(super) kernels: std::rc::Rc<[String]>,
}

impl Mutant {
    /// Name that stays as long as the file and the kinds of faults do.
    pub(super) fn id(&self) -> String {
        let text = spirv::sha256(self.text.as_bytes());
        let range = &self.site.range;
        format!("{} {} {}..{} {}", self.file.display(), &text[..12], range.start, range.end, self.site.with)
    }

    /// `glsl/a.comp:12: bound: `i >= n` -> `true``, in its line.
    pub(super) fn describe(&self) -> String {
        let (line, before, after) = self.lines();
        format!("{}:{line}: {:?}: {before}  ->  {after}", self.file.display(), self.site.fault)
    }

    /// Number of the line, from 1; the line as it is and with the fault, without the space around it.
    pub(super) fn lines(&self) -> (usize, &str, String) {
        let line = self.text[..self.site.range.start].matches('\n').count();
        let before = self.text.lines().nth(line).unwrap_or("").trim();
        let after = self.changed().lines().nth(line).unwrap_or("").trim().to_owned();
        (line + 1, before, after)
    }

    /// The file with the fault.
    pub(super) fn changed(&self) -> String {
        let range = &self.site.range;
        [&self.text[..range.start], &self.site.with, &self.text[range.end..]].concat()
    }
}

/// Every mutant of the kernels that the filter lets through, file by file.
pub(super) fn mutants(root: &Path, wanted: impl Fn(&str) -> bool) -> Result<Vec<Mutant>> {
    let mut includers = BTreeMap::<PathBuf, Vec<String>>::new();
    // The shaders of the graphics pipeline have no twin.
    for (name, path) in spirv::sources(root)?.into_iter().filter(|(name, _)| !name.contains('.')) {
        for file in spirv::files(&path, root)? {
            includers.entry(file).or_default().push(name.clone());
        }
    }
    let mut all = Vec::new();
    for (path, kernels) in includers {
        let kernels: Vec<String> = kernels.into_iter().filter(|k| wanted(k)).collect();
        if kernels.is_empty() {
            continue;
        }
        let text = std::fs::read_to_string(&path).map_err(|e| Error::io(&path, "read", e))?;
        let file = path.strip_prefix(root).unwrap_or(&path).to_owned();
        let (text, kernels): (std::rc::Rc<str>, std::rc::Rc<[String]>) = (text.into(), kernels.into());
        let sites = sites::sites(&text).into_iter();
        all.extend(sites.map(|site| Mutant { file: file.clone(), text: text.clone(), site, kernels: kernels.clone() }));
    }
    Ok(all)
}

/// What became of a mutant's shaders.
pub(super) enum Planted {
    /// They do not compile.
    Rejected,
    /// An optimising compiler makes of them what it makes of the original: nothing is wrong with them.
    Same,
    /// These kernels differ: their SPIR-V is in [`Workshop::spirv`].
    Kernels(BTreeSet<String>),
}

/// A copy of `glsl/` in which faults are planted, one at a time.
pub(super) struct Workshop {
    folder: tempfile::TempDir,
    compiler: Compiler,
    /// Optimised SPIR-V of the kernels as they are.
    optimised: BTreeMap<String, Vec<u8>>,
}

impl Workshop {
    /// # Errors
    /// `Usage` without a shader compiler; `Io` when the copy fails.
    pub(super) fn new(root: &Path) -> Result<Self> {
        let compiler = Compiler::find_or_say("spgs-dev mutants")?;
        let folder = tempfile::tempdir().map_err(|e| Error::io(Path::new("glsl"), "make a temporary copy of", e))?;
        copy(&root.join("glsl"), &folder.path().join("glsl"))?;
        Ok(Self { folder, compiler, optimised: BTreeMap::new() })
    }

    /// The folder with the SPIR-V of the mutant planted last.
    pub(super) fn spirv(&self) -> PathBuf {
        self.folder.path().join("spirv")
    }

    /// Compiles the kernels of a mutant.
    pub(super) fn plant(&mut self, mutant: &Mutant) -> Result<Planted> {
        let spirv = self.spirv();
        if spirv.exists() {
            std::fs::remove_dir_all(&spirv).map_err(|e| Error::io(&spirv, "empty", e))?;
        }
        std::fs::create_dir(&spirv).map_err(|e| Error::io(&spirv, "make", e))?;
        self.optimise_originals(mutant)?;
        let file = self.folder.path().join(&mutant.file);
        write(&file, mutant.changed().as_bytes())?;
        let planted = self.compile(mutant);
        write(&file, mutant.text.as_bytes())?;
        planted
    }

    fn compile(&self, mutant: &Mutant) -> Result<Planted> {
        let root = self.folder.path();
        let mut differ = BTreeSet::new();
        for (name, path) in self.sources(mutant)? {
            let Ok(optimised) = self.compiler.compile_with(&path, root, &["-O"]) else { return Ok(Planted::Rejected) };
            if self.optimised.get(&name) == Some(&optimised) {
                continue;
            }
            let Ok(bytes) = self.compiler.compile(&path, root) else { return Ok(Planted::Rejected) };
            write(&self.spirv().join(format!("{name}.spv")), &bytes)?;
            differ.insert(name);
        }
        Ok(if differ.is_empty() { Planted::Same } else { Planted::Kernels(differ) })
    }

    fn optimise_originals(&mut self, mutant: &Mutant) -> Result<()> {
        for (name, path) in self.sources(mutant)? {
            if !self.optimised.contains_key(&name) {
                let made = self.compiler.compile_with(&path, self.folder.path(), &["-O"])?;
                self.optimised.insert(name, made);
            }
        }
        Ok(())
    }

    fn sources(&self, mutant: &Mutant) -> Result<Vec<(String, PathBuf)>> {
        let all = spirv::sources(self.folder.path())?;
        Ok(all.into_iter().filter(|(name, _)| mutant.kernels.contains(name)).collect())
    }
}

fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    std::fs::write(path, bytes).map_err(|e| Error::io(path, "write", e))
}

fn copy(from: &Path, to: &Path) -> Result<()> {
    std::fs::create_dir_all(to).map_err(|e| Error::io(to, "make", e))?;
    for entry in std::fs::read_dir(from).map_err(|e| Error::io(from, "list", e))? {
        let path = entry.map_err(|e| Error::io(from, "list", e))?.path();
        let target = to.join(path.file_name().unwrap_or_default());
        if path.is_dir() {
            copy(&path, &target)?;
        } else {
            std::fs::copy(&path, &target).map_err(|e| Error::io(&path, "copy", e))?;
        }
    }
    Ok(())
}
