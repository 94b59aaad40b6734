//! Tensors by name, their numbers read from the archive when asked for.

use std::collections::BTreeMap;
use std::path::Path;

use super::pickle::{self, Element, Id, Parsed, Tensor, Value};
use super::{PICKLE, prefix};
use crate::error::{Error, Result};
use crate::file::archive::Archive;
use crate::file::codec::check_memory;
use crate::file::model::TensorInfo;

/// Largest pickle, bytes: weights of thousands of tensors are below 1 MiB.
const MAX_PICKLE: u64 = 4 << 20;
/// Deepest nesting of lists and dictionaries that holds tensors.
const MAX_DEPTH: usize = 6;
/// Most values that are looked at to find tensors.
const MAX_VISITS: usize = 1 << 20;

/// The tensors of a `.pth`. Names are the keys of nested dictionaries and the indices of lists, joined by `.`:
/// `1.sp_xyz` is entry `sp_xyz` of the second dictionary in a list.
pub struct Weights<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    tensors: BTreeMap<String, Tensor>,
    /// Where each stored array lies in the file.
    arrays: BTreeMap<String, std::ops::Range<usize>>,
}

impl Element {
    fn bytes(self) -> usize {
        match self {
            Self::F64 | Self::I64 => 8,
            Self::F32 | Self::I32 => 4,
            Self::F16 | Self::BF16 | Self::I16 => 2,
            Self::I8 | Self::U8 | Self::Bool => 1,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::F64 => "F64",
            Self::F32 => "F32",
            Self::F16 => "F16",
            Self::BF16 => "BF16",
            Self::I64 => "I64",
            Self::I32 => "I32",
            Self::I16 => "I16",
            Self::I8 => "I8",
            Self::U8 => "U8",
            Self::Bool => "BOOL",
        }
    }

    /// The number at the start of `b`.
    #[inline]
    fn read(self, b: &[u8]) -> f64 {
        macro_rules! number {
            ($t:ty) => {
                <$t>::from_le_bytes(b.first_chunk().copied().unwrap_or_default())
            };
        }
        match self {
            Self::F64 => number!(f64),
            Self::F32 => number!(f32).into(),
            Self::F16 => half(number!(u16)),
            Self::BF16 => f32::from_bits(u32::from(number!(u16)) << 16).into(),
            Self::I64 => number!(i64) as f64,
            Self::I32 => number!(i32).into(),
            Self::I16 => number!(i16).into(),
            Self::I8 => number!(i8).into(),
            Self::U8 | Self::Bool => number!(u8).into(),
        }
    }
}

/// A 16-bit float.
fn half(bits: u16) -> f64 {
    let sign = if bits & 0x8000 != 0 { -1.0 } else { 1.0 };
    let fraction = f64::from(bits & 0x3ff);
    sign * match bits >> 10 & 31 {
        0 => fraction / 16_777_216.0,
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        exponent => (1.0 + fraction / 1024.0) * 2f64.powi(i32::from(exponent) - 15),
    }
}

impl<'a> Weights<'a> {
    /// Parses the pickle; `path` only names the file in errors.
    ///
    /// # Errors
    /// [`Error::Corrupt`] naming the instruction or entry.
    pub fn parse(bytes: &'a [u8], path: &'a Path) -> Result<Self> {
        let mut archive = Archive::open(bytes, path)?;
        let Some(prefix) = prefix(&archive.names()) else {
            return Err(Error::corrupt(path, "zip directory", "no `data.pkl`", "PyTorch weights"));
        };
        if archive.names().contains(&format!("{prefix}byteorder")) {
            let order = archive.read(&format!("{prefix}byteorder"), 16)?;
            if order != b"little" {
                let found = String::from_utf8_lossy(&order).into_owned();
                return Err(Error::corrupt(path, "zip entry `byteorder`", found, "little"));
            }
        }
        let parsed = pickle::parse(&archive.read(&format!("{prefix}{PICKLE}"), MAX_PICKLE)?, path)?;
        let tensors = named(&parsed, path)?;
        let mut weights = Self { path, bytes, tensors, arrays: BTreeMap::new() };
        let keys: std::collections::BTreeSet<&String> = weights.tensors.values().map(|t| &t.key).collect();
        let mut arrays = BTreeMap::new();
        for key in keys {
            arrays.insert(key.clone(), archive.stored(&format!("{prefix}data/{key}"))?);
        }
        weights.arrays = arrays;
        weights.tensors.iter().try_for_each(|(name, t)| weights.check(name, t))?;
        Ok(weights)
    }

    /// The tensor lies within its array and has no more elements than it.
    fn check(&self, name: &str, t: &Tensor) -> Result<()> {
        let have = self.arrays.get(&t.key).map_or(0, std::ops::Range::len) / t.element.bytes();
        let count = t.shape.iter().try_fold(1u64, |n, &s| n.checked_mul(s));
        let last = t.shape.iter().zip(&t.stride).try_fold(u128::from(t.offset), |at, (&size, &stride)| {
            at.checked_add(u128::from(size.saturating_sub(1)) * u128::from(stride))
        });
        match (count, last) {
            (Some(0), _) => Ok(()),
            (Some(count), Some(last)) if count <= have as u64 && last < have as u128 => Ok(()),
            _ => {
                let found = format!("shape {:?}, strides {:?}, offset {}", t.shape, t.stride, t.offset);
                let expected = format!("what lies in the {have} elements of array `{}`", t.key);
                Err(Error::corrupt(self.path, format!("tensor `{name}`"), found, expected))
            }
        }
    }

    /// Whether there is a tensor of this name.
    pub fn has(&self, name: &str) -> bool {
        self.tensors.contains_key(name)
    }

    /// Names of all tensors.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.tensors.keys().map(String::as_str)
    }

    /// Shape of a tensor.
    pub fn shape(&self, name: &str) -> Option<Vec<usize>> {
        self.tensors.get(name).map(|t| t.shape.iter().map(|&s| s as usize).collect())
    }

    /// All tensors, for `inspect`.
    pub fn describe(&self) -> Vec<TensorInfo> {
        let info = |(name, t): (&String, &Tensor)| {
            let shape: Vec<usize> = t.shape.iter().map(|&s| s as usize).collect();
            let bytes = shape.iter().product::<usize>() * t.element.bytes();
            TensorInfo { name: name.clone(), dtype: t.element.name().into(), shape, bytes }
        };
        self.tensors.iter().map(info).collect()
    }

    /// The numbers of a tensor, row-major, and its shape.
    ///
    /// # Errors
    /// [`Error::Corrupt`] when there is no such tensor, or its shape differs from `shape` (where that is `Some`).
    pub fn floats(&self, name: &str, shape: &[Option<usize>]) -> Result<(Vec<f32>, Vec<usize>)> {
        let at = || format!("tensor `{name}`");
        let Some(t) = self.tensors.get(name) else {
            return Err(Error::corrupt(self.path, at(), "nothing", "it"));
        };
        let found: Vec<usize> = t.shape.iter().map(|&s| s as usize).collect();
        let fits = found.len() == shape.len() && found.iter().zip(shape).all(|(f, s)| s.is_none_or(|s| s == *f));
        if !fits {
            let side = |s: &Option<usize>| s.map_or("any".into(), |s| s.to_string());
            let expected = format!("[{}]", shape.iter().map(side).collect::<Vec<_>>().join(", "));
            return Err(Error::corrupt(self.path, at(), format!("{found:?}"), expected));
        }
        let count: usize = found.iter().product();
        check_memory(self.path, name, 4 * count as u128, self.bytes.len() as u64)?;
        let array = self.arrays.get(&t.key).map_or(&[][..], |range| &self.bytes[range.clone()]);
        let size = t.element.bytes();
        let mut values = Vec::with_capacity(count);
        let mut index = vec![0u64; found.len()];
        for _ in 0..count {
            let place = index.iter().zip(&t.stride).map(|(i, s)| i * s).sum::<u64>() + t.offset;
            values.push(t.element.read(&array[place as usize * size..]) as f32);
            for (i, &side) in index.iter_mut().zip(&t.shape).rev() {
                *i += 1;
                if *i < side {
                    break;
                }
                *i = 0;
            }
        }
        Ok((values, found))
    }
}

/// The tensors of nested dictionaries and lists, by name.
fn named(parsed: &Parsed, path: &Path) -> Result<BTreeMap<String, Tensor>> {
    let mut found = BTreeMap::new();
    let mut open: Vec<(String, Id, usize)> = vec![(String::new(), parsed.root, 0)];
    let mut visits = 0;
    while let Some((name, id, depth)) = open.pop() {
        visits += 1;
        if visits > MAX_VISITS || depth > MAX_DEPTH {
            let expected = format!("at most {MAX_DEPTH} levels and {MAX_VISITS} values");
            return Err(Error::corrupt(path, "data.pkl", "deeper or more values", expected));
        }
        let join = |part: &str| if name.is_empty() { part.to_owned() } else { format!("{name}.{part}") };
        match &parsed.values[id] {
            Value::Tensor(t) => {
                let name = if name.is_empty() { "tensor".to_owned() } else { name };
                found.insert(name, t.clone());
            }
            Value::List(items) | Value::Tuple(items) => {
                open.extend(items.iter().enumerate().map(|(i, &item)| (join(&i.to_string()), item, depth + 1)));
            }
            Value::Dict(entries) => {
                for (key, value) in entries {
                    if let Value::Text(key) = &parsed.values[*key] {
                        open.push((join(key), *value, depth + 1));
                    }
                }
            }
            _ => {}
        }
    }
    Ok(found)
}
