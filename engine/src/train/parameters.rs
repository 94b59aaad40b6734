//! The Gaussians under training: the renderer's own buffers, updated in place, with Adam's moments and the statistics of
//! density control.

use glam::DVec3;

use crate::error::{Error, Result};
use crate::gpu::{Buffer, Gpu};
use crate::render::deformation::DeformationBuffers;
use crate::render::quality::Storage;
use crate::render::scene_buffers::{SceneBuffers, optional_buffer};
use crate::scene::parameter::{LOG_SCALE, OPACITY_LOGIT, PARAMETERS, Parameter, REQUIRED, SMOOTHING, planes};
use crate::scene::{Gaussians, Rejected};
use crate::train::density::{OpacityRows, SmoothingRows};

/// Gaussians on the device.
#[derive(Debug)]
pub(crate) struct Parameters {
    /// What the forward pass reads; `sh_degree` is the degree in use.
    pub(crate) scene: SceneBuffers,
    /// SH degree that the buffers hold.
    pub(crate) sh_degree: u32,
    /// First moments, `[P,N]`.
    pub(crate) moment_1: Buffer,
    /// Second moments, `[P,N]`.
    pub(crate) moment_2: Buffer,
    /// Σ of screen-gradient norms, visible count, `[2,N]`.
    pub(crate) density: Buffer,
    /// Largest radius on screen, px, `[N]`.
    pub(crate) max_radius: Buffer,
}

/// What the device holds, on the host.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ParameterState {
    /// The Gaussians, at the allocated SH degree.
    pub gaussians: Gaussians,
    /// First moments, `[P,N]`.
    pub moment_1: Vec<f32>,
    /// Second moments, `[P,N]`.
    pub moment_2: Vec<f32>,
    /// Density statistics, `[2,N]`.
    pub density: Vec<f32>,
    /// Largest radius on screen, px, `[N]`.
    pub max_radius: Vec<f32>,
    /// Superpoint of each Gaussian, `[N]`; 0 while there are none.
    pub superpoint_of_gaussian: Vec<u32>,
}

impl ParameterState {
    /// Gaussians without a history. SH coefficients are padded or cut to `sh_degree`.
    pub fn new(gaussians: &Gaussians, sh_degree: u32) -> Self {
        let n = gaussians.len();
        let planes = n * planes(sh_degree, gaussians.optional.present()) as usize;
        Self {
            gaussians: with_sh_degree(gaussians, sh_degree),
            moment_1: vec![0.0; planes],
            moment_2: vec![0.0; planes],
            density: vec![0.0; 2 * n],
            max_radius: vec![0.0; n],
            superpoint_of_gaussian: vec![0; n],
        }
    }
}

/// The same Gaussians with SH coefficients up to `sh_degree`: zeros are added, or the rest is left out.
pub fn with_sh_degree(g: &Gaussians, sh_degree: u32) -> Gaussians {
    let (from, to) = (g.sh_coefficients() * 3, ((sh_degree + 1) * (sh_degree + 1) * 3) as usize);
    let row = |i: usize| (0..to).map(move |k| if k < from { g.sh[i * from + k] } else { 0.0 });
    Gaussians { sh_degree, sh: (0..g.len()).flat_map(row).collect(), ..g.clone() }
}

impl Parameters {
    /// Uploads a state.
    ///
    /// # Errors
    /// `Usage` when lengths differ; `OutOfMemory`.
    pub(crate) fn upload(gpu: &Gpu, s: &ParameterState) -> Result<Self> {
        let g = &s.gaussians;
        let (n, p) = (g.len(), planes(g.sh_degree, g.optional.present()) as usize);
        for (name, found, expected) in [
            ("moment_1", s.moment_1.len(), n * p),
            ("moment_2", s.moment_2.len(), n * p),
            ("density", s.density.len(), 2 * n),
            ("max_radius", s.max_radius.len(), n),
            ("superpoint_of_gaussian", s.superpoint_of_gaussian.len(), n),
        ] {
            if found != expected {
                return Err(Error::usage(name, format!("{found} values"), format!("{expected}")));
            }
        }
        let floats = |name: &str, data: &[f32]| gpu.buffer_with(name, bytemuck::cast_slice(data));
        let parameter = |(i, p): (usize, &Parameter)| floats(p.name, &g.on_device(i));
        let scene = SceneBuffers {
            gaussians: n as u32,
            sh_degree: g.sh_degree,
            origin: DVec3::ZERO,
            deformation: DeformationBuffers::at_rest(gpu, &s.superpoint_of_gaussian)?,
            sh_storage: Storage::F32,
            rejected: Rejected::default(),
            parameter: PARAMETERS.iter().enumerate().take(REQUIRED).map(parameter).collect::<Result<_>>()?,
            present: g.optional.present(),
            antialiased: g.antialiased,
            optional: optional_buffer(gpu, &g.optional)?,
        };
        Ok(Self {
            scene,
            sh_degree: g.sh_degree,
            moment_1: floats("moment_1", &s.moment_1)?,
            moment_2: floats("moment_2", &s.moment_2)?,
            density: floats("density", &s.density)?,
            max_radius: floats("max_radius", &s.max_radius)?,
        })
    }

    /// P: numbers of a Gaussian.
    pub(crate) fn planes(&self) -> u32 {
        planes(self.sh_degree, self.scene.present)
    }

    /// N.
    pub(crate) fn count(&self) -> u32 {
        self.scene.gaussians
    }

    /// What an opacity reset changes and reads.
    pub(crate) fn opacity_rows(&self) -> OpacityRows<'_> {
        let scene = &self.scene;
        let smoothing =
            scene.optional.as_ref().filter(|_| scene.present.has(SMOOTHING)).map(|optional| SmoothingRows {
                log_scale: &scene.parameter[LOG_SCALE],
                optional,
                plane: scene.present.planes_before(SMOOTHING),
            });
        OpacityRows {
            gaussians: self.count(),
            opacity_logit: &scene.parameter[OPACITY_LOGIT],
            moments: [&self.moment_1, &self.moment_2],
            smoothing,
        }
    }

    /// Downloads everything.
    pub(crate) fn download(&self, gpu: &Gpu) -> Result<ParameterState> {
        let n = self.count() as usize;
        let p = self.planes() as usize;
        Ok(ParameterState {
            gaussians: self.download_gaussians(gpu)?,
            moment_1: words(gpu, &self.moment_1, n * p)?,
            moment_2: words(gpu, &self.moment_2, n * p)?,
            density: words(gpu, &self.density, 2 * n)?,
            max_radius: words(gpu, &self.max_radius, n)?,
            superpoint_of_gaussian: words(gpu, &self.scene.deformation.superpoint_of_gaussian, n)?,
        })
    }

    /// Downloads the Gaussians.
    pub(crate) fn download_gaussians(&self, gpu: &Gpu) -> Result<Gaussians> {
        let (n, s) = (self.count() as usize, &self.scene);
        let optional = match &s.optional {
            Some(buffer) => words::<f32>(gpu, buffer, n * s.present.planes() as usize)?,
            None => Vec::new(),
        };
        let made = Gaussians::from_parameters(self.sh_degree, s.present, |i| {
            let (p, count) = (&PARAMETERS[i], n * PARAMETERS[i].width as usize);
            let first = n * s.present.planes_before(i) as usize;
            let words = match s.parameter.get(i) {
                Some(buffer) => words(gpu, buffer, count)?,
                None => optional.get(first..first + count).unwrap_or_default().to_vec(),
            };
            Ok::<_, Error>(p.from_device(words))
        })?;
        Ok(Gaussians { antialiased: s.antialiased, ..made })
    }
}

/// The first `count` words of a buffer.
pub(crate) fn words<T: bytemuck::AnyBitPattern>(gpu: &Gpu, buffer: &Buffer, count: usize) -> Result<Vec<T>> {
    if count == 0 {
        return Ok(Vec::new());
    }
    let bytes = gpu.download(buffer.slice(0, 4 * count as u64))?;
    Ok(bytes.chunks_exact(4).map(bytemuck::pod_read_unaligned).collect())
}
