//! A scene on the device: the model's arrays, plane by plane, and what moves it.

use std::borrow::Cow;

use glam::DVec3;

use crate::error::{Error, Result};
use crate::gpu::{Buffer, Gpu, Slice, Suite};
use crate::scene::parameter::{MEAN, Optional, PARAMETERS, Parameter, Present, REQUIRED, SH_0, in_degree};
use crate::scene::{Camera, Gaussians, MotionSource, Rejected, Scene};

use super::deformation::{self, DeformationBuffers};
use super::frame::{Frame, FrameOptions};
use super::mean_storage;
use super::quality::{Quality, Storage};
use super::sh_storage;

/// A scene is moved to the origin when its centre is farther away than this many times its extent: poses then keep their
/// precision, because |Exp(r)μ + τ| no longer cancels.
const RECENTRE_RATIO: f64 = 64.0;

/// The model's arrays on the device.
#[derive(Debug)]
pub(crate) struct SceneBuffers {
    pub(crate) gaussians: u32,
    pub(crate) sh_degree: u32,
    /// World position of the coordinates' origin.
    pub(crate) origin: DVec3,
    /// What moves it.
    pub(crate) deformation: DeformationBuffers,
    /// Storage of the SH bands.
    pub(crate) sh_storage: Storage,
    pub(crate) rejected: Rejected,
    /// One for each of the required [`PARAMETERS`]; small where the scene lacks an SH band.
    pub(crate) parameter: Vec<Buffer>,
    /// Optional parameters that the scene has.
    pub(crate) present: Present,
    /// [`Gaussians::antialiased`].
    pub(crate) antialiased: bool,
    /// Their planes, `[planes][N]`, one parameter after another.
    pub(crate) optional: Option<Buffer>,
}

impl SceneBuffers {
    pub(crate) fn new(gpu: &Gpu, scene: &Scene, source: MotionSource, quality: &Quality) -> Result<Self> {
        let g = &scene.gaussians;
        check_lengths(g)?;
        let source = scene.deformation.motion_source(source)?;
        scene.deformation.check_shapes(g.len())?;
        if quality.changes_kernels() {
            gpu.ready_for(Suite::Packed)?;
        }
        deformation::prove_device(gpu, scene, source, quality)?;
        let mut rejected = Rejected::default();
        let valid: Vec<bool> = (0..g.len()).map(|i| g.is_valid(i, &mut rejected)).collect();
        let origin = if source.is_some() { far_origin(g, &valid) } else { DVec3::ZERO };
        let mean: Vec<[f32; 3]> = g
            .mean
            .iter()
            .zip(&valid)
            // A refused Gaussian keeps its index; a NaN centre is culled by the first comparison on the device.
            .map(
                |(m, ok)| {
                    if *ok { (DVec3::from(m.map(f64::from)) - origin).as_vec3().to_array() } else { [f32::NAN; 3] }
                },
            )
            .collect();
        let deformation = DeformationBuffers::new(gpu, scene, source, origin, quality)?;
        let sh_degree = g.sh_degree.min(quality.sh_degree);
        let mut parameter = Vec::with_capacity(PARAMETERS.len());
        for (i, p) in PARAMETERS.iter().enumerate().take(REQUIRED) {
            let upload = |bytes: &[u8]| gpu.buffer_with(p.name, bytes);
            parameter.push(match i {
                MEAN => upload(bytemuck::cast_slice(&mean_storage::encode(quality.position, &mean)))?,
                SH_0..REQUIRED => {
                    let planes = if in_degree(i, sh_degree) { g.on_device(i) } else { Cow::default() };
                    upload(bytemuck::cast_slice(&sh_storage::encode(quality.sh, i - SH_0, &planes, g.len())))?
                }
                _ => upload(bytemuck::cast_slice(&g.on_device(i)))?,
            });
        }
        Ok(Self {
            gaussians: g.len() as u32,
            sh_degree,
            origin,
            deformation,
            sh_storage: quality.sh,
            rejected,
            parameter,
            present: g.optional.present(),
            antialiased: g.antialiased,
            optional: optional_buffer(gpu, &g.optional)?,
        })
    }

    /// An SH band, where it is in use.
    pub(crate) fn band(&self, band: usize) -> Option<Slice> {
        in_degree(SH_0 + band, self.sh_degree).then(|| self.parameter[SH_0 + band].whole())
    }

    /// A frame of this scene; background, near plane and time come from `options`.
    pub(crate) fn frame(&self, camera: &Camera, options: FrameOptions) -> Result<Frame> {
        let options = FrameOptions {
            interval: self.deformation.interval(options.time),
            gaussians: self.gaussians,
            superpoints: self.deformation.superpoints,
            sh_degree: self.sh_degree,
            ..options
        };
        Frame::new(camera, self.origin, &options)
    }

    /// SH bytes that a visible Gaussian costs.
    pub(crate) fn sh_bytes(&self) -> u64 {
        let bands = &self.parameter[SH_0..=SH_0 + self.sh_degree as usize];
        let words = bands.iter().map(Buffer::bytes).sum::<u64>();
        words / u64::from(self.gaussians.max(1))
    }

    /// Bytes of the model on the device.
    pub(crate) fn bytes(&self) -> u64 {
        self.deformation.bytes() + self.parameter.iter().chain(&self.optional).map(Buffer::bytes).sum::<u64>()
    }
}

/// The planes of all optional parameters; `None` where there are none.
pub(crate) fn optional_buffer(gpu: &Gpu, optional: &Optional) -> Result<Option<Buffer>> {
    let some = (!optional.is_empty()).then(|| gpu.buffer_with("optional", bytemuck::cast_slice(&optional.to_device())));
    some.transpose()
}

/// Centre of the valid Gaussians' bounds when it is far away in terms of their extent, else zero.
fn far_origin(g: &Gaussians, valid: &[bool]) -> DVec3 {
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for (m, _) in g.mean.iter().zip(valid).filter(|(_, ok)| **ok) {
        let m = DVec3::from(m.map(f64::from));
        low = low.min(m);
        high = high.max(m);
    }
    let centre = (low + high) * 0.5;
    let far = low.x <= high.x && centre.length() > RECENTRE_RATIO * (high - low).length().max(1.0);
    // Rounded to f32, so that subtracting it from f32 means is exact.
    if far { centre.as_vec3().as_dvec3() } else { DVec3::ZERO }
}

fn check_lengths(g: &Gaussians) -> Result<()> {
    let n = g.len();
    let lengths = [
        ("log_scale", g.log_scale.len(), n),
        ("rotation", g.rotation.len(), n),
        ("opacity_logit", g.opacity_logit.len(), n),
        ("sh", g.sh.len(), n * g.sh_coefficients() * 3),
    ];
    for (name, found, expected) in lengths {
        if found != expected {
            return Err(Error::usage(format!("gaussians.{name}"), format!("{found} values"), format!("{expected}")));
        }
    }
    for (parameter, values) in g.optional.iter() {
        let Parameter { export, width, .. } = PARAMETERS[parameter];
        if values.len() != n * width as usize {
            let expected = (n * width as usize).to_string();
            return Err(Error::usage(format!("gaussians.{export}"), format!("{} values", values.len()), expected));
        }
    }
    if g.sh_degree > 3 {
        return Err(Error::usage("SH degree", g.sh_degree.to_string(), "0 to 3"));
    }
    if n > 1 << 30 {
        return Err(Error::Limit { what: "Gaussians".into(), need: n as u128, have: 1 << 30 });
    }
    Ok(())
}
