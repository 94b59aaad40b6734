//! Which frames train and test, and their times.

use std::path::{Path, PathBuf};

use serde_json::Value;

use super::object;
use crate::data::dataset::{DatasetOptions, SplitRule};
use crate::data::json::{self, show};
use crate::error::{Error, Result};

/// Ids by split.
#[derive(Debug)]
pub(super) struct Lists {
    pub(super) train: Vec<String>,
    pub(super) test: Vec<String>,
    /// Downscale of the published results for such a scene.
    pub(super) default_downscale: u32,
}

/// Rule by name (released SP-GS and Deformable-3DGS loaders: the name of the scene's parent folder; the scene's own is
/// looked at too): `vrig*` and `NeRF*` use the lists, `interp*` frames 4i and 4i + 2. Other scenes use the lists if both
/// have frames (Nerfies' own loader), else frames 4i and 4i + 2 (the released loaders train on 4i without a test).
pub(super) fn read(folder: &Path, options: &DatasetOptions, decisions: &mut Vec<String>) -> Result<Lists> {
    let path = folder.join("dataset.json");
    let top = object(&path)?;
    let list = |key: &str| ids(&top, &path, key);
    let (train_ids, val_ids) = (list("train_ids")?, list("val_ids")?);
    let ids = match list("ids")? {
        ids if ids.is_empty() => train_ids.iter().chain(&val_ids).cloned().collect(),
        ids => ids,
    };
    let group = group(folder);
    let listed = !train_ids.is_empty() && !val_ids.is_empty();
    let rule = match (options.split, group) {
        (SplitRule::Auto, Group::Interpolation) => SplitRule::Interpolation,
        (SplitRule::Auto, Group::Other) if !listed => SplitRule::Interpolation,
        (SplitRule::Auto, _) => SplitRule::Lists,
        (rule, _) => rule,
    };
    decisions.push(format!("{}{}", rule.describe(), if options.split == SplitRule::Auto { group.why() } else { "" }));
    let by_place = |train: bool| {
        let kept = ids.iter().enumerate().filter(|(i, _)| rule.place(*i) == Some(train));
        kept.map(|(_, id)| id.clone()).collect()
    };
    let (train, test): (Vec<String>, Vec<String>) = match rule {
        SplitRule::Lists => (train_ids, val_ids),
        _ => (by_place(true), by_place(false)),
    };
    if train.is_empty() {
        return Err(Error::corrupt(&path, "key `train_ids`", "no training frame", "at least one"));
    }
    let default_downscale = if group == Group::Nerf { 1 } else { 2 };
    Ok(Lists { train, test, default_downscale })
}

/// Kind of scene by folder name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Group {
    Vrig,
    Nerf,
    Interpolation,
    Other,
}

impl Group {
    fn why(self) -> &'static str {
        match self {
            Self::Vrig => " (a folder vrig*)",
            Self::Nerf => " (a folder NeRF*)",
            Self::Interpolation => " (a folder interp*)",
            Self::Other => " (no folder vrig*, NeRF* or interp*)",
        }
    }
}

fn group(folder: &Path) -> Group {
    let full = folder.canonicalize().unwrap_or_else(|_| PathBuf::from(folder));
    let names = [full.parent().and_then(Path::file_name), full.file_name()];
    let begins = |prefix: &str| names.iter().flatten().any(|n| n.to_string_lossy().starts_with(prefix));
    if begins("vrig") {
        Group::Vrig
    } else if begins("NeRF") {
        Group::Nerf
    } else if begins("interp") {
        Group::Interpolation
    } else {
        Group::Other
    }
}

fn ids(top: &json::Keys, path: &Path, key: &str) -> Result<Vec<String>> {
    let wrong = |value: &Value| Error::corrupt(path, format!("key `{key}`"), show(value), "a list of frame names");
    match top.get(key) {
        None => Ok(Vec::new()),
        Some(Value::Array(list)) => list
            .iter()
            .map(|id| {
                // A name becomes part of a path: it must stay inside the data set.
                let plain = |s: &&str| !s.is_empty() && !s.contains(['/', '\\', '\0']) && *s != "..";
                id.as_str().filter(plain).map(str::to_owned).ok_or_else(|| wrong(id))
            })
            .collect(),
        Some(other) => Err(wrong(other)),
    }
}

/// Times of all frames.
#[derive(Debug)]
pub(super) struct Times {
    path: PathBuf,
    metadata: json::Keys,
    key: &'static str,
    largest: f64,
}

/// Time = `time_id`, else `warp_id`, over its maximum in the used frames.
pub(super) fn times(folder: &Path, lists: &Lists, decisions: &mut Vec<String>) -> Result<Times> {
    let path = folder.join("metadata.json");
    let metadata = object(&path)?;
    let used = || lists.train.iter().chain(&lists.test);
    let all_have = |key: &str| used().all(|id| metadata.get(id).is_some_and(|m| m.get(key).is_some()));
    let key = if all_have("time_id") { "time_id" } else { "warp_id" };
    let mut times = Times { path, metadata, key, largest: 1.0 };
    let largest = used().map(|id| times.number(id)).try_fold(0.0, |m: f64, v| Ok::<_, Error>(m.max(v?)))?;
    times.largest = if largest > 0.0 { largest } else { 1.0 };
    decisions.push(format!("time rule: {key} / {}", times.largest));
    Ok(times)
}

impl Times {
    fn number(&self, id: &str) -> Result<f64> {
        let value = self.metadata.get(id).and_then(|m| m.get(self.key));
        value.and_then(json::finite).filter(|t| *t >= 0.0).ok_or_else(|| {
            let found = value.map_or("nothing".into(), show);
            Error::corrupt(&self.path, format!("frame `{id}` key `{}`", self.key), found, "a number from 0")
        })
    }

    pub(super) fn of(&self, id: &str) -> Result<f64> {
        Ok(self.number(id)? / self.largest)
    }
}
