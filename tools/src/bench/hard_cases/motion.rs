//! Cases 10 to 12 beyond single images: how far linear so(3) is from the geodesic, tables that must be refused, ties.

use engine::error::{Error, Result};
use engine::gpu::{Memory, Slice};
use engine::reference::{exp, exp_quaternion};
use engine::render::Renderer;
use engine::scene::Scene;
use engine::scene::synthetic::moving_scene;
use engine::train::association::{AssociationOptions, SuperpointState};
use glam::{DMat3, DVec3};

use super::case::{Case, Check, Context, Outcome};
use super::compare::{compare, usual_options};
use super::views;

pub(super) fn cases() -> Vec<Case> {
    let sweep = "Key rotations 0.5 rad apart at eight places from 0 to 2π, shown half-way.";
    let geodesic = "The same keys: rotation vectors interpolated linearly against the shortest way (f64 study).";
    let logarithm = "Exp and its logarithm in f64 for |θ| from 1e-300 to π − 1e-9.";
    let refused = "Key times that are repeated, unsorted, NaN or none; frames at NaN and infinite times.";
    let ties = "A lattice of 512 Gaussians, most of them equally far from several of 27 superpoints.";
    vec![
        Case::new(10, "rotation_sweep", sweep, judge_sweep),
        Case::new(10, "so3_lerp_against_geodesic", geodesic, |_| Ok(judge_geodesic())),
        Case::new(10, "exp_and_log", logarithm, |_| Ok(judge_exp_log())),
        Case::new(11, "refused_times", refused, judge_times),
        Case::new(12, "ties_of_distance", ties, judge_ties),
    ]
}

/// Superpoint j turns from angle j·π/4 to that + 0.5 about its own axis.
fn turning() -> Scene {
    let mut scene = moving_scene(400, 8, 2, 91, false);
    if let Some(motion) = scene.deformation.table_mut() {
        for (j, rotation) in motion.rotation.iter_mut().enumerate() {
            let angle = (j % 8) as f64 * std::f64::consts::FRAC_PI_4 + if j < 8 { 0.0 } else { 0.5 };
            *rotation = (axis(j % 8) * angle).as_vec3().to_array();
        }
        motion.translation.fill([0.0; 3]);
    }
    scene
}

fn axis(j: usize) -> DVec3 {
    DVec3::new((1.3 * j as f64).sin(), (0.7 * j as f64 + 1.0).cos(), 0.5).normalize()
}

fn judge_sweep(context: &Context<'_>) -> Result<Outcome> {
    Ok(compare(context.gpu, &turning(), &views::camera(96, 72), 0.5, &usual_options())?.outcome())
}

/// Angle of the rotation between two rotations, radians.
fn angle_between(a: DMat3, b: DMat3) -> f64 {
    let q = glam::DQuat::from_mat3(&(a.transpose() * b));
    2.0 * q.xyz().length().atan2(q.w.abs())
}

fn judge_geodesic() -> Outcome {
    let mut pairs = vec![("3.1 and −3.1 rad about one axis", DVec3::X * 3.1, DVec3::X * -3.1)];
    pairs.push(("0.5 rad apart about one axis", DVec3::X * 3.0, DVec3::X * 3.5));
    pairs.push(("0.5 rad about x and about y", DVec3::X * 0.5, DVec3::Y * 0.5));
    let checks = pairs.into_iter().map(|(name, a, b)| {
        let linear = exp(0.5 * (a + b));
        let middle = exp_quaternion(a).slerp(exp_quaternion(b), 0.5);
        Check::shown(
            format!("{name}: angle between them half-way, rad"),
            angle_between(linear, DMat3::from_quat(middle)),
        )
    });
    let truth = "the definition interpolates r linearly: exact about one axis, wrong by up to π where r changes sign";
    Outcome { truth: truth.into(), checks: checks.collect() }
}

fn judge_exp_log() -> Outcome {
    let angles = [1.0e-300, 1.0e-100, 1.0e-20, 1.0e-9, 1.0e-4, 0.0099, 0.0101, 1.0, 3.0, std::f64::consts::PI - 1.0e-9];
    let (mut round_trip, mut orthogonal) = (0.0_f64, 0.0_f64);
    for (j, angle) in angles.into_iter().enumerate() {
        let r = axis(j) * angle;
        let back = exp_quaternion(r).to_scaled_axis();
        let back = if angle < 1.0e-7 { 2.0 * exp_quaternion(r).xyz() } else { back };
        round_trip = round_trip.max((back - r).length() / angle);
        let m = exp(r);
        let rest = m.transpose() * m - DMat3::IDENTITY;
        orthogonal = orthogonal.max(rest.to_cols_array().into_iter().fold(0.0, |a, x| a.max(x.abs())));
    }
    Outcome {
        truth: "log(Exp(r)) = r and Exp(r)ᵀExp(r) = 1".into(),
        checks: vec![
            Check::at_most("largest relative error of log(Exp(r))", round_trip, 1.0e-7),
            Check::at_most("largest entry of Exp(r)ᵀExp(r) − 1", orthogonal, 1.0e-14),
        ],
    }
}

fn judge_times(context: &Context<'_>) -> Result<Outcome> {
    let temp = std::env::temp_dir();
    let folder = tempfile::tempdir().map_err(|e| Error::io(&temp, "create a folder in", e))?;
    let bad: [&[f32]; 4] = [&[0.0, 0.5, 0.5, 1.0], &[0.0, 0.7, 0.3, 1.0], &[0.0, f32::NAN, 0.5, 1.0], &[]];
    let mut accepted = 0;
    for times in bad {
        let mut scene = moving_scene(20, 3, 4, 92, false);
        if let Some(motion) = scene.deformation.table_mut() {
            motion.times = times.to_vec();
            motion.rotation.truncate(3 * times.len());
            motion.translation.truncate(3 * times.len());
        }
        accepted += usize::from(engine::file::save(&folder.path().join("model.safetensors"), &scene).is_ok());
    }
    let scene = moving_scene(20, 3, 4, 92, false);
    let mut renderer = Renderer::new(context.gpu, &scene, &usual_options())?;
    let camera = views::camera(16, 16);
    let drawn = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY].map(|t| renderer.render(&camera, t).is_ok());
    let works = renderer.render(&camera, 0.5).is_ok();
    Ok(Outcome {
        truth: "no image exists: each must be an error that names the place, and the renderer must go on".into(),
        checks: vec![
            Check::exactly("tables accepted", accepted, 0),
            Check::exactly("frames drawn at such times", drawn.iter().filter(|d| **d).count(), 0),
            Check::exactly("frames drawn afterwards at a good time", usize::from(works), 1),
        ],
    })
}

fn judge_ties(context: &Context<'_>) -> Result<Outcome> {
    let gpu = context.gpu;
    let mean: Vec<[f32; 3]> = (0..512).map(|i: u32| [i % 8, i / 8 % 8, i / 64].map(|v| v as f32 * 0.25)).collect();
    let planes: Vec<f32> = (0..3).flat_map(|c| mean.iter().map(move |m| m[c])).collect();
    let means = gpu.buffer_with("mean", bytemuck::cast_slice(&planes))?;
    let own = Slice::from(&gpu.buffer("superpoint_of_gaussian", 4 * mean.len() as u64, Memory::Device)?);
    let options = AssociationOptions { superpoints: 27, seed: 5, ..AssociationOptions::default() };
    let state = SuperpointState::init(gpu, &Slice::from(&means), &own, mean.len() as u32, options)?;
    let (superpoints, _) = state.download(gpu, &own)?;
    let square = |a: [f32; 3], b: [f32; 3]| (0..3).map(|c| f64::from(a[c] - b[c]).powi(2)).sum::<f64>();
    let (mut wrong, mut ties) = (0, 0);
    for (m, &found) in mean.iter().zip(&superpoints.of_gaussian) {
        let distances: Vec<f64> = superpoints.position.iter().map(|&p| square(*m, p)).collect();
        let least = distances.iter().copied().fold(f64::INFINITY, f64::min);
        ties += usize::from(distances.iter().filter(|&&d| d == least).count() > 1);
        wrong += usize::from(distances.iter().position(|&d| d == least) != Some(found as usize));
    }
    Ok(Outcome {
        truth: format!("{ties} of {} Gaussians have several nearest superpoints; the lowest index counts", mean.len()),
        checks: vec![
            Check::exactly("Gaussians assigned to another superpoint", wrong, 0),
            Check::at_least("Gaussians with ties in the test", ties as f64, 50.0),
        ],
    })
}
