//! Tensors by name to a [`Scene`].

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use safetensors::tensor::{Dtype, SafeTensors, TensorView};

use super::{ANTIALIASED, FORMAT, VERSION, deformation};
use crate::error::{Error, Result};
use crate::file::tensors::{check_format, own_metadata, parse_header};
use crate::file::{check, checksum};
use crate::scene::{Blend, Gaussians, Linear, Scene, Tensor};

pub(super) fn model(bytes: &[u8], path: &Path) -> Result<(Scene, Vec<String>)> {
    let (data_begin, header) = parse_header(bytes, path)?;
    let empty = HashMap::new();
    let metadata = header.metadata().as_ref().unwrap_or(&empty);
    check_format(metadata, [FORMAT, VERSION], path)?;
    let mut warnings = Vec::new();
    if !checksum::verify(metadata, &header, &bytes[data_begin..], path)? {
        warnings.push(format!("{}: the file has no checksums: damage cannot be detected", path.display()));
    }
    let parsed = SafeTensors::deserialize(bytes)
        .map_err(|e| Error::corrupt(path, "byte 0 (header)", e.to_string(), "a safetensors header"))?;
    let mut tensors = Tensors { map: parsed.tensors().into_iter().collect(), path };
    let mut gaussians = gaussians(&mut tensors)?;
    let deformation = deformation::read(&mut tensors, gaussians.len())?;
    let extra = tensors.rest(&mut warnings)?;
    let mut metadata = own_metadata(metadata);
    gaussians.antialiased = antialiased(metadata.remove(ANTIALIASED).as_deref(), path)?;
    let scene = Scene { gaussians, deformation, extra, metadata };
    check::scene(&scene).map_err(|problem| problem.corrupt(path))?;
    Ok((scene, warnings))
}

fn antialiased(entry: Option<&str>, path: &Path) -> Result<bool> {
    match entry {
        None | Some("false") => Ok(false),
        Some("true") => Ok(true),
        Some(other) => Err(Error::corrupt(
            path,
            format!("metadata entry `{ANTIALIASED}`"),
            format!("`{other}`"),
            "`true` or `false`",
        )),
    }
}

/// The tensors not taken yet.
pub(super) struct Tensors<'a> {
    pub(super) map: BTreeMap<String, TensorView<'a>>,
    pub(super) path: &'a Path,
}

/// A dimension that a tensor must have: `Some` a number, `None` any.
pub(super) type Shape<'a> = &'a [Option<usize>];

impl Tensors<'_> {
    /// Whether the tensors `names` are there; some but not all is an error.
    pub(super) fn group(&self, names: &[&str]) -> Result<bool> {
        let present = names.iter().find(|name| self.map.contains_key(**name));
        let absent = names.iter().find(|name| !self.map.contains_key(**name));
        match (present, absent) {
            (Some(present), Some(absent)) => {
                let expected = format!("it beside `{present}`");
                Err(Error::corrupt(self.path, format!("tensor `{absent}`"), "nothing", expected))
            }
            (present, _) => Ok(present.is_some()),
        }
    }

    pub(super) fn has(&self, name: &str) -> bool {
        self.map.contains_key(name)
    }

    fn take(&mut self, name: &str, dtype: Dtype, shape: Shape<'_>) -> Result<(Vec<usize>, &[u8])> {
        self.take_one_of(name, &[dtype], shape).map(|(_, shape, bytes)| (shape, bytes))
    }

    /// [`Tensors::take`] of a tensor that may have several types.
    fn take_one_of(&mut self, name: &str, dtypes: &[Dtype], shape: Shape<'_>) -> Result<(Dtype, Vec<usize>, &[u8])> {
        let at = || format!("tensor `{name}`");
        let expected = || {
            let sides: Vec<String> = shape.iter().map(|s| s.map_or("any".into(), |n| n.to_string())).collect();
            let types: Vec<String> = dtypes.iter().map(Dtype::to_string).collect();
            format!("{} [{}]", types.join(" or "), sides.join(", "))
        };
        let Some(view) = self.map.remove(name) else {
            return Err(Error::corrupt(self.path, at(), "nothing", expected()));
        };
        let found = view.shape();
        let fits = found.len() == shape.len() && found.iter().zip(shape).all(|(f, s)| s.is_none_or(|s| s == *f));
        if !dtypes.contains(&view.dtype()) || !fits {
            return Err(Error::corrupt(self.path, at(), format!("{} {found:?}", view.dtype()), expected()));
        }
        Ok((view.dtype(), found.to_vec(), view.data()))
    }

    /// Indices of 16 or 32 bits.
    pub(super) fn indices(&mut self, name: &str, shape: Shape<'_>) -> Result<(Vec<usize>, Vec<u32>)> {
        let (dtype, shape, bytes) = self.take_one_of(name, &[Dtype::U16, Dtype::U32], shape)?;
        let short = |b: &[u8]| u16::from_le_bytes(b.first_chunk().copied().unwrap_or_default());
        let values = match dtype {
            Dtype::U16 => bytes.chunks_exact(2).map(|b| short(b).into()).collect(),
            _ => words(bytes).collect(),
        };
        Ok((shape, values))
    }

    /// Weights as floats, or as bytes in units of 1/255.
    pub(super) fn weights(&mut self, name: &str, shape: Shape<'_>) -> Result<(Vec<usize>, Vec<f32>)> {
        let (dtype, shape, bytes) = self.take_one_of(name, &[Dtype::F32, Dtype::U8], shape)?;
        let values = match dtype {
            Dtype::U8 => bytes.iter().map(|&level| Blend::weight_of_level(level)).collect(),
            _ => words(bytes).map(f32::from_bits).collect(),
        };
        Ok((shape, values))
    }

    pub(super) fn f32s(&mut self, name: &str, shape: Shape<'_>) -> Result<(Vec<usize>, Vec<f32>)> {
        let (shape, bytes) = self.take(name, Dtype::F32, shape)?;
        Ok((shape, words(bytes).map(f32::from_bits).collect()))
    }

    pub(super) fn u32s(&mut self, name: &str, shape: Shape<'_>) -> Result<(Vec<usize>, Vec<u32>)> {
        let (shape, bytes) = self.take(name, Dtype::U32, shape)?;
        Ok((shape, words(bytes).collect()))
    }

    pub(super) fn linear(&mut self, name: &str, inputs: usize, outputs: usize) -> Result<Linear> {
        let (_, weight) = self.f32s(&format!("{name}.weight"), &[Some(outputs), Some(inputs)])?;
        let (_, bias) = self.f32s(&format!("{name}.bias"), &[Some(outputs)])?;
        Ok(Linear { inputs, outputs, weight, bias })
    }

    /// Rows of `W` numbers; all dimensions but the last make up the row count.
    pub(super) fn rows<const W: usize>(&mut self, name: &str, outer: Shape<'_>) -> Result<(Vec<usize>, Vec<[f32; W]>)> {
        let shape: Vec<Option<usize>> = outer.iter().copied().chain([Some(W)]).collect();
        let (shape, bytes) = self.take(name, Dtype::F32, &shape)?;
        let row = |bytes: &[u8]| {
            let mut row = [0.0; W];
            row.iter_mut().zip(words(bytes)).for_each(|(v, word)| *v = f32::from_bits(word));
            row
        };
        Ok((shape, bytes.chunks_exact(4 * W).map(row).collect()))
    }

    /// What nobody took: f32 tensors are carried along, others cannot be.
    fn rest(self, warnings: &mut Vec<String>) -> Result<BTreeMap<String, Tensor>> {
        let mut extra = BTreeMap::new();
        for (name, view) in self.map {
            if view.dtype() == Dtype::F32 {
                let data = words(view.data()).map(f32::from_bits).collect();
                extra.insert(name, Tensor { shape: view.shape().to_vec(), data });
            } else if name.starts_with("gaussians.") || deformation::is_reserved(&name) {
                let found = format!("{} {:?}", view.dtype(), view.shape());
                return Err(Error::corrupt(self.path, format!("tensor `{name}`"), found, "F32"));
            } else {
                let (path, dtype) = (self.path.display(), view.dtype());
                warnings.push(format!("{path}: tensor `{name}` ({dtype}) is not of this format and is skipped"));
            }
        }
        Ok(extra)
    }
}

fn words(bytes: &[u8]) -> impl Iterator<Item = u32> {
    bytes.chunks_exact(4).map(|b| u32::from_le_bytes(b.first_chunk().copied().unwrap_or_default()))
}

fn gaussians(tensors: &mut Tensors<'_>) -> Result<Gaussians> {
    let k = match tensors.map.get("gaussians.sh").map(TensorView::shape) {
        Some([_, k, _]) => *k,
        // Says what is wrong with it.
        _ => tensors.f32s("gaussians.sh", &[None, None, Some(3)])?.0[1],
    };
    let Some(sh_degree) = (0..=3).find(|d| (d + 1) * (d + 1) == k) else {
        let expected = "K = 1, 4, 9 or 16 (SH degree 0 to 3)";
        return Err(Error::corrupt(tensors.path, "tensor `gaussians.sh`", format!("K = {k}"), expected));
    };
    Gaussians::from_arrays(sh_degree as u32, |name, shape, required| {
        let name = format!("gaussians.{name}");
        if !required && !tensors.has(&name) { Ok(None) } else { Ok(Some(tensors.f32s(&name, shape)?.1)) }
    })
}
