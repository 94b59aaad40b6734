//! Evidence in a file of its own, beside the model that it is about.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;

use sha2::{Digest as _, Sha256};

use super::Evidence;
use crate::error::{Error, Result};
use crate::file::tensors::{self, NamedTensor, StoredTensor};
use crate::scene::Scene;

const FORMAT: [&str; 2] = ["spgs-confidence", "1"];
/// Metadata entry that says which Gaussians it is about.
const MODEL: &str = "gaussians";

impl Evidence {
    /// Writes a safetensors file: `visibility` `[N]`, `error` `[N]`, `background` `[2]`, all F64, and a checksum of the
    /// scene's positions and opacities.
    ///
    /// # Errors
    /// `Usage` for evidence of another number of Gaussians; [`Error::Io`].
    pub fn write(&self, path: &Path, scene: &Scene) -> Result<()> {
        self.check(scene)?;
        let floats = |name: &'static str, values: &[f64]| NamedTensor {
            name: name.into(),
            dtype: "F64",
            shape: vec![values.len()],
            bytes: Cow::Owned(values.iter().flat_map(|v| v.to_le_bytes()).collect()),
        };
        let all = vec![
            floats("visibility", &self.visibility),
            floats("error", &self.error),
            floats("background", &self.background),
        ];
        tensors::write(path, FORMAT, all, &BTreeMap::from([(MODEL.into(), checksum(scene))]))
    }

    /// Reads what [`Evidence::write`] wrote about this scene.
    ///
    /// # Errors
    /// [`Error::Corrupt`] for another file, for one about other Gaussians, and for values that are not sums; [`Error::Io`].
    pub fn read(path: &Path, scene: &Scene) -> Result<Self> {
        let (all, metadata) = tensors::read(path, FORMAT)?;
        if metadata.get(MODEL) != Some(&checksum(scene)) {
            let at = format!("metadata entry `{MODEL}`");
            return Err(Error::corrupt(path, at, "the confidence of another model", "that of this model"));
        }
        let n = scene.gaussians.len();
        let read = |name: &str, length: usize| sums(path, name, all.get(name), length);
        let background = read("background", 2)?;
        let background = [background[0], background[1]];
        Ok(Self { visibility: read("visibility", n)?, error: read("error", n)?, background })
    }
}

fn sums(path: &Path, name: &str, tensor: Option<&StoredTensor>, length: usize) -> Result<Vec<f64>> {
    let wrong = |found: String, expected: String| Error::corrupt(path, format!("tensor `{name}`"), found, expected);
    let expected = format!("F64 [{length}]");
    let tensor = tensor.ok_or_else(|| wrong("nothing".into(), expected.clone()))?;
    if tensor.dtype != "F64" || tensor.shape != [length] {
        return Err(wrong(format!("{} {:?}", tensor.dtype, tensor.shape), expected));
    }
    let values: Vec<f64> = tensor.bytes.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect();
    match values.iter().find(|v| !(v.is_finite() && **v >= 0.0)) {
        Some(value) => Err(wrong(value.to_string(), "finite values from 0 on".into())),
        None => Ok(values),
    }
}

/// What makes two sets of Gaussians the same for sums over them: where they are at rest and how opaque.
fn checksum(scene: &Scene) -> String {
    let g = &scene.gaussians;
    let mut sum = Sha256::new();
    g.mean.iter().flatten().chain(&g.opacity_logit).for_each(|v| sum.update(v.to_le_bytes()));
    sum.finalize().iter().map(|b| format!("{b:02x}")).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::scene::synthetic::random_scene;

    fn evidence(n: usize) -> Evidence {
        let visibility: Vec<f64> = (0..n).map(|i| i as f64 / 3.0).collect();
        Evidence { error: visibility.iter().map(|v| v * 0.1).collect(), visibility, background: [7.0, 0.5] }
    }

    #[test]
    fn what_is_written_is_read_for_the_same_model_only() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.safetensors");
        let scene = random_scene(9, 1, 0);
        evidence(9).write(&path, &scene).unwrap();
        assert_eq!(Evidence::read(&path, &scene).unwrap(), evidence(9));
        let error = Evidence::read(&path, &random_scene(9, 1, 1)).unwrap_err();
        assert!(error.to_string().contains("another model"), "{error}");
        assert_eq!(evidence(8).write(&path, &scene).unwrap_err().exit_code(), 2);
    }

    #[test]
    fn values_that_are_no_sums_are_rejected_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.safetensors");
        let scene = random_scene(3, 1, 0);
        for bad in [-1.0, f64::NAN, f64::INFINITY] {
            let mut e = evidence(3);
            e.error[1] = bad;
            e.write(&path, &scene).unwrap();
            let error = Evidence::read(&path, &scene).unwrap_err();
            assert!(error.to_string().contains("`error`"), "{error}");
        }
        std::fs::write(&path, b"text").unwrap();
        assert_eq!(Evidence::read(&path, &scene).unwrap_err().exit_code(), 3);
    }
}
