//! The bound of a frame on this device: each operation takes at least the time of its bytes at the measured copy rate and of
//! its arithmetic at the measured f32 rate, whichever is longer.

use std::collections::BTreeMap;

use engine::error::Result;
use engine::gpu::Gpu;
use engine::reference::gradient::image::visible_splats;
use engine::reference::{self, ALPHA_MIN, Blend64, DeformationAt, Gaussians64, ReferenceOptions, Splat};
use engine::render::RenderOptions;
use engine::render::arithmetic_rate::arithmetic_rate;
use engine::scene::{Camera, Scene};
use serde::Serialize;

use crate::report::measure::Measurement;

/// Operations on one Gaussian from its parameters to its splat with SH of degree 3: counted in the formulas.
const PROJECT_FLOPS: f64 = 650.0;
/// Operations on one pixel that a splat covers: quadratic form, exponential, four multiply-adds, threshold.
const BLEND_FLOPS: f64 = 20.0;

/// One operation against its bound.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct RooflineRow {
    /// Label of the operation.
    pub(super) label: String,
    /// Measured, microseconds.
    pub(super) us: f64,
    /// Bytes that an ideal implementation moves.
    pub(super) bytes: u64,
    /// Floating-point operations.
    pub(super) flops: f64,
    /// Bound by bytes, microseconds.
    pub(super) bytes_us: f64,
    /// Bound by arithmetic, microseconds.
    pub(super) flops_us: f64,
}

impl RooflineRow {
    /// The larger bound, microseconds.
    pub(super) fn bound_us(&self) -> f64 {
        self.bytes_us.max(self.flops_us)
    }
}

/// The frame against its bound.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Roofline {
    /// Measured rate of copies, bytes read plus bytes written, GB/s.
    pub(super) copy_gb_per_s: f64,
    /// Measured rate of f32 multiply-adds, GFLOP/s.
    pub(super) gflop_per_s: f64,
    /// Pairs of a pixel and a splat that covers it.
    pub(super) pairs: f64,
    /// Operations in order.
    pub(super) rows: Vec<RooflineRow>,
    /// Sum of the bounds, milliseconds.
    pub(super) bound_ms: f64,
    /// Frames per second at the bound.
    pub(super) bound_fps: f64,
    /// The bound as a share of the measured device time.
    pub(super) share: f64,
}

/// Pairs of a pixel and a splat with α ≥ 1/255 in a view, from the areas of the splats' ellipses: what blending must look at
/// where nothing in front is opaque.
pub(super) fn pairs(scene: &Scene, camera: &Camera, time: f64, options: &RenderOptions) -> Result<f64> {
    let poses = reference::poses(scene, time, options.motion)?;
    let group = scene.deformation.superpoint_of_gaussian();
    let blend = Blend64::of(scene);
    let deformation = DeformationAt { group, poses: poses.as_deref(), blend: blend.as_ref(), offsets: None, time };
    let near = ReferenceOptions { near: options.near.into(), ..ReferenceOptions::default() };
    let splats = visible_splats(&Gaussians64::from(&scene.gaussians), &deformation, camera, &near)?;
    let pixels = f64::from(camera.width) * f64::from(camera.height);
    let size = [f64::from(camera.width), f64::from(camera.height)];
    let area = |s: &Splat| {
        let inside = (0.0..size[0]).contains(&s.mean.x) && (0.0..size[1]).contains(&s.mean.y);
        let reach = 2.0 * (s.opacity / ALPHA_MIN).ln().max(0.0);
        if inside { (std::f64::consts::PI * reach * s.determinant.sqrt()).min(pixels) } else { 0.0 }
    };
    Ok(splats.iter().map(area).sum())
}

/// Operations of one dispatch of a kernel.
fn flops(kernel: &str, work: &BTreeMap<&'static str, u64>, pairs: f64) -> f64 {
    let of = |name: &str| work.get(name).copied().unwrap_or(0) as f64;
    match kernel {
        "deform_project" => PROJECT_FLOPS * of("gaussians"),
        "blend" => BLEND_FLOPS * pairs,
        "deform_network" => 2.0 * of("network_products") * of("superpoints"),
        _ => 0.0,
    }
}

/// Measures the device's rates and bounds a measured frame.
pub(super) fn roofline(gpu: &Gpu, measured: &Measurement, pairs: f64) -> Result<Roofline> {
    let gflop_per_s = arithmetic_rate(gpu)?;
    let row = |o: &crate::report::measure::OperationRow| {
        let (bytes, flops) = (o.bytes.unwrap_or(0), o.kernel.map_or(0.0, |k| flops(k, &measured.workload, pairs)));
        let (bytes_us, flops_us) = (bytes as f64 / measured.copy_gb_per_s / 1e3, flops / gflop_per_s / 1e3);
        RooflineRow { label: o.label.clone(), us: o.us, bytes, flops, bytes_us, flops_us }
    };
    let rows: Vec<RooflineRow> = measured.operations.iter().map(row).collect();
    let (bound_us, us): (f64, f64) = rows.iter().fold((0.0, 0.0), |(b, u), r| (b + r.bound_us(), u + r.us));
    Ok(Roofline {
        copy_gb_per_s: measured.copy_gb_per_s,
        gflop_per_s,
        pairs,
        rows,
        bound_ms: bound_us / 1e3,
        bound_fps: if bound_us > 0.0 { 1e6 / bound_us } else { 0.0 },
        share: if us > 0.0 { bound_us / us } else { 0.0 },
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    #[test]
    fn kernels_that_calculate_are_kernels_of_the_engine() {
        let work: BTreeMap<&'static str, u64> = [("gaussians", 10), ("superpoints", 2), ("network_products", 7)].into();
        let counted = ["deform_project", "blend", "deform_network"];
        for name in counted {
            assert!(engine::kernels().any(|k| k.name == name) && flops(name, &work, 3.0) > 0.0, "{name}");
        }
        assert_eq!(flops("blend", &work, 3.0), 60.0);
        assert_eq!(flops("scan_tiles", &work, 3.0), 0.0);
    }

    #[test]
    fn pairs_are_those_that_a_brute_force_count_finds() {
        let scene = engine::scene::synthetic::random_scene(300, 5, 0);
        let camera = crate::cli::camera::default_camera(&scene, [96, 96]);
        let splats = visible_splats(
            &Gaussians64::from(&scene.gaussians),
            &DeformationAt::default(),
            &camera,
            &ReferenceOptions::default(),
        )
        .unwrap();
        let mut count = 0;
        for y in 0..96 {
            for x in 0..96 {
                let point = glam::DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
                count += splats.iter().filter(|s| s.alpha(point) >= ALPHA_MIN).count();
            }
        }
        let found = pairs(&scene, &camera, 0.0, &RenderOptions::default()).unwrap();
        assert!((found / count as f64 - 1.0).abs() < 0.1, "{found} {count}");
    }
}
