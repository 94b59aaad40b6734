//! Scenes at several levels of detail ("streamed SOG"): `lod-meta.json`, and a SOG folder for each part of a level.
//!
//! Format: <https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/streamed-sog/> (version 1, and the
//! files before it, which have none). `filenames` are the `meta.json` of the parts; `tree` divides space in two again and
//! again; each leaf says for every level, by its number, which `count` Gaussians from `offset` of which `file` it consists
//! of. Level 0 is the finest. `environment`, if there is one, belongs to every level. A level here is all of its leaves.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{META, prefix_of, read};
use crate::error::{Error, Result};
use crate::file::archive::{Archive, Files, is_inside};
use crate::file::codec::{check_memory, scene_bytes};
use crate::gpu::mmap::map_file;
use crate::scene::Gaussians;

/// Name of the description.
pub(crate) const LOD_META: &str = "lod-meta.json";
/// Largest `lod-meta.json`, bytes: half a million leaves.
const MAX_LOD_META: u64 = 256 << 20;

/// A level of detail.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Level {
    /// 0 is the finest.
    pub level: u32,
    /// Gaussians of all its leaves.
    pub gaussians: u64,
    /// The folders with its parts, relative to the file that describes them.
    pub folders: Vec<String>,
    /// The first of its files that is not there.
    pub missing: Option<String>,
    /// Whether it is the one that is read when none is asked for.
    pub is_default: bool,
}

impl fmt::Display for Level {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "level {:<18} {} Gaussians in {}", self.level, self.gaussians, folders(&self.folders))?;
        match &self.missing {
            Some(name) => write!(f, "; {name} is missing"),
            None => f.write_str(if self.is_default { "; this one is read" } else { "" }),
        }
    }
}

/// Few names, or how many.
fn folders(names: &[String]) -> String {
    if names.len() <= 3 { names.join(", ") } else { format!("{} folders", names.len()) }
}

/// The whole file. Unknown entries are ignored, as the format asks.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
struct Root {
    #[serde(default)]
    version: u32,
    lod_levels: u32,
    environment: Option<String>,
    filenames: Vec<String>,
    tree: Node,
}

/// A part of space. The parser bounds how deep they are nested.
#[derive(Debug, Deserialize)]
struct Node {
    children: Option<Vec<Node>>,
    lods: Option<BTreeMap<String, Run>>,
}

/// Gaussians of a leaf at one level.
#[derive(Debug, Clone, Copy, Deserialize)]
struct Run {
    file: u64,
    offset: u64,
    count: u64,
}

impl Run {
    fn end(&self) -> u64 {
        self.offset.saturating_add(self.count)
    }
}

/// What the levels are made of.
struct Tree {
    /// Folders of the parts, each empty or with a slash at its end.
    folders: Vec<String>,
    environment: Option<String>,
    /// Of each level its runs by file, in order, none overlapping another.
    levels: BTreeMap<u32, BTreeMap<usize, Vec<Run>>>,
}

/// A SOG folder within.
struct Part {
    gaussians: u64,
    /// Its pictures.
    names: Vec<String>,
    missing: Option<String>,
}

/// Reads one level of a scene with several: the one asked for, or the finest whose files are all there, with a warning
/// that says which. `path` is the folder, its `lod-meta.json` or a zip of it. Values are not judged (see
/// [`crate::file::load`]).
///
/// # Errors
/// [`Error::Usage`] for a level that is not there or lacks files; [`Error::Corrupt`] naming the file and entry;
/// [`Error::Io`], [`Error::Limit`].
pub fn read_level(path: &Path, level: Option<u32>) -> Result<(Gaussians, Vec<String>)> {
    with_files(path, |files| choose(files, path, level))
}

/// As [`read_level`], of a zip in memory; `path` only names it in errors.
///
/// # Errors
/// As [`read_level`].
pub fn parse_level(bytes: &[u8], path: &Path, level: Option<u32>) -> Result<(Gaussians, Vec<String>)> {
    choose(&mut archive(bytes, path)?, path, level)
}

/// The levels of a scene that has several, the finest first.
///
/// # Errors
/// As [`read_level`].
pub fn levels(path: &Path) -> Result<Vec<Level>> {
    with_files(path, |files| {
        let tree = Tree::read(files, path)?;
        Ok(tree.list(&tree.parts(files, path)?))
    })
}

/// The folder within an archive that holds `lod-meta.json`.
pub(crate) fn lod_prefix(names: &[String]) -> Option<String> {
    prefix_of(LOD_META, names)
}

fn with_files<T>(path: &Path, of: impl FnOnce(&mut Files<'_>) -> Result<T>) -> Result<T> {
    if path.is_dir() {
        return of(&mut Files::Folder(path.to_path_buf()));
    }
    if path.file_name().is_some_and(|n| n == LOD_META) {
        return of(&mut Files::Folder(path.parent().map(PathBuf::from).unwrap_or_default()));
    }
    of(&mut archive(&map_file(path)?, path)?)
}

fn archive<'a>(bytes: &'a [u8], path: &'a Path) -> Result<Files<'a>> {
    let archive = Archive::open(bytes, path)?;
    match lod_prefix(&archive.names()) {
        Some(prefix) => Ok(Files::Zip(archive, prefix)),
        None => Err(Error::corrupt(path, "zip directory", format!("no `{LOD_META}`"), "a streamed SOG archive")),
    }
}

/// An error in `lod-meta.json`.
fn corrupt(path: &Path, entry: &str, found: impl Into<String>, expected: impl Into<String>) -> Error {
    Error::corrupt(path, format!("{LOD_META}, `{entry}`"), found, expected)
}

fn choose(files: &mut Files<'_>, path: &Path, wanted: Option<u32>) -> Result<(Gaussians, Vec<String>)> {
    let tree = Tree::read(files, path)?;
    let parts = tree.parts(files, path)?;
    let levels = tree.list(&parts);
    let what = || format!("level of detail of {}", path.display());
    let Some(wanted) = wanted else {
        let Some(level) = levels.iter().find(|l| l.is_default) else {
            let found = format!("no level whose files are all there ({})", lacks(&levels));
            return Err(Error::corrupt(path, LOD_META, found, "one"));
        };
        let (gaussians, mut warnings) = tree.assemble(level.level, &parts, files, path)?;
        warnings.insert(0, choice(level, &levels, path));
        return Ok((gaussians, warnings));
    };
    let Some(level) = levels.iter().find(|l| l.level == wanted) else {
        let numbers: Vec<String> = levels.iter().map(|l| l.level.to_string()).collect();
        return Err(Error::usage(what(), wanted.to_string(), numbers.join(", ")));
    };
    match &level.missing {
        Some(name) => Err(Error::usage(what(), format!("{wanted}, which lacks {name}"), "a level that is all there")),
        None => tree.assemble(wanted, &parts, files, path),
    }
}

/// `level 1 lacks 1_0/meta.json, level 3 …`.
fn lacks(levels: &[Level]) -> String {
    let each = levels.iter().filter_map(|l| l.missing.as_ref().map(|name| format!("level {} lacks {name}", l.level)));
    each.collect::<Vec<_>>().join(", ")
}

/// The warning that one of several levels is read.
fn choice(level: &Level, levels: &[Level], path: &Path) -> String {
    let Level { level: number, gaussians, .. } = level;
    let mut text = format!("{}: level of detail {number} is read ({gaussians} Gaussians), ", path.display());
    let finest = levels.first().map_or(0, |l| l.level);
    text += if *number == finest { "the finest" } else { "the finest whose files are all there" };
    let others: Vec<String> = levels
        .iter()
        .filter(|l| l.level != *number && l.missing.is_none())
        .map(|l| format!("{} ({})", l.level, folders(&l.folders)))
        .collect();
    if !others.is_empty() {
        text += &format!("; others: {}: open one's folder, or name it to `spgs convert --level`", others.join(", "));
    }
    let missing = lacks(levels);
    if missing.is_empty() { text } else { format!("{text}; {missing}") }
}

impl Tree {
    fn read(files: &mut Files<'_>, path: &Path) -> Result<Self> {
        let bytes = files.read(LOD_META, MAX_LOD_META)?;
        let root: Root = serde_json::from_slice(&bytes)
            .map_err(|e| Error::corrupt(path, LOD_META, e.to_string(), "levels of detail of a SOG"))?;
        if root.version > 1 {
            return Err(corrupt(path, "version", root.version.to_string(), "1, or none"));
        }
        let folder = |entry: &str, name: &str| {
            let inner = name.strip_suffix(META).filter(|folder| folder.is_empty() || folder.ends_with('/'));
            inner
                .filter(|_| is_inside(name))
                .map(str::to_owned)
                .ok_or_else(|| corrupt(path, entry, format!("`{name}`"), format!("the `{META}` of a folder within")))
        };
        let folders = root.filenames.iter().map(|name| folder("filenames", name)).collect::<Result<_>>()?;
        let environment = root.environment.as_deref().map(|name| folder("environment", name)).transpose()?;
        let mut tree = Self { folders, environment, levels: BTreeMap::new() };
        let mut nodes = vec![&root.tree];
        while let Some(node) = nodes.pop() {
            let (children, lods) = (node.children.as_deref().unwrap_or_default(), node.lods.iter().flatten());
            if !children.is_empty() && node.lods.is_some() {
                return Err(corrupt(path, "tree", "a node with `children` and `lods`", "one of them"));
            }
            nodes.extend(children);
            for (name, run) in lods {
                tree.add(name, *run, root.lod_levels, path)?;
            }
        }
        tree.sort(path)?;
        Ok(tree)
    }

    /// Adds the Gaussians of a leaf at the level of this name.
    fn add(&mut self, name: &str, run: Run, levels: u32, path: &Path) -> Result<()> {
        let Some(level) = name.parse().ok().filter(|&level: &u32| level < levels) else {
            return Err(corrupt(path, "lods", format!("level `{name}`"), format!("below {levels}, `lodLevels`")));
        };
        let count = self.folders.len();
        let Some(file) = usize::try_from(run.file).ok().filter(|&file| file < count) else {
            let found = format!("file {} at level {level}", run.file);
            return Err(corrupt(path, "lods", found, format!("below {count}, the number of `filenames`")));
        };
        if run.count > 0 {
            self.levels.entry(level).or_default().entry(file).or_default().push(run);
        }
        Ok(())
    }

    /// Puts the runs of each file in order; each Gaussian may belong to one leaf only, so that no file can be read into
    /// more than it holds.
    fn sort(&mut self, path: &Path) -> Result<()> {
        for (level, files) in &mut self.levels {
            for runs in files.values_mut() {
                runs.sort_by_key(|run| run.offset);
                if let Some(pair) = runs.windows(2).find(|pair| pair[0].end() > pair[1].offset) {
                    let Run { file, offset, .. } = pair[1];
                    let found = format!("Gaussian {offset} of file {file} twice at level {level}");
                    return Err(corrupt(path, "lods", found, "leaves that do not overlap"));
                }
            }
        }
        Ok(())
    }

    /// Looks at every folder that a level uses, and checks that its runs lie within.
    fn parts(&self, files: &mut Files<'_>, path: &Path) -> Result<BTreeMap<usize, Part>> {
        let mut parts = BTreeMap::new();
        let used: BTreeSet<usize> = self.levels.values().flat_map(|files| files.keys().copied()).collect();
        for file in used {
            parts.insert(file, part(files, &self.folders[file], path)?);
        }
        for (level, runs) in self.levels.iter().flat_map(|(level, files)| files.values().map(move |runs| (level, runs)))
        {
            let Some(run) = runs.last() else { continue };
            let Some(part) = parts.get(&(run.file as usize)).filter(|part| part.missing.is_none()) else { continue };
            if run.end() > part.gaussians {
                let found = format!("Gaussians {} to {} of file {} at level {level}", run.offset, run.end(), run.file);
                return Err(corrupt(path, "lods", found, format!("at most {}, as in its {META}", part.gaussians)));
            }
        }
        Ok(parts)
    }

    fn list(&self, parts: &BTreeMap<usize, Part>) -> Vec<Level> {
        let mut is_found = false;
        let level = |(&level, files): (&u32, &BTreeMap<usize, Vec<Run>>)| {
            let missing = files.keys().find_map(|file| parts.get(file).and_then(|part| part.missing.clone()));
            let is_default = missing.is_none() && !is_found;
            is_found |= is_default;
            let folder = |&file: &usize| self.folders[file].trim_end_matches('/').to_owned();
            Level {
                level,
                gaussians: files.values().flatten().fold(0, |sum, run| run.count.saturating_add(sum)),
                folders: files.keys().map(folder).collect(),
                missing,
                is_default,
            }
        };
        self.levels.iter().map(level).collect()
    }

    /// All leaves of a level whose files are there, and the environment.
    fn assemble(
        &self,
        level: u32,
        parts: &BTreeMap<usize, Part>,
        files: &mut Files<'_>,
        path: &Path,
    ) -> Result<(Gaussians, Vec<String>)> {
        let none = BTreeMap::new();
        let runs = self.levels.get(&level).unwrap_or(&none);
        let environment = self.environment.as_ref().map(|folder| part(files, folder, path)).transpose()?;
        let mut warnings = Vec::new();
        if let Some(name) = environment.as_ref().and_then(|part| part.missing.as_ref()) {
            warnings.push(format!("{}: the environment is left out: {name} is missing", path.display()));
        }
        let environment = environment.filter(|part| part.missing.is_none());

        let used = || runs.keys().filter_map(|file| parts.get(file)).chain(&environment);
        let total: u64 = used().fold(0, |sum, part| part.gaussians.saturating_add(sum));
        let largest = used().map(|part| part.gaussians).max().unwrap_or(0);
        let need = scene_bytes(total, 3) + scene_bytes(largest, 3) + read::picture_bytes(largest);
        let names: BTreeSet<&str> = used().flat_map(|part| &part.names).map(String::as_str).collect();
        let bytes = files.total_bytes(&names.into_iter().collect::<Vec<_>>());
        check_memory(path, &format!("level of detail {level}"), need, bytes)?;

        let mut out = Gaussians::default();
        for (&file, runs) in runs {
            let part = read::read(files, &self.folders[file], path)?;
            for run in runs {
                let end = usize::try_from(run.end()).ok().filter(|&end| end <= part.len());
                let Some(end) = end else {
                    let found = format!("Gaussian {} of {}", run.end(), part.len());
                    return Err(corrupt(path, "lods", found, "one that file has"));
                };
                out.append(&part, run.offset as usize..end);
            }
        }
        if let (Some(folder), Some(_)) = (&self.environment, environment) {
            let part = read::read(files, folder, path)?;
            out.append(&part, 0..part.len());
        }
        Ok((out, warnings))
    }
}

/// What a SOG folder within says about itself.
fn part(files: &mut Files<'_>, folder: &str, path: &Path) -> Result<Part> {
    let name = format!("{folder}{META}");
    if !files.has(&name) {
        return Ok(Part { gaussians: 0, names: Vec::new(), missing: Some(name) });
    }
    let meta = read::description(files, folder, path)?;
    let names: Vec<String> = meta.names().into_iter().map(str::to_owned).collect();
    let missing = names.iter().find(|name| !files.has(name)).cloned();
    Ok(Part { gaussians: meta.gaussians(path)? as u64, names, missing })
}
