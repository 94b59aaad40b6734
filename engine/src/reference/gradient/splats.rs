//! From the gradient of the image to the gradient of the splats: the backward of blending.
//!
//! At a pixel with upstream gradient g = dL/d colour and g_A = dL/dA, front to back with transmittance Tᵢ before splat i:
//! dL/dcᵢ = αᵢTᵢg and dL/dαᵢ = Tᵢ(cᵢ·g − Sᵢ), where Sᵢ is what lies behind, seen through nothing: S after the last is
//! background·g − g_A, and S in front of i is αᵢ(cᵢ·g) + (1 − αᵢ)Sᵢ. A clamped α (0.99) passes no gradient on.

use glam::DVec2;
use rayon::prelude::*;

use crate::reference::blend::{BAND, band_lists};
use crate::reference::{ALPHA_MAX, ALPHA_MIN, Splat, TRANSMITTANCE_MIN};
use crate::scene::Camera;

/// 2 ln 2 = 1/κ²: the kernels' u and v are κ = √(log₂e / 2) times those of [`Splat::factor`].
pub const TWO_LN_2: f64 = 2.0 * std::f64::consts::LN_2;

/// dL/d image.
#[derive(Debug, Clone, Copy, Default)]
pub struct Upstream<'a> {
    /// `[H,W,3]` dL/d colour.
    pub color: &'a [f64],
    /// `[H,W]` dL/dA, A = 1 − T.
    pub alpha: Option<&'a [f64]>,
}

/// What the image's gradient leaves at one splat, h = dL/d ln α at a pixel, summed over pixels, with u and v of
/// [`Splat::factor`].
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct SplatGradient {
    /// Σ h = dL/d ln opacity.
    pub h: f64,
    /// Σ h·(u, v).
    pub first: [f64; 2],
    /// Σ h·(u², uv, v²).
    pub second: [f64; 3],
    /// dL/d(r, g, b) of the splat.
    pub color: [f64; 3],
    /// Pixels that it contributes to.
    pub pixels: f64,
    /// Σ |dL/d(x, y) of the centre|, per px, pixel by pixel (Ye et al. 2024, AbsGS).
    pub absolute: [f64; 2],
}

impl SplatGradient {
    /// The row of the kernels' `splat_gradient`, in their units of u and v.
    pub fn row(&self) -> [f32; 12] {
        let kappa = TWO_LN_2.sqrt().recip();
        let [u, v] = self.first.map(|x| (x * kappa) as f32);
        let [uu, uv, vv] = self.second.map(|x| (x / TWO_LN_2) as f32);
        let [r, g, b] = self.color.map(|x| x as f32);
        let [by_x, by_y] = self.absolute.map(|x| (x / TWO_LN_2) as f32);
        [self.h as f32, u, v, uu, uv, vv, r, g, b, self.pixels as f32, by_x, by_y]
    }

    /// From a row of the kernels' `splat_gradient`.
    pub fn from_row(row: [f32; 12]) -> Self {
        let row = row.map(f64::from);
        let inverse_kappa = TWO_LN_2.sqrt();
        Self {
            h: row[0],
            first: [row[1] * inverse_kappa, row[2] * inverse_kappa],
            second: [row[3] * TWO_LN_2, row[4] * TWO_LN_2, row[5] * TWO_LN_2],
            color: [row[6], row[7], row[8]],
            pixels: row[9],
            absolute: [row[10] * TWO_LN_2, row[11] * TWO_LN_2],
        }
    }

    fn add(&mut self, other: &Self) {
        self.h += other.h;
        (0..2).for_each(|i| self.first[i] += other.first[i]);
        (0..3).for_each(|i| self.second[i] += other.second[i]);
        (0..3).for_each(|i| self.color[i] += other.color[i]);
        self.pixels += other.pixels;
        (0..2).for_each(|i| self.absolute[i] += other.absolute[i]);
    }
}

/// A splat that was blended at a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contribution {
    /// Position in the list of splats.
    pub splat: u32,
    /// As blended.
    pub alpha: f64,
    /// Transmittance in front of it.
    pub transmittance: f64,
    /// See [`Splat::factor`].
    pub u: f64,
    /// See [`Splat::factor`].
    pub v: f64,
    /// α was clamped to 0.99.
    pub clamped: bool,
}

/// What is blended at a point of the image, front to back; `candidates` are positions in `splats`, ascending.
pub fn contributions(splats: &[Splat], candidates: &[u32], point: DVec2) -> Vec<Contribution> {
    let mut found = Vec::new();
    let mut transmittance = 1.0;
    for &index in candidates {
        let splat = &splats[index as usize];
        let d = point - splat.mean;
        let (u, v) = (splat.factor[0] * d.x + splat.factor[1] * d.y, splat.factor[2] * d.y);
        let unclamped = splat.opacity * (-0.5 * (u * u + v * v)).exp();
        let alpha = unclamped.min(ALPHA_MAX);
        if alpha < ALPHA_MIN {
            continue;
        }
        let next = transmittance * (1.0 - alpha);
        if next < TRANSMITTANCE_MIN {
            break;
        }
        found.push(Contribution { splat: index, alpha, transmittance, u, v, clamped: unclamped > ALPHA_MAX });
        transmittance = next;
    }
    found
}

/// Gradients of `splats`, which are given front to back, in their order. The sum over pixels is by rows, then by bands of
/// rows, so it does not depend on the number of threads.
pub fn splat_gradients(
    splats: &[Splat],
    camera: &Camera,
    background: [f64; 3],
    upstream: &Upstream<'_>,
) -> Vec<SplatGradient> {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let bands: Vec<Vec<SplatGradient>> = band_lists(splats, height)
        .par_iter()
        .enumerate()
        .map(|(b, list)| {
            let mut sum = vec![SplatGradient::default(); splats.len()];
            for y in b * BAND..(b * BAND + BAND).min(height) {
                for x in 0..width {
                    let found = contributions(splats, list, DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
                    pixel(splats, &found, background, upstream, y * width + x, &mut sum);
                }
            }
            sum
        })
        .collect();
    let mut total = vec![SplatGradient::default(); splats.len()];
    for band in bands {
        total.iter_mut().zip(&band).for_each(|(t, b)| t.add(b));
    }
    total
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Adds pixel number `at`, back to front.
fn pixel(
    splats: &[Splat],
    found: &[Contribution],
    background: [f64; 3],
    upstream: &Upstream<'_>,
    at: usize,
    sum: &mut [SplatGradient],
) {
    let g = [upstream.color[3 * at], upstream.color[3 * at + 1], upstream.color[3 * at + 2]];
    let mut behind = dot(background, g) - upstream.alpha.map_or(0.0, |a| a[at]);
    for c in found.iter().rev() {
        let front = dot(splats[c.splat as usize].color, g);
        let factor = splats[c.splat as usize].factor;
        let slope = if c.clamped { 0.0 } else { c.alpha * c.transmittance * (front - behind) };
        let weight = c.alpha * c.transmittance;
        sum[c.splat as usize].add(&SplatGradient {
            h: slope,
            first: [slope * c.u, slope * c.v],
            second: [slope * c.u * c.u, slope * c.u * c.v, slope * c.v * c.v],
            color: g.map(|g| weight * g),
            pixels: 1.0,
            absolute: [slope * c.u * factor[0], slope * (c.u * factor[1] + c.v * factor[2])].map(f64::abs),
        });
        behind = c.alpha * front + (1.0 - c.alpha) * behind;
    }
}
