//! What an edit touched, and how far a point may be from where it should be, in pixels.

use glam::{DMat3, DVec3};
use rayon::prelude::*;
use serde::Serialize;

use super::centers::centers_of;
use crate::error::Result;
use crate::scene::{Camera, Scene};
use crate::train::bake::Views;

/// Largest displacement that re-made poses may cause, pixels: that of the baker.
pub const BOUND_PX: f64 = 0.1;
/// Cameras that measure, at most.
const CAMERAS: usize = 12;
/// Horizontal field of view of cameras that are made, radians, and their size, pixels.
const FOV_X: f64 = 0.8;
const SIZE: [u32; 2] = [800, 800];
/// Nearest depth that is drawn, world units.
const NEAR: f64 = 0.2;
/// Gaussians that the extent of a scene is taken from, at most.
const SAMPLES: usize = 20_000;

/// What an edit touched.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Touched {
    /// Gaussians that were changed, taken away or added.
    pub gaussians: usize,
    /// Superpoints whose poses or rest positions were changed.
    pub superpoints: usize,
    /// Key times that were added to the table; negative where there are fewer.
    pub keys_added: i64,
    /// Largest displacement of a point between key times, pixels; absent where the edit is exact.
    pub error_px: Option<f64>,
    /// What else there is to know.
    pub notes: Vec<String>,
}

/// Through which cameras displacements are measured, and how large they may be.
#[derive(Debug, Clone)]
pub struct Bound {
    /// The cameras.
    pub views: Views<Camera>,
    /// Pixels.
    pub pixels: f64,
}

impl Bound {
    /// Measured through some of these cameras, or, without any, of 12 around the scene, 800x800 pixels each.
    ///
    /// # Errors
    /// Those of placing Gaussians.
    pub fn new(scene: &Scene, cameras: &[Camera], pixels: f64) -> Result<Self> {
        let cameras = if cameras.is_empty() {
            around(scene)?
        } else {
            cameras.iter().step_by(cameras.len().div_ceil(CAMERAS)).cloned().collect()
        };
        Ok(Self { views: Views { cameras, near: NEAR, everywhere: true }, pixels })
    }
}

/// Cameras around the scene as it is in the middle of its time.
fn around(scene: &Scene) -> Result<Vec<Camera>> {
    let [start, end] = scene.time_range();
    let count = scene.gaussians.len();
    let some = (0..count).into_par_iter().step_by(count.div_ceil(SAMPLES).max(1));
    let mut points = centers_of(scene, some, 0.5 * (start + end))?;
    points.retain(|p| p.is_finite());
    let quantile = |mut values: Vec<f64>, q: f64| {
        values.sort_unstable_by(f64::total_cmp);
        values.get((values.len().saturating_sub(1) as f64 * q) as usize).copied().unwrap_or_default()
    };
    let middle = DVec3::from_array([0, 1, 2].map(|axis| quantile(points.iter().map(|p| p[axis]).collect(), 0.5)));
    let radius = quantile(points.iter().map(|p| p.distance(middle)).collect(), 0.9).max(1e-3);
    let distance = radius / (0.5 * FOV_X).sin();
    let view = |i: usize| {
        let turn = DMat3::from_axis_angle(DVec3::Y, std::f64::consts::TAU * i as f64 / CAMERAS as f64);
        let up_or_down = if i.is_multiple_of(2) { 0.3 } else { -0.3 };
        let eye = middle + distance * (turn * DVec3::new(0.0, up_or_down, -1.0).normalize());
        Camera::look_at(eye, middle, DVec3::NEG_Y, FOV_X, SIZE)
    };
    Ok((0..CAMERAS).map(view).collect())
}
