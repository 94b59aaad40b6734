//! The file: inputs at once, results by name.

use std::fs::File;
use std::path::{Path, PathBuf};

use engine::scene::{DeformNetwork, Scene, SuperpointDeformation};
use engine::{Error, Result};
use glam::{DMat3, DVec3};
use npyz::TypeChar;
use zip::ZipArchive;

use crate::dev::oracle::case::load_superpoint;

/// An array dimension beyond this is taken for damage.
const MAX_DIMENSION: u64 = 1 << 22;

/// Numbers of an array in C order.
pub(super) struct Array {
    pub(super) values: Vec<f64>,
    /// The file has it in f32.
    pub(super) single: bool,
}

/// Inputs of a file.
pub(super) struct Case {
    path: PathBuf,
    archive: ZipArchive<File>,
    pub(super) scene: Scene,
    pub(super) network: DeformNetwork,
    pub(super) time: f64,
    pub(super) of_gaussian: Vec<u32>,
    pub(super) position: Vec<[f32; 3]>,
    /// K.
    pub(super) neighbors: usize,
    pub(super) neighbor: Vec<u32>,
    pub(super) logit: Vec<f32>,
    pub(super) d_mean: Vec<DVec3>,
    pub(super) d_rotation: Vec<DMat3>,
}

impl Case {
    pub(super) fn load(path: &Path) -> Result<Self> {
        let known = load_superpoint(path)?;
        let file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
        let archive =
            ZipArchive::new(file).map_err(|e| Error::corrupt(path, "zip directory", e.to_string(), "an .npz file"))?;
        let (network, superpoints) = match known.scene.deformation.superpoint_deformation().cloned() {
            Some(SuperpointDeformation { network: Some(network), superpoints, .. }) => (network, superpoints),
            _ => return Err(Error::corrupt(path, "arrays", "no network F", "network F and superpoints")),
        };
        let mut case = Self {
            path: path.into(),
            archive,
            scene: known.scene,
            network,
            time: known.time,
            of_gaussian: superpoints.of_gaussian,
            position: superpoints.position,
            neighbors: 0,
            neighbor: Vec::new(),
            logit: Vec::new(),
            d_mean: Vec::new(),
            d_rotation: Vec::new(),
        };
        let (n, m) = (case.of_gaussian.len(), case.position.len());
        case.logit = case.array("logit")?.values.iter().map(|x| *x as f32).collect();
        case.neighbors = case.logit.len() / n.max(1);
        case.neighbor = case.array("neighbor")?.values.iter().map(|x| *x as u32).collect();
        case.d_mean = case.array("d_mean_t")?.values.as_chunks::<3>().0.iter().map(|v| DVec3::from_array(*v)).collect();
        // Row-major in the file.
        let matrix = |v: &[f64; 9]| DMat3::from_cols_array(v).transpose();
        case.d_rotation = case.array("d_rotation_t")?.values.as_chunks::<9>().0.iter().map(matrix).collect();
        let shapes = [case.logit.len() / case.neighbors.max(1), case.d_mean.len(), case.d_rotation.len()];
        let in_range = case.neighbor.iter().all(|j| (*j as usize) < m);
        if case.neighbors == 0 || shapes != [n; 3] || case.neighbor.len() != case.logit.len() || !in_range {
            let found = format!("{shapes:?} rows, {} neighbours", case.neighbor.len());
            return Err(Error::corrupt(path, "neighbor", found, format!("{n} rows of neighbours below {m}")));
        }
        Ok(case)
    }

    /// Reads an array by name: f64, f32 or i64.
    pub(super) fn array(&mut self, name: &str) -> Result<Array> {
        let path = &self.path;
        let broken = |e: std::io::Error| Error::corrupt(path, name, e.to_string(), "a readable array");
        let entry = self.archive.by_name(&format!("{name}.npy")).map_err(|e| broken(e.into()))?;
        let npy = npyz::NpyFile::new(entry).map_err(broken)?;
        let shape = npy.shape().to_vec();
        if npy.order() != npyz::Order::C || shape.iter().any(|s| *s > MAX_DIMENSION) {
            let found = format!("shape {shape:?}, {:?} order", npy.order());
            return Err(Error::corrupt(path, name, found, "C order"));
        }
        let npyz::DType::Plain(kind) = npy.dtype() else {
            return Err(Error::corrupt(path, name, "a record array", "numbers"));
        };
        let values = match (kind.type_char(), kind.size_field()) {
            (TypeChar::Float, 8) => npy.into_vec::<f64>().map_err(broken)?,
            (TypeChar::Float, 4) => {
                let values = npy.into_vec::<f32>().map_err(broken)?.into_iter().map(f64::from).collect();
                return Ok(Array { values, single: true });
            }
            (TypeChar::Int, 8) => npy.into_vec::<i64>().map_err(broken)?.into_iter().map(|x| x as f64).collect(),
            _ => return Err(Error::corrupt(path, name, format!("dtype {kind}"), "float64, float32 or int64")),
        };
        Ok(Array { values, single: false })
    }
}
