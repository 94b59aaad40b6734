//! One Gaussian in world space to one splat in the image plane.

use glam::{DMat3, DVec2, DVec3};

use super::{ALPHA_MIN, DILATION, Gaussians64, color_of};
use crate::error::{Error, Result};
use crate::scene::parameter::{LIFESPAN, Optional, PARAMETERS, Parameter, SMOOTHING, lifespan_share, smoothed};
use crate::scene::{Camera, Gaussians};

/// Borrowed Gaussian parameters of either precision; read as f64.
#[derive(Debug, Clone, Copy)]
pub struct Parameters<'a, T> {
    mean: &'a [[T; 3]],
    log_scale: &'a [[T; 3]],
    rotation: &'a [[T; 4]],
    opacity_logit: &'a [T],
    sh_degree: u32,
    sh: &'a [T],
    optional: &'a Optional<T>,
    antialiased: bool,
}

macro_rules! borrow_parameters {
    ($gaussians:ty, $scalar:ty) => {
        impl<'a> From<&'a $gaussians> for Parameters<'a, $scalar> {
            fn from(g: &'a $gaussians) -> Self {
                Self {
                    mean: &g.mean,
                    log_scale: &g.log_scale,
                    rotation: &g.rotation,
                    opacity_logit: &g.opacity_logit,
                    sh_degree: g.sh_degree,
                    sh: &g.sh,
                    optional: &g.optional,
                    antialiased: g.antialiased,
                }
            }
        }
    };
}
borrow_parameters!(Gaussians, f32);
borrow_parameters!(Gaussians64, f64);

impl<T: Copy + Into<f64>> Parameters<'_, T> {
    /// All arrays have the same number of Gaussians and the SH degree is one that exists.
    pub fn check(&self) -> Result<()> {
        if self.sh_degree > 3 {
            return Err(Error::usage("SH degree", self.sh_degree.to_string(), "0 to 3"));
        }
        let n = self.mean.len();
        let lengths = [
            ("log_scale", self.log_scale.len(), n),
            ("rotation", self.rotation.len(), n),
            ("opacity_logit", self.opacity_logit.len(), n),
            ("sh", self.sh.len(), n * self.sh_values()),
        ];
        let optional = self.optional.iter().map(|(parameter, values)| {
            let Parameter { name, width, .. } = PARAMETERS[parameter];
            (name, values.len(), n * width as usize)
        });
        match lengths.into_iter().chain(optional).find(|(_, found, expected)| found != expected) {
            Some((name, found, expected)) => {
                Err(Error::usage(format!("gaussians.{name}"), found.to_string(), format!("{expected} elements")))
            }
            None => Ok(()),
        }
    }

    /// N.
    pub fn count(&self) -> usize {
        self.mean.len()
    }

    /// 3·(degree + 1)².
    fn sh_values(&self) -> usize {
        3 * ((self.sh_degree + 1) * (self.sh_degree + 1)) as usize
    }

    /// Canonical centre of Gaussian `i`.
    pub(super) fn mean(&self, i: usize) -> DVec3 {
        DVec3::from_array(self.mean[i].map(Into::into))
    }

    /// Opacity of Gaussian `i` at a time.
    pub(super) fn opacity(&self, i: usize, time: f64) -> f64 {
        let opacity = 1.0 / (1.0 + (-self.opacity_logit[i].into()).exp());
        match self.optional.row(LIFESPAN, i) {
            Some(&[middle, log_length]) => opacity * lifespan_share(middle.into(), log_length.into(), time),
            _ => opacity,
        }
    }

    /// Standard deviations of Gaussian `i`.
    pub(super) fn scale(&self, i: usize) -> [f64; 3] {
        self.log_scale[i].map(|s| s.into().exp())
    }

    /// Standard deviations and opacity of Gaussian `i` with its smoothing, where it has one.
    pub(super) fn smoothed(&self, i: usize, scale: [f64; 3], opacity: f64) -> ([f64; 3], f64) {
        let Some(&[sigma]) = self.optional.row(SMOOTHING, i) else { return (scale, opacity) };
        let (wide, share) = smoothed(scale, sigma.into());
        (wide, opacity * share)
    }

    /// `[K,3]` SH coefficients of Gaussian `i`, and their degree.
    pub(super) fn sh(&self, i: usize) -> (Vec<f64>, u32) {
        let count = self.sh_values();
        (self.sh[i * count..(i + 1) * count].iter().map(|&x| x.into()).collect(), self.sh_degree)
    }

    /// Quaternion w,x,y,z of Gaussian `i`.
    pub(super) fn rotation(&self, i: usize) -> [f64; 4] {
        self.rotation[i].map(Into::into)
    }
}

/// A projected Gaussian.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Splat {
    /// Centre, px.
    pub mean: DVec2,
    /// Upper Cholesky factor of the conic Σ₂⁻¹, `[l₁₁, l₁₂, l₂₂]`: u = l₁₁dx + l₁₂dy, v = l₂₂dy, dᵀΣ₂⁻¹d = u² + v².
    /// A sum of squares stays ≥ 0 where the expanded form of a needle would not.
    pub factor: [f64; 3],
    /// Σ₂ = [[a, b], [b, c]] with dilation, px².
    pub covariance: [f64; 3],
    /// det Σ₂, px⁴.
    pub determinant: f64,
    /// Opacity in (0, 1].
    pub opacity: f64,
    /// Camera-space z.
    pub depth: f64,
    /// Linear RGB ≥ 0.
    pub color: [f64; 3],
    /// Index of the Gaussian.
    pub index: usize,
}

impl Splat {
    /// α at a point of the image, before the 1/255 test.
    pub fn alpha(&self, point: DVec2) -> f64 {
        (self.opacity * (-0.5 * self.square(point)).exp()).min(super::ALPHA_MAX)
    }

    /// dᵀΣ₂⁻¹d of a point of the image.
    pub(crate) fn square(&self, point: DVec2) -> f64 {
        let d = point - self.mean;
        let (u, v) = (self.factor[0] * d.x + self.factor[1] * d.y, self.factor[2] * d.y);
        u * u + v * v
    }
}

/// Clamp range of x/z (or y/z): the image's own range widened by 0.3·tan(half field of view) on either side.
pub(super) fn tangent_limit(size: u32, focal: f64, center: f64) -> (f64, f64) {
    let size = f64::from(size);
    let margin = 0.3 * size / (2.0 * focal);
    (-(center / focal + margin), (size - center) / focal + margin)
}

/// Projects Gaussian `i`, which has this centre, these axes and deviations in world space, and this opacity. `None` when it is
/// behind the near plane, can nowhere reach α = 1/255, or is not finite. Conditions are phrased so that NaN fails.
pub fn project<T: Copy + Into<f64>>(
    parameters: &Parameters<'_, T>,
    i: usize,
    (mean, rotation, scale): (DVec3, DMat3, [f64; 3]),
    opacity: f64,
    camera: &Camera,
    near: f64,
) -> Option<Splat> {
    let offset = mean - camera.position;
    let p = camera.rotation * offset;
    if !(p.z > near && opacity >= ALPHA_MIN) {
        return None;
    }
    let (scale, opacity) = parameters.smoothed(i, scale, opacity);
    let axes = camera.rotation * rotation;
    let (covariance, determinant, own) = covariance_2d(p, axes, scale, camera);
    let [a, b, c] = covariance;
    let opacity = if parameters.antialiased { opacity * (own / determinant).sqrt() } else { opacity };
    // Not phrased like the test above: NaN is found below.
    if opacity < ALPHA_MIN {
        return None;
    }
    let sh = parameters.sh_values();
    let splat = Splat {
        mean: DVec2::new(camera.fx * (p.x / p.z) + camera.cx, camera.fy * (p.y / p.z) + camera.cy),
        factor: [(c / determinant).sqrt(), -b / (c.sqrt() * determinant.sqrt()), 1.0 / c.sqrt()],
        covariance,
        determinant,
        opacity,
        depth: p.z,
        color: color_of(&parameters.sh[i * sh..(i + 1) * sh], parameters.sh_degree, offset),
        index: i,
    };
    let finite = splat.mean.is_finite() && splat.depth.is_finite() && a.is_finite();
    (finite && splat.factor.iter().chain(&splat.color).all(|x| x.is_finite())).then_some(splat)
}

/// Σ₂ = M Mᵀ + 0.3·I as [a, b, c], its determinant and that of M Mᵀ, with M = J·axes·diag(scale) (2×3).
///
/// det(M Mᵀ) is the sum of the squared 2×2 minors of M (Cauchy–Binet): nothing cancels, so needles keep their width.
fn covariance_2d(p: DVec3, axes: DMat3, scale: [f64; 3], camera: &Camera) -> ([f64; 3], f64, f64) {
    let (x_min, x_max) = tangent_limit(camera.width, camera.fx, camera.cx);
    let (y_min, y_max) = tangent_limit(camera.height, camera.fy, camera.cy);
    let x = (p.x / p.z).max(x_min).min(x_max);
    let y = (p.y / p.z).max(y_min).min(y_max);
    let (fx, fy) = (camera.fx / p.z, camera.fy / p.z);
    // Column k of J·axes; scaled by the k-th standard deviation.
    let direction = |k: usize| {
        let e = axes.col(k);
        DVec2::new(fx * (e.x - x * e.z), fy * (e.y - y * e.z))
    };
    let d = [direction(0), direction(1), direction(2)];
    let m = [d[0] * scale[0], d[1] * scale[1], d[2] * scale[2]];
    let sum = |f: fn(DVec2) -> f64| m.iter().map(|&v| f(v)).sum::<f64>();
    let (a, b, c) = (sum(|v| v.x * v.x), sum(|v| v.x * v.y), sum(|v| v.y * v.y));
    let minor = |j: usize, k: usize| (d[j].perp_dot(d[k]) * scale[j] * scale[k]).powi(2);
    let own = minor(0, 1) + minor(0, 2) + minor(1, 2);
    let det = own + DILATION * (a + c) + DILATION * DILATION;
    ([a + DILATION, b, c + DILATION], det, own)
}
