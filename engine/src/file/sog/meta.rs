//! `meta.json`, versions 1 and 2.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// The whole file. What only one version has is optional.
#[derive(Debug, Deserialize, Serialize)]
pub(super) struct Meta {
    /// 2, or absent in version 1.
    #[serde(default = "one")]
    pub(super) version: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) asset: Option<serde_json::Value>,
    /// N of version 2.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) count: Option<u64>,
    pub(super) means: Part,
    pub(super) scales: Part,
    pub(super) quats: Part,
    pub(super) sh0: Part,
    #[serde(rename = "shN", skip_serializing_if = "Option::is_none")]
    pub(super) sh_n: Option<Part>,
}

/// One attribute.
#[derive(Debug, Default, Deserialize, Serialize)]
pub(super) struct Part {
    /// Rows of the SH palette (version 2).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) count: Option<u64>,
    /// SH degree (version 2).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) bands: Option<u32>,
    /// `[N, …]` (version 1).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) shape: Option<Vec<u64>>,
    /// A number for all channels, or one for each.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) mins: Option<Numbers>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) maxs: Option<Numbers>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) codebook: Option<Vec<f32>>,
    pub(super) files: Vec<String>,
}

/// One number or several.
#[derive(Debug, Deserialize, Serialize)]
#[serde(untagged)]
pub(super) enum Numbers {
    One(f64),
    Many(Vec<f64>),
}

fn one() -> u32 {
    1
}

impl Numbers {
    /// The number of channel `c`.
    fn get(&self, c: usize) -> Option<f64> {
        match self {
            Self::One(v) => Some(*v),
            Self::Many(list) => list.get(c).copied(),
        }
    }
}

/// How the bytes of a channel are values.
pub(super) enum Values {
    /// Version 2.
    Codebook(Box<[f32; 256]>),
    /// Version 1: lows and highs of 4 channels.
    Between([[f64; 2]; 4]),
}

impl Values {
    /// The value of a byte in channel `c`.
    pub(super) fn of(&self, byte: u8, c: usize) -> f32 {
        match self {
            Self::Codebook(book) => book[usize::from(byte)],
            Self::Between(ends) => (ends[c][0] + (ends[c][1] - ends[c][0]) * f64::from(byte) / 255.0) as f32,
        }
    }
}

impl Part {
    /// The name of picture `i`.
    pub(super) fn file(&self, name: &str, i: usize, path: &Path) -> Result<&str> {
        let missing = || corrupt(path, &format!("{name}.files"), format!("{} names", self.files.len()), "more");
        self.files.get(i).map(String::as_str).ok_or_else(missing)
    }

    /// Low and high of channels 0 to `channels` − 1; the rest 0.
    pub(super) fn ends(&self, name: &str, channels: usize, path: &Path) -> Result<[[f64; 2]; 4]> {
        let mut ends = [[0.0; 2]; 4];
        for (c, end) in ends.iter_mut().enumerate().take(channels) {
            let number = |list: &Option<Numbers>| list.as_ref().and_then(|n| n.get(c)).filter(|v| v.is_finite());
            let (Some(low), Some(high)) = (number(&self.mins), number(&self.maxs)) else {
                let found = "no such numbers, or not finite";
                return Err(corrupt(
                    path,
                    &format!("{name}.mins, {name}.maxs"),
                    found,
                    &format!("{channels} numbers each"),
                ));
            };
            *end = [low, high];
        }
        Ok(ends)
    }

    /// The codebook (version 2), or the ends of `channels` channels.
    pub(super) fn values(&self, name: &str, version: u32, channels: usize, path: &Path) -> Result<Values> {
        if version == 1 {
            return Ok(Values::Between(self.ends(name, channels, path)?));
        }
        let book = self.codebook.as_deref().unwrap_or_default();
        match <[f32; 256]>::try_from(book) {
            Ok(book) => Ok(Values::Codebook(Box::new(book))),
            Err(_) => Err(corrupt(path, &format!("{name}.codebook"), format!("{} numbers", book.len()), "256")),
        }
    }
}

/// An error in `meta.json`.
pub(super) fn corrupt(path: &Path, entry: &str, found: impl Into<String>, expected: &str) -> Error {
    Error::corrupt(path, format!("meta.json, `{entry}`"), found, expected)
}

/// Parses `meta.json`.
pub(super) fn parse(bytes: &[u8], path: &Path) -> Result<Meta> {
    let meta: Meta = serde_json::from_slice(bytes)
        .map_err(|e| Error::corrupt(path, "meta.json", e.to_string(), "a SOG description of version 1 or 2"))?;
    if !(1..=2).contains(&meta.version) {
        return Err(corrupt(path, "version", meta.version.to_string(), "1 or 2"));
    }
    Ok(meta)
}

impl Meta {
    /// With the pictures in this folder (empty, or with a slash at its end).
    pub(super) fn in_folder(mut self, folder: &str) -> Self {
        let parts =
            [&mut self.means, &mut self.scales, &mut self.quats, &mut self.sh0].into_iter().chain(&mut self.sh_n);
        // An empty name stays one, which is refused.
        for name in parts.flat_map(|part| &mut part.files).filter(|name| !name.is_empty()) {
            name.insert_str(0, folder);
        }
        self
    }

    /// Names of all pictures.
    pub(super) fn names(&self) -> Vec<&str> {
        let parts = [&self.means, &self.scales, &self.quats, &self.sh0].into_iter().chain(&self.sh_n);
        parts.flat_map(|part| part.files.iter().map(String::as_str)).collect()
    }

    /// N.
    pub(super) fn gaussians(&self, path: &Path) -> Result<usize> {
        let of_shape = self.means.shape.as_ref().and_then(|s| s.first().copied());
        let count = if self.version == 1 { of_shape.or(self.count) } else { self.count };
        let n = count.ok_or_else(|| corrupt(path, "count", "nothing", "the number of Gaussians"))?;
        usize::try_from(n)
            .ok()
            .filter(|&n| n <= u32::MAX as usize)
            .ok_or_else(|| corrupt(path, "count", n.to_string(), "at most 2^32 − 1"))
    }
}
