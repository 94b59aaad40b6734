//! Case 15: gradients of every kind of parameter, the f64 ones against differences and the device's against the f64 ones.

mod stencil;

use engine::error::Result;
use engine::gpu::Gpu;
use engine::reference::gradient::image::{Gradients, image_gradients};
use engine::reference::gradient::splats::Upstream;
use engine::reference::{Blend64, DeformationAt, Gaussians64, ReferenceOptions, table_poses};
use engine::scene::parameter::PARAMETERS;
use engine::scene::synthetic::{HardCase, Random, moving_scene, random_optional, random_scene};
use engine::scene::{Camera, Scene};
use engine::train::gradient::{GradientOptions, SceneGradients, scene_gradients};
use engine::train::parameters::with_sh_degree;

use super::case::{Case, Check, Context, Outcome};
use super::{images, views};

/// Largest ‖device − truth‖ / ‖truth‖ of a kind of parameter.
const MAX_RELATIVE_L2: f64 = 1e-4;
/// Smallest cosine of the angle between them.
const MIN_COSINE: f64 = 0.9999;
/// Between the keys of a moving scene.
const TIME: f64 = 0.375;
/// Images of the engine whose gradients are judged too.
const HARD: [&str; 10] = [
    "needles_1e2",
    "needles_1e4",
    "scale_1e-8",
    "quaternion_lengths",
    "camera_inside",
    "equal_depths",
    "faint_layers",
    "alpha_clamp",
    "wide_field_of_view",
    "principal_point_outside",
];

pub(super) fn cases() -> Vec<Case> {
    let differences =
        "Every kind of parameter in f64, analytic against 4-point differences on one smooth piece (10 Gaussians).";
    let mut all = vec![Case::new(15, "gradients_f64", differences, |_| stencil::judge())];
    for degree in 0..4 {
        let input = format!("600 Gaussians of SH degree {degree} that stand still; dL/d pixel is random.");
        all.push(Case::new(15, format!("gradients_still_sh{degree}"), input, move |c| {
            judge(c, &View::usual(random_scene(600, 150 + u64::from(degree), degree)))
        }));
    }
    let moving = "600 Gaussians of SH degree 3 on 12 superpoints between two keys, the poses' gradients included.";
    all.push(Case::new(15, "gradients_moving", moving, |c| {
        judge(c, &View::usual(moving_scene(600, 12, 2, 155, false)))
    }));
    let optional = "600 Gaussians of SH degree 1 with every optional parameter, on 12 superpoints between two keys.";
    all.push(Case::new(15, "gradients_optional", optional, |c| {
        let mut scene = moving_scene(600, 12, 2, 156, false);
        scene.gaussians = with_sh_degree(&scene.gaussians, 1);
        scene.gaussians.optional = random_optional(scene.gaussians.len(), 157);
        judge(c, &View::usual(scene))
    }));
    for name in HARD {
        let input = format!("The Gaussians of `{name}`; dL/d pixel is random.");
        all.push(Case::new(15, format!("gradients_{name}"), input, move |c| {
            judge(c, &View::hard(images::named(name)?))
        }));
    }
    all
}

/// What an image's gradient depends on.
pub(super) struct View {
    scene: Scene,
    camera: Camera,
    time: f64,
    options: GradientOptions,
    /// `[H,W,4]` dL/d(r, g, b, A).
    upstream: Vec<f32>,
}

impl View {
    fn new(scene: Scene, camera: Camera, time: f64, options: GradientOptions) -> Self {
        let mut random = Random::new(15);
        let count = 4 * camera.width as usize * camera.height as usize;
        let upstream = (0..count).map(|_| random.range(-1.0, 1.0) as f32).collect();
        Self { scene, camera, time, options, upstream }
    }

    pub(super) fn usual(scene: Scene) -> Self {
        let options = GradientOptions { near: 0.2, background: [0.3, 0.1, 0.6] };
        Self::new(scene, views::camera(64, 48), TIME, options)
    }

    fn hard(case: HardCase) -> Self {
        let options = GradientOptions { near: case.near, background: case.background };
        Self::new(case.scene, case.camera, case.time, options)
    }

    pub(super) fn on_device(&self, gpu: &Gpu) -> Result<SceneGradients> {
        scene_gradients(gpu, &self.scene, &self.camera, self.time, &self.options, &self.upstream)
    }

    fn truth(&self) -> Result<Gradients> {
        let poses = self.scene.deformation.table().map(|motion| table_poses(motion, self.time));
        let group = self.scene.deformation.superpoint_of_gaussian();
        let blend = Blend64::of(&self.scene);
        let deformation =
            DeformationAt { group, poses: poses.as_deref(), blend: blend.as_ref(), offsets: None, time: self.time };
        let color: Vec<f64> = self.upstream.chunks_exact(4).flat_map(|g| [g[0], g[1], g[2]]).map(f64::from).collect();
        let alpha: Vec<f64> = self.upstream.iter().skip(3).step_by(4).map(|&a| f64::from(a)).collect();
        let options = ReferenceOptions {
            near: f64::from(self.options.near),
            background: self.options.background.map(f64::from),
            ..ReferenceOptions::default()
        };
        let upstream = Upstream { color: &color, alpha: Some(&alpha) };
        image_gradients(&Gaussians64::from(&self.scene.gaussians), &deformation, &self.camera, &options, &upstream)
    }
}

/// One kind of parameter on both sides.
fn kinds<'a>(found: &'a SceneGradients, truth: &Gradients) -> Vec<(&'static str, &'a [f32], Vec<f64>)> {
    let mut all = vec![
        ("mean", found.mean.as_flattened(), truth.mean.as_flattened().to_vec()),
        ("rotation", found.rotation.as_flattened(), truth.rotation.as_flattened().to_vec()),
        ("log_scale", found.log_scale.as_flattened(), truth.log_scale.as_flattened().to_vec()),
        ("opacity_logit", &found.opacity_logit[..], truth.opacity_logit.clone()),
        ("sh", &found.sh[..], truth.sh.clone()),
        ("mean2d", found.mean2d.as_flattened(), truth.mean2d.as_flattened().to_vec()),
    ];
    for (parameter, device) in found.optional.iter() {
        let exact = truth.optional.get(parameter).unwrap_or_default();
        all.push((PARAMETERS[parameter].name, device, exact.to_vec()));
    }
    if !found.pose.is_empty() {
        let each = truth
            .each
            .iter()
            .flat_map(|g| g.pose(0).omega.to_array().into_iter().chain(g.pose(0).translation.to_array()));
        all.push(("pose", found.pose.as_flattened(), each.collect()));
    }
    all
}

fn norm(values: impl Iterator<Item = f64>) -> f64 {
    values.map(|v| v * v).sum::<f64>().sqrt()
}

/// Relative L2 distance and cosine; (0, 1) when both are zero, (∞, 0) when lengths differ.
fn compare(found: &[f32], truth: &[f64]) -> (f64, f64) {
    if found.len() != truth.len() {
        return (f64::INFINITY, 0.0);
    }
    let wide = || found.iter().map(|&f| f64::from(f));
    let distance = norm(wide().zip(truth).map(|(f, t)| f - t));
    let (a, b) = (norm(wide()), norm(truth.iter().copied()));
    let dot: f64 = wide().zip(truth).map(|(f, t)| f * t).sum();
    if distance == 0.0 { (0.0, 1.0) } else { (distance / b, dot / (a * b).max(f64::MIN_POSITIVE)) }
}

fn judge(context: &Context<'_>, view: &View) -> Result<Outcome> {
    let (found, truth) = (view.on_device(context.gpu)?, view.truth()?);
    let mut checks = Vec::new();
    let mut least = 1.0_f64;
    let mut zeroed = 0;
    for (kind, device, exact) in kinds(&found, &truth) {
        let (distance, cosine) = compare(device, &exact);
        let distance = if device.iter().all(|v| v.is_finite()) { distance } else { f64::MAX };
        checks.push(Check::at_most(format!("relative L2 error of {kind}"), distance, MAX_RELATIVE_L2));
        least = least.min(cosine);
        let rms = norm(exact.iter().copied()) / (exact.len().max(1) as f64).sqrt();
        zeroed += device.iter().zip(&exact).filter(|(d, t)| **d == 0.0 && t.abs() > 1e-3 * rms).count();
    }
    let worst = |c: &Check| if c.value.is_finite() { c.value } else { f64::MAX };
    checks.sort_by(|a, b| worst(b).total_cmp(&worst(a)));
    checks.push(Check::at_least("least cosine with the truth", least, MIN_COSINE));
    checks.push(Check::exactly("gradients left out (0 where the truth is not)", zeroed, 0));
    let drawn = truth.splats.iter().filter(|s| s.pixels > 0.0).count();
    let truth = format!(
        "{drawn} of {} Gaussians have a gradient; ‖dL/d mean‖ = {:.3e}",
        view.scene.gaussians.len(),
        norm(truth.mean.as_flattened().iter().copied())
    );
    Ok(Outcome { truth, checks })
}
