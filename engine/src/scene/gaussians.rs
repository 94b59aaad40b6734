//! The canonical Gaussians, as stored: raw parameters, one array per parameter.

use std::borrow::Cow;
use std::ops::Range;

use rayon::prelude::*;
use serde::Serialize;

use super::parameter::{
    LOG_SCALE, MEAN, OPACITY_LOGIT, Optional, PARAMETERS, Present, REQUIRED, ROTATION, SH_0, SMOOTHING, in_degree,
    smoothed,
};

/// N Gaussians. Names carry their transform: `log_scale` is exponentiated, `opacity_logit` goes through a sigmoid,
/// `rotation` is normalised, when used.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Gaussians {
    /// `[N,3]` canonical centre, world units.
    pub mean: Vec<[f32; 3]>,
    /// `[N,3]` log of the standard deviations, world units.
    pub log_scale: Vec<[f32; 3]>,
    /// `[N,4]` quaternion w,x,y,z of any length > 0.
    pub rotation: Vec<[f32; 4]>,
    /// `[N]` opacity before the sigmoid.
    pub opacity_logit: Vec<f32>,
    /// SH degree 0–3; K = (degree + 1)².
    pub sh_degree: u32,
    /// `[N,K,3]` SH coefficients (coefficient-major, RGB innermost); colour = max(0, 0.5 + Σ).
    pub sh: Vec<f32>,
    /// What only some scenes have.
    pub optional: Optional,
    /// Whether a splat keeps the weight of its Gaussian where the 0.3 px² added to its covariance Σ₂ make it wider: its opacity
    /// is multiplied by √(det(Σ₂ − 0.3·I) / det Σ₂). A matter of how the Gaussians were trained (gsplat's rasterisation mode
    /// `antialiased`; the 2-D filter of Mip-Splatting, Yu et al. 2024, with its width of 0.3).
    pub antialiased: bool,
}

/// An array of [`Gaussians`]: name, shape, values.
pub type Array<'a> = (&'static str, Vec<usize>, &'a [f32]);

/// How many Gaussians were skipped on load or refused by the renderer, by reason.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Rejected {
    /// A parameter is NaN or infinite.
    pub not_finite: usize,
    /// The quaternion's length is zero (squared length below 1e-24) or its square overflows.
    pub zero_rotation: usize,
    /// A |log scale| above [`MAX_ABS_LOG_SCALE`].
    pub absurd_scale: usize,
    /// A coordinate beyond ±[`MAX_ABS_MEAN`], or an SH coefficient beyond ±[`MAX_ABS_SH`].
    pub out_of_range: usize,
}

/// Largest |log scale| that is rendered: e^30 ≈ 1e13 world units; beyond it f32 covariances overflow.
pub const MAX_ABS_LOG_SCALE: f32 = 30.0;
/// Largest |coordinate| that is rendered; beyond it f32 squares overflow.
pub const MAX_ABS_MEAN: f32 = 1.0e15;
/// Largest |SH coefficient| that is rendered.
pub const MAX_ABS_SH: f32 = 1.0e6;

impl Rejected {
    /// Total number.
    pub fn total(&self) -> usize {
        self.not_finite + self.zero_rotation + self.absurd_scale + self.out_of_range
    }
}

impl std::ops::Add for Rejected {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            not_finite: self.not_finite + other.not_finite,
            zero_rotation: self.zero_rotation + other.zero_rotation,
            absurd_scale: self.absurd_scale + other.absurd_scale,
            out_of_range: self.out_of_range + other.out_of_range,
        }
    }
}

impl Gaussians {
    /// N.
    pub fn len(&self) -> usize {
        self.mean.len()
    }

    /// The Gaussians at these indices, in this order.
    #[must_use]
    pub fn selected(&self, indices: &[usize]) -> Self {
        let k = self.sh_coefficients() * 3;
        let mut sh = vec![0.0; indices.len() * k];
        let rows = sh.par_chunks_exact_mut(k).zip(indices).with_min_len(1024);
        rows.for_each(|(row, &i)| row.copy_from_slice(&self.sh[i * k..(i + 1) * k]));
        Self {
            mean: indices.par_iter().map(|&i| self.mean[i]).collect(),
            log_scale: indices.par_iter().map(|&i| self.log_scale[i]).collect(),
            rotation: indices.par_iter().map(|&i| self.rotation[i]).collect(),
            opacity_logit: indices.par_iter().map(|&i| self.opacity_logit[i]).collect(),
            sh_degree: self.sh_degree,
            sh,
            optional: self.optional.selected(indices),
            antialiased: self.antialiased,
        }
    }

    /// All arrays that files hold.
    pub fn arrays(&self) -> Vec<Array<'_>> {
        let n = self.len();
        let mut all: Vec<Array<'_>> = vec![
            ("mean", vec![n, 3], self.mean.as_flattened()),
            ("log_scale", vec![n, 3], self.log_scale.as_flattened()),
            ("rotation", vec![n, 4], self.rotation.as_flattened()),
            ("opacity_logit", vec![n], &self.opacity_logit),
            ("sh", vec![n, self.sh_coefficients(), 3], &self.sh),
        ];
        let optional = self.optional.iter().map(|(parameter, values)| {
            let p = &PARAMETERS[parameter];
            (p.export, vec![n, p.width as usize], values)
        });
        all.extend(optional);
        all
    }

    /// Gaussians of these arrays. `take` gives an array of this name, and of this shape where sides are known; of an optional
    /// parameter `None` where there is none.
    ///
    /// # Errors
    /// Those of `take`.
    pub(crate) fn from_arrays<E>(
        sh_degree: u32,
        mut take: impl FnMut(&str, &[Option<usize>], bool) -> Result<Option<Vec<f32>>, E>,
    ) -> Result<Self, E> {
        let k = ((sh_degree + 1) * (sh_degree + 1)) as usize;
        let mut required = |name: &str, shape: &[Option<usize>]| Ok(take(name, shape, true)?.unwrap_or_default());
        let mean = required("mean", &[None, Some(3)])?.as_chunks().0.to_vec();
        let n = Some(mean.len());
        let mut made = Self {
            mean,
            log_scale: required("log_scale", &[n, Some(3)])?.as_chunks().0.to_vec(),
            rotation: required("rotation", &[n, Some(4)])?.as_chunks().0.to_vec(),
            opacity_logit: required("opacity_logit", &[n])?,
            sh_degree,
            sh: required("sh", &[n, Some(k), Some(3)])?,
            optional: Optional::default(),
            antialiased: false,
        };
        for (parameter, p) in PARAMETERS.iter().enumerate().skip(REQUIRED) {
            if let Some(values) = take(p.export, &[n, Some(p.width as usize)], false)? {
                made.optional.set(parameter, values);
            }
        }
        Ok(made)
    }

    /// Gaussians whose parameters `take` gives, `[N,width]` each: those of the degree, and `optional` ones.
    ///
    /// # Errors
    /// Those of `take`.
    pub(crate) fn from_parameters<E>(
        sh_degree: u32,
        optional: Present,
        mut take: impl FnMut(usize) -> Result<Vec<f32>, E>,
    ) -> Result<Self, E> {
        let mut made = Self {
            mean: take(MEAN)?.as_chunks().0.to_vec(),
            log_scale: take(LOG_SCALE)?.as_chunks().0.to_vec(),
            rotation: take(ROTATION)?.as_chunks().0.to_vec(),
            opacity_logit: take(OPACITY_LOGIT)?,
            sh_degree,
            ..Self::default()
        };
        let width = 3 * made.sh_coefficients();
        made.sh = vec![0.0; made.len() * width];
        for band in 0..=sh_degree as usize {
            let (values, of_band) = (take(SH_0 + band)?, 3 * (2 * band + 1));
            for (row, values) in made.sh.chunks_exact_mut(width).zip(values.chunks_exact(of_band)) {
                row[3 * band * band..][..of_band].copy_from_slice(values);
            }
        }
        for parameter in optional.iter() {
            made.optional.set(parameter, take(parameter)?);
        }
        Ok(made)
    }

    /// A required parameter in the order of the device; empty for an SH band above the degree.
    pub fn on_device(&self, parameter: usize) -> Cow<'_, [f32]> {
        let rows = match parameter {
            MEAN => self.mean.as_flattened(),
            LOG_SCALE => self.log_scale.as_flattened(),
            ROTATION => self.rotation.as_flattened(),
            OPACITY_LOGIT => &self.opacity_logit,
            band if band < REQUIRED && in_degree(band, self.sh_degree) => {
                let (band, width) = (band - SH_0, 3 * self.sh_coefficients());
                let planes = 3 * band * band..3 * (band + 1) * (band + 1);
                return planes.flat_map(|k| self.sh.iter().skip(k).step_by(width).copied()).collect::<Vec<_>>().into();
            }
            _ => &[],
        };
        PARAMETERS[parameter].to_device(rows.into())
    }

    /// Whether N = 0.
    pub fn is_empty(&self) -> bool {
        self.mean.is_empty()
    }

    /// K = (degree + 1)², the number of SH coefficients per colour channel.
    pub fn sh_coefficients(&self) -> usize {
        ((self.sh_degree + 1) * (self.sh_degree + 1)) as usize
    }

    /// Makes scales and opacities of what the smoothing makes of them ([`smoothed`]), and leaves it out. Exact while nothing is
    /// added to the scales.
    pub fn fold_smoothing(&mut self) {
        let Some(sigma) = self.optional.take(SMOOTHING) else { return };
        for (i, sigma) in sigma.into_iter().enumerate() {
            let scale = self.log_scale[i].map(|s| f64::from(s).exp());
            let (wide, share) = smoothed(scale, sigma.into());
            let opacity = share / (1.0 + (-f64::from(self.opacity_logit[i])).exp());
            self.log_scale[i] = wide.map(|s| s.ln() as f32);
            self.opacity_logit[i] = (opacity / (1.0 - opacity)).ln() as f32;
        }
    }

    /// Why Gaussian `i` cannot be rendered, if so; counts it in `rejected`. Conditions are phrased so that NaN fails.
    pub fn is_valid(&self, i: usize, rejected: &mut Rejected) -> bool {
        let k3 = self.sh_coefficients() * 3;
        let sh = &self.sh[i * k3..(i + 1) * k3];
        let optional = self.optional.present().iter().flat_map(|parameter| self.optional.row(parameter, i));
        let finite = self.mean[i].iter().chain(&self.log_scale[i]).chain(&self.rotation[i]).chain(sh);
        let finite = finite.chain(optional.flatten());
        // Infinite opacity logits are legal limits (0 and 1); only NaN is refused.
        if !finite.copied().all(f32::is_finite) || self.opacity_logit[i].is_nan() {
            rejected.not_finite += 1;
            return false;
        }
        let norm2: f32 = self.rotation[i].iter().map(|q| q * q).sum();
        if !(norm2 > 1.0e-24 && norm2.is_finite()) {
            rejected.zero_rotation += 1;
            return false;
        }
        let smoothing = self.optional.row(SMOOTHING, i).map_or(0.0, |sigma| sigma[0].abs());
        if !(self.log_scale[i].iter().all(|s| s.abs() <= MAX_ABS_LOG_SCALE) && smoothing <= MAX_ABS_LOG_SCALE.exp()) {
            rejected.absurd_scale += 1;
            return false;
        }
        if !(self.mean[i].iter().all(|m| m.abs() <= MAX_ABS_MEAN) && sh.iter().all(|c| c.abs() <= MAX_ABS_SH)) {
            rejected.out_of_range += 1;
            return false;
        }
        true
    }

    /// Adds those of `other` in `range`. The lower SH degree of the two is raised, with zeros.
    pub(crate) fn append(&mut self, other: &Self, range: Range<usize>) {
        self.antialiased = if self.is_empty() { other.antialiased } else { self.antialiased };
        self.raise_degree(other.sh_degree);
        self.mean.extend_from_slice(&other.mean[range.clone()]);
        self.log_scale.extend_from_slice(&other.log_scale[range.clone()]);
        self.rotation.extend_from_slice(&other.rotation[range.clone()]);
        self.optional.append(self.opacity_logit.len(), &other.optional, range.clone());
        self.opacity_logit.extend_from_slice(&other.opacity_logit[range.clone()]);
        let (k3, width) = (other.sh_coefficients() * 3, self.sh_coefficients() * 3);
        for sh in other.sh[range.start * k3..range.end * k3].chunks_exact(k3) {
            self.sh.extend_from_slice(sh);
            self.sh.resize(self.sh.len() + width - k3, 0.0);
        }
    }

    /// Makes the SH degree at least this, with zeros.
    fn raise_degree(&mut self, degree: u32) {
        if degree <= self.sh_degree {
            return;
        }
        let k3 = self.sh_coefficients() * 3;
        self.sh_degree = degree;
        let width = self.sh_coefficients() * 3;
        let mut raised = Vec::with_capacity(self.len() * width);
        for sh in self.sh.chunks_exact(k3) {
            raised.extend_from_slice(sh);
            raised.resize(raised.len() + width - k3, 0.0);
        }
        self.sh = raised;
    }

    /// Keeps the Gaussians for which `keep` holds, in order.
    pub fn retain(&mut self, keep: &[bool]) {
        let k3 = self.sh_coefficients() * 3;
        let others = || {
            retain_chunks(&mut self.mean, 1, keep);
            retain_chunks(&mut self.log_scale, 1, keep);
            retain_chunks(&mut self.rotation, 1, keep);
            retain_chunks(&mut self.opacity_logit, 1, keep);
            self.optional.retain(keep);
        };
        rayon::join(|| retain_chunks(&mut self.sh, k3, keep), others);
    }

    /// Adds copies of those at `indices`, in this order.
    pub(crate) fn repeat(&mut self, indices: &[usize]) {
        let k3 = self.sh_coefficients() * 3;
        let others = || {
            repeat_chunks(&mut self.mean, 1, indices);
            repeat_chunks(&mut self.log_scale, 1, indices);
            repeat_chunks(&mut self.rotation, 1, indices);
            repeat_chunks(&mut self.opacity_logit, 1, indices);
            self.optional.repeat(indices);
        };
        rayon::join(|| repeat_chunks(&mut self.sh, k3, indices), others);
    }
}

/// Keeps chunk i (of `width` elements) of `values` where `keep[i]`.
pub(crate) fn retain_chunks<T: Copy>(values: &mut Vec<T>, width: usize, keep: &[bool]) {
    let (mut to, mut at) = (0, 0);
    for run in keep.chunk_by(|a, b| a == b) {
        let end = (at + run.len() * width).min(values.len());
        if run[0] {
            values.copy_within(at..end, to);
            to += end - at;
        }
        at = end;
    }
    values.truncate(to);
}

/// Adds copies of chunks (of `width` elements) of `values`, in this order.
pub(crate) fn repeat_chunks<T: Copy>(values: &mut Vec<T>, width: usize, indices: &[usize]) {
    values.reserve_exact(indices.len() * width);
    indices.iter().for_each(|&i| values.extend_from_within(i * width..(i + 1) * width));
}
