//! Truth from outside: float64 inputs and results of independent implementations, in NumPy `.npz` files.
//!
//! An image file holds the inputs `means` `[N,3]`, `quats` `[N,4]` (w,x,y,z), `log_scales` `[N,3]`, `logit_opac` `[N]`, `sh`
//! `[N,K,3]`, `viewmat` `[4,4]` (world to camera), `K` `[3,3]` (intrinsics), `bg` `[3]`, `width`, `height`, `sh_degree`,
//! and the float64 `image` `[H,W,3]`; the near plane is at 0.01. With `dL` `[H,W,3]` it also holds the gradients of
//! Σ image·dL: `grad_means`, `grad_quats`, `grad_log_scales`, `grad_logit_opac`, `grad_sh` and `grad_means2d` (px). A superpoint file holds network F, superpoints, Gaussians
//! and a time, and the poses and moved Gaussians at that time.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use engine::gpu::Gpu;
use engine::image::{Difference, difference};
use engine::reference::gradient::image::image_gradients;
use engine::reference::gradient::splats::Upstream;
use engine::reference::{
    DeformationAt, Gaussians64, Parameters, Pose, ReferenceOptions, network_poses, place, render_gaussians,
};
use engine::scene::network::DeformSize;
use engine::scene::parameter::Optional;
use engine::scene::{
    Camera, DeformNetwork, Gaussians, Linear, MotionSource, Scene, SuperpointDeformation, Superpoints,
};
use engine::train::gradient::{GradientOptions, scene_gradients};
use engine::{Error, Result};
use glam::{DMat3, DMat4, DVec3};
use npyz::{Order, TypeChar};
use serde::Serialize;
use zip::ZipArchive;

/// Near plane of the image files, world units.
pub const NEAR: f64 = 0.01;
/// An array dimension beyond this is taken for damage.
const MAX_DIMENSION: u64 = 1 << 22;

/// One image file.
#[derive(Debug, Clone, PartialEq)]
pub struct OracleCase {
    /// The file.
    pub path: PathBuf,
    /// Inputs.
    pub gaussians: Gaussians64,
    /// Inputs.
    pub camera: Camera,
    /// Colour behind everything.
    pub background: [f64; 3],
    /// `[height, width, 3]` the true image.
    pub image: Vec<f64>,
    /// The true gradients, when the file has them.
    pub gradients: Option<ImageGradients>,
}

/// Gradients of Σ image·`upstream`, flat arrays.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ImageGradients {
    /// `[height, width, 3]`.
    pub upstream: Vec<f64>,
    /// `[N,3]`.
    pub mean: Vec<f64>,
    /// `[N,4]` of the raw quaternion w,x,y,z.
    pub rotation: Vec<f64>,
    /// `[N,3]`.
    pub log_scale: Vec<f64>,
    /// `[N]`.
    pub opacity_logit: Vec<f64>,
    /// `[N,K,3]`.
    pub sh: Vec<f64>,
    /// `[N,2]` of the projected centre, px.
    pub mean2d: Vec<f64>,
}

/// ‖test − truth‖ / ‖truth‖ of one array, of both implementations.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GradientError {
    /// The f64 reference.
    pub reference: f64,
    /// The kernels.
    pub gpu: f64,
}

/// [`GradientError`] of each array.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GradientErrors {
    /// Centres.
    pub mean: GradientError,
    /// Raw quaternions.
    pub rotation: GradientError,
    /// Log of the standard deviations.
    pub log_scale: GradientError,
    /// Opacities before the sigmoid.
    pub opacity_logit: GradientError,
    /// SH coefficients.
    pub sh: GradientError,
    /// Projected centres.
    pub mean2d: GradientError,
}

impl GradientErrors {
    /// By name.
    pub fn rows(&self) -> [(&'static str, GradientError); 6] {
        [
            ("mean", self.mean),
            ("rotation", self.rotation),
            ("log_scale", self.log_scale),
            ("opacity_logit", self.opacity_logit),
            ("sh", self.sh),
            ("mean2d", self.mean2d),
        ]
    }
}

/// One superpoint file: f32 inputs, f64 results.
#[derive(Debug, Clone, PartialEq)]
pub struct SuperpointCase {
    /// The file.
    pub path: PathBuf,
    /// Mean and rotation of the Gaussians (other parameters are zero), superpoints and network F.
    pub scene: Scene,
    /// Time at which the results hold.
    pub time: f64,
    /// `[M,3]` result of F, so(3) vectors.
    pub pose_rotation: Vec<f64>,
    /// `[M,3]` result of F.
    pub pose_translation: Vec<f64>,
    /// `[N,3]` moved centres.
    pub mean: Vec<f64>,
    /// `[N,3,3]` moved rotations, row-major.
    pub rotation: Vec<f64>,
}

/// ‖test − truth‖ / ‖truth‖ of each output.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SuperpointDifference {
    /// Rotation vectors of F.
    pub pose_rotation: f64,
    /// Translations of F.
    pub pose_translation: f64,
    /// Moved centres.
    pub mean: f64,
    /// Moved rotations.
    pub rotation: f64,
}

/// ‖test − truth‖ / ‖truth‖; infinite when the lengths differ.
pub fn relative_l2(truth: &[f64], test: &[f64]) -> f64 {
    if truth.len() != test.len() {
        return f64::INFINITY;
    }
    let norm = truth.iter().map(|x| x * x).sum::<f64>().sqrt();
    let error = truth.iter().zip(test).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt();
    error / norm.max(f64::MIN_POSITIVE)
}

/// Whether the file is a superpoint file (it has `superpoint_position`) and not an image file.
pub fn is_superpoint_file(path: &Path) -> Result<bool> {
    Ok(Archive::open(path)?.has("superpoint_position"))
}

/// Whether the file is an image file: Gaussians, camera and image.
pub fn is_image_file(path: &Path) -> Result<bool> {
    let file = Archive::open(path)?;
    Ok(["means", "viewmat", "image"].iter().all(|name| file.has(name)))
}

/// Reads an image file.
pub fn load(path: &Path) -> Result<OracleCase> {
    let mut file = Archive::open(path)?;
    let (width, height) = (file.size("width")?, file.size("height")?);
    let sh_degree = file.size("sh_degree")?;
    if sh_degree > 3 {
        return Err(Error::corrupt(path, "sh_degree", sh_degree.to_string(), "0 to 3"));
    }
    let mean: Vec<[f64; 3]> = rows(&file.floats("means", &[None, Some(3)])?);
    let n = Some(mean.len());
    let sh_count = ((sh_degree + 1) * (sh_degree + 1)) as usize;
    let gaussians = Gaussians64 {
        log_scale: rows(&file.floats("log_scales", &[n, Some(3)])?),
        rotation: rows(&file.floats("quats", &[n, Some(4)])?),
        opacity_logit: file.floats("logit_opac", &[n])?,
        sh_degree,
        sh: file.floats("sh", &[n, Some(sh_count), Some(3)])?,
        optional: Optional::default(),
        antialiased: false,
        mean,
    };
    let view = file.floats("viewmat", &[Some(4), Some(4)])?;
    let view: [f64; 16] = std::array::from_fn(|i| view[i]);
    let k = file.floats("K", &[Some(3), Some(3)])?;
    let matrix = DMat4::from_cols_array(&view).transpose();
    let background = file.floats("bg", &[Some(3)])?;
    let gradients = match file.has("dL") {
        true => Some(ImageGradients {
            upstream: file.floats("dL", &[Some(height as usize), Some(width as usize), Some(3)])?,
            mean: file.floats("grad_means", &[n, Some(3)])?,
            rotation: file.floats("grad_quats", &[n, Some(4)])?,
            log_scale: file.floats("grad_log_scales", &[n, Some(3)])?,
            opacity_logit: file.floats("grad_logit_opac", &[n])?,
            sh: file.floats("grad_sh", &[n, Some(sh_count), Some(3)])?,
            mean2d: file.floats("grad_means2d", &[n, Some(2)])?,
        }),
        false => None,
    };
    Ok(OracleCase {
        gradients,
        camera: Camera::from_world_to_camera(matrix, [k[0], k[4], k[2], k[5]], [width, height]),
        background: [background[0], background[1], background[2]],
        image: file.floats("image", &[Some(height as usize), Some(width as usize), Some(3)])?,
        gaussians,
        path: path.into(),
    })
}

/// The f64 reference's image against the file's.
pub fn reference_difference(case: &OracleCase) -> Result<Difference> {
    let options = ReferenceOptions { near: NEAR, background: case.background, motion: MotionSource::Auto };
    let image = render_gaussians(&case.gaussians, &case.camera, &options)?;
    Ok(difference(case.image.iter().copied(), image.rgb))
}

/// Gradients of the f64 reference and of the kernels on `gpu` against the file's; `None` when it has none.
pub fn gradient_errors(gpu: &Gpu, case: &OracleCase) -> Result<Option<GradientErrors>> {
    let Some(truth) = &case.gradients else { return Ok(None) };
    let options = ReferenceOptions { near: NEAR, background: case.background, motion: MotionSource::Auto };
    let upstream = Upstream { color: &truth.upstream, alpha: None };
    let exact = image_gradients(&case.gaussians, &DeformationAt::default(), &case.camera, &options, &upstream)?;
    let (scene, camera, background, near) = as_scene(case);
    let pixels: Vec<f32> =
        truth.upstream.chunks_exact(3).flat_map(|g| [g[0] as f32, g[1] as f32, g[2] as f32, 0.0]).collect();
    let found = scene_gradients(gpu, &scene, &camera, 0.0, &GradientOptions { near, background }, &pixels)?;
    let error = |truth: &[f64], reference: &[f64], gpu: &[f32]| GradientError {
        reference: relative_l2(truth, reference),
        gpu: relative_l2(truth, &gpu.iter().map(|&x| f64::from(x)).collect::<Vec<f64>>()),
    };
    Ok(Some(GradientErrors {
        mean: error(&truth.mean, exact.mean.as_flattened(), found.mean.as_flattened()),
        rotation: error(&truth.rotation, exact.rotation.as_flattened(), found.rotation.as_flattened()),
        log_scale: error(&truth.log_scale, exact.log_scale.as_flattened(), found.log_scale.as_flattened()),
        opacity_logit: error(&truth.opacity_logit, &exact.opacity_logit, &found.opacity_logit),
        sh: error(&truth.sh, &exact.sh, &found.sh),
        mean2d: error(&truth.mean2d, exact.mean2d.as_flattened(), found.mean2d.as_flattened()),
    }))
}

/// The case for a renderer with f32 parameters: scene, camera, background, near plane.
pub fn as_scene(case: &OracleCase) -> (Scene, Camera, [f32; 3], f32) {
    let scene = Scene { gaussians: case.gaussians.to_f32(), ..Scene::default() };
    (scene, case.camera.clone(), case.background.map(|c| c as f32), NEAR as f32)
}

/// Reads a superpoint file.
pub fn load_superpoint(path: &Path) -> Result<SuperpointCase> {
    let mut file = Archive::open(path)?;
    let mean = rows(&file.singles("mean", &[None, Some(3)])?);
    let position = rows(&file.singles("superpoint_position", &[None, Some(3)])?);
    let (n, m) = (Some(mean.len()), Some(position.len()));
    let groups = file.integers("of_gaussian", &[n])?;
    let in_range = |&g: &i64| u32::try_from(g).ok().filter(|&g| (g as usize) < position.len());
    let Some(of_gaussian) = groups.iter().map(in_range).collect::<Option<Vec<u32>>>() else {
        return Err(Error::corrupt(path, "of_gaussian", "an index out of range", format!("0 to {}", position.len())));
    };
    let gaussians = Gaussians {
        log_scale: vec![[0.0; 3]; mean.len()],
        rotation: rows(&file.singles("rotation_wxyz", &[n, Some(4)])?),
        opacity_logit: vec![0.0; mean.len()],
        sh_degree: 0,
        sh: vec![0.0; 3 * mean.len()],
        mean,
        ..Gaussians::default()
    };
    let deformation = SuperpointDeformation {
        superpoints: Superpoints { of_gaussian, position },
        network: Some(file.network()?),
        ..SuperpointDeformation::default()
    };
    let scene = Scene { gaussians, deformation: deformation.into(), ..Scene::default() };
    Ok(SuperpointCase {
        path: path.into(),
        scene,
        time: file.floats("time", &[Some(1)])?[0],
        pose_rotation: file.floats("out_rotation", &[m, Some(3)])?,
        pose_translation: file.floats("out_translation", &[m, Some(3)])?,
        mean: file.floats("out_mean_t", &[n, Some(3)])?,
        rotation: file.floats("out_rotation_t", &[n, Some(3), Some(3)])?,
    })
}

/// F and motion of the f64 reference against the file's results.
pub fn superpoint_difference(case: &SuperpointCase) -> Result<SuperpointDifference> {
    let superpoints = case.scene.deformation.superpoints();
    let poses = match (case.scene.deformation.network(), superpoints) {
        (Some(network), Some(superpoints)) => network_poses(network, &superpoints.position, case.time),
        _ => Vec::new(),
    };
    let parameters = Parameters::from(&case.scene.gaussians);
    let placed = place(&parameters, superpoints, Some(&poses))?;
    let flat = |vectors: &mut dyn Iterator<Item = DVec3>| vectors.flat_map(|v| v.to_array()).collect::<Vec<f64>>();
    let pose = |part: fn(&Pose) -> DVec3| flat(&mut poses.iter().map(part));
    let row_major = |m: &DMat3| m.transpose().to_cols_array();
    Ok(SuperpointDifference {
        pose_rotation: relative_l2(&case.pose_rotation, &pose(|p| p.rotation)),
        pose_translation: relative_l2(&case.pose_translation, &pose(|p| p.translation)),
        mean: relative_l2(&case.mean, &flat(&mut placed.mean.iter().copied())),
        rotation: relative_l2(&case.rotation, &placed.rotation.iter().flat_map(row_major).collect::<Vec<f64>>()),
    })
}

fn rows<T: Copy, const W: usize>(values: &[T]) -> Vec<[T; W]> {
    values.as_chunks::<W>().0.to_vec()
}

/// An open `.npz` file; every problem becomes [`Error::Corrupt`] at the array's name.
struct Archive<'a> {
    path: &'a Path,
    archive: ZipArchive<BufReader<File>>,
}

/// An array in C order, by element kind.
enum Array {
    Floats(Vec<f64>),
    Integers(Vec<i64>),
}

impl<'a> Archive<'a> {
    fn open(path: &'a Path) -> Result<Self> {
        let file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
        match ZipArchive::new(BufReader::new(file)) {
            Ok(archive) => Ok(Self { path, archive }),
            Err(e) => Err(Error::corrupt(path, "zip directory", e.to_string(), "an .npz file")),
        }
    }

    fn has(&self, name: &str) -> bool {
        self.archive.index_for_name(&format!("{name}.npy")).is_some()
    }

    /// Reads array `name` with the given shape (`None`: any length).
    fn array(&mut self, name: &str, shape: &[Option<usize>]) -> Result<Array> {
        let path = self.path;
        let broken = |e: std::io::Error| Error::corrupt(path, name, e.to_string(), "a readable array");
        let entry = match self.archive.by_name(&format!("{name}.npy")) {
            Ok(entry) => entry,
            Err(zip::result::ZipError::FileNotFound) => {
                return Err(Error::corrupt(path, name, "no such array", "an array"));
            }
            Err(e) => return Err(broken(e.into())),
        };
        let npy = npyz::NpyFile::new(entry).map_err(broken)?;
        let found = npy.shape().to_vec();
        let fits = found.len() == shape.len()
            && found.iter().zip(shape).all(|(&f, e)| f <= MAX_DIMENSION && e.is_none_or(|e| e as u64 == f));
        if !fits || npy.order() != Order::C {
            let expected = shape.iter().map(|e| e.map_or("any".into(), |e| e.to_string())).collect::<Vec<_>>();
            let found = format!("shape {found:?}, {:?} order", npy.order());
            return Err(Error::corrupt(path, name, found, format!("shape [{}], C order", expected.join(", "))));
        }
        let npyz::DType::Plain(kind) = npy.dtype() else {
            return Err(Error::corrupt(path, name, "a record array", "numbers"));
        };
        let widen = |v: Vec<f32>| v.into_iter().map(f64::from).collect();
        match (kind.type_char(), kind.size_field()) {
            (TypeChar::Float, 8) => npy.into_vec().map(Array::Floats).map_err(broken),
            (TypeChar::Float, 4) => npy.into_vec().map(widen).map(Array::Floats).map_err(broken),
            (TypeChar::Int, 8) => npy.into_vec().map(Array::Integers).map_err(broken),
            _ => Err(Error::corrupt(path, name, format!("dtype {kind}"), "float64, float32 or int64")),
        }
    }

    fn floats(&mut self, name: &str, shape: &[Option<usize>]) -> Result<Vec<f64>> {
        match self.array(name, shape)? {
            Array::Floats(values) => Ok(values),
            Array::Integers(_) => Err(Error::corrupt(self.path, name, "integers", "floats")),
        }
    }

    /// Floats that are f32 in the file, or are rounded to it.
    fn singles(&mut self, name: &str, shape: &[Option<usize>]) -> Result<Vec<f32>> {
        Ok(self.floats(name, shape)?.into_iter().map(|x| x as f32).collect())
    }

    fn integers(&mut self, name: &str, shape: &[Option<usize>]) -> Result<Vec<i64>> {
        match self.array(name, shape)? {
            Array::Integers(values) => Ok(values),
            Array::Floats(_) => Err(Error::corrupt(self.path, name, "floats", "integers")),
        }
    }

    /// A scalar in 0..=16384.
    fn size(&mut self, name: &str) -> Result<u32> {
        let value = self.integers(name, &[])?.first().copied().unwrap_or(-1);
        let size = u32::try_from(value).ok().filter(|&v| v <= 16384);
        size.ok_or_else(|| Error::corrupt(self.path, name, value.to_string(), "0 to 16384"))
    }

    fn network(&mut self) -> Result<DeformNetwork> {
        let size = DeformSize::PAPER;
        let linear = (0..size.layers)
            .map(|i| self.linear(&format!("deform_linear.{i}"), size.layer_inputs(i), size.width))
            .collect::<Result<_>>()?;
        Ok(DeformNetwork {
            linear,
            translation: self.linear("deform_translation", size.width, 3)?,
            rotation: self.linear("deform_rotation", size.width, 3)?,
        })
    }

    fn linear(&mut self, name: &str, inputs: usize, outputs: usize) -> Result<Linear> {
        Ok(Linear {
            inputs,
            outputs,
            weight: self.singles(&format!("{name}.weight"), &[Some(outputs), Some(inputs)])?,
            bias: self.singles(&format!("{name}.bias"), &[Some(outputs)])?,
        })
    }
}
