#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use glam::{DMat3, DQuat, DVec2, DVec3};

use super::image::{Gradients, image_gradients, visible_splats};
use super::motion::left_jacobian;
use super::project::View;
use super::splats::{SplatGradient, Upstream, contributions};
use crate::reference::{
    Blend64, DeformationAt, Gaussians64, Offset, Pose, ReferenceOptions, exp, exp_quaternion, render_deformed,
};
use crate::scene::parameter::Optional;
use crate::scene::synthetic::{Random, random_optional};
use crate::scene::{Camera, heaviest_slot};

const GAUSSIANS: usize = 10;
const SUPERPOINTS: usize = 3;
/// Random pairs of a parameter and a scene, per kind of parameter.
const PAIRS: usize = 500;

/// A small random scene with everything that can move it, and a random dL/d image.
#[derive(Clone)]
struct Case {
    gaussians: Gaussians64,
    group: Vec<u32>,
    blend: Option<Blend64>,
    poses: Option<Vec<Pose>>,
    offsets: Option<Vec<Offset>>,
    camera: Camera,
    options: ReferenceOptions,
    color: Vec<f64>,
    alpha: Vec<f64>,
}

fn fill<const W: usize>(r: &mut Random, low: f64, high: f64) -> [f64; W] {
    std::array::from_fn(|_| r.range(low, high))
}

impl Case {
    fn random(seed: u64, moving: bool, nonrigid: bool) -> Self {
        let mut r = Random::new(seed);
        let n = GAUSSIANS;
        let sh_degree = (seed % 4) as u32;
        let sh = 3 * ((sh_degree + 1) * (sh_degree + 1)) as usize;
        let gaussians = Gaussians64 {
            mean: (0..n).map(|_| fill(&mut r, -1.0, 1.0)).collect(),
            log_scale: (0..n).map(|_| fill(&mut r, -3.5, -0.7)).collect(),
            rotation: (0..n).map(|_| fill(&mut r, -1.5, 1.5)).collect(),
            opacity_logit: (0..n).map(|_| r.range(-2.0, 5.5)).collect(),
            sh_degree,
            sh: (0..n * sh).map(|_| r.range(-0.7, 0.7)).collect(),
            optional: if moving { random_optional(n, seed).map(f64::from) } else { Optional::default() },
            antialiased: seed % 3 == 2,
        };
        let pose = |r: &mut Random| {
            let scale = [1.0e-9, 1.0e-3, 0.3, 2.0][r.below(4)];
            Pose { rotation: r.normal3() * scale, translation: r.normal3() * 0.3 }
        };
        let offset = |r: &mut Random| Offset {
            mean: fill(r, -0.2, 0.2),
            rotation: fill(r, -0.4, 0.4),
            scale: fill(r, -0.02, 0.1),
        };
        let mut camera = Camera::look_at(r.direction() * 3.5, r.normal3() * 0.2, DVec3::Z, 0.7, [16, 12]);
        camera.cx += r.range(-2.0, 2.0);
        camera.fy *= r.range(0.9, 1.3);
        let pixels = (camera.width * camera.height) as usize;
        Self {
            gaussians,
            group: (0..n).map(|_| r.below(SUPERPOINTS) as u32).collect(),
            blend: None,
            poses: moving.then(|| (0..SUPERPOINTS).map(|_| pose(&mut r)).collect()),
            offsets: nonrigid.then(|| (0..n).map(|_| offset(&mut r)).collect()),
            camera,
            options: ReferenceOptions { background: [0.2, 0.5, 0.9], ..ReferenceOptions::default() },
            color: (0..3 * pixels).map(|_| r.range(-1.0, 1.0)).collect(),
            alpha: (0..pixels).map(|_| r.range(-1.0, 1.0)).collect(),
        }
    }

    /// The same with soft superpoints, 1 to 4 of them: in some slots the same one twice, or no weight.
    fn soft(self, seed: u64) -> Self {
        let mut r = Random::new(seed + 9000);
        let neighbors = 1 + (seed % 4) as usize;
        let slots = GAUSSIANS * neighbors;
        let mut weight: Vec<f64> = (0..slots).map(|_| if r.below(8) == 0 { 0.0 } else { r.range(0.05, 1.0) }).collect();
        for row in weight.chunks_exact_mut(neighbors) {
            row[0] += 0.01;
            let sum: f64 = row.iter().sum();
            row.iter_mut().for_each(|w| *w /= sum);
        }
        let index = (0..slots).map(|_| r.below(SUPERPOINTS) as u32).collect();
        Self { blend: Some(Blend64 { neighbors, index, weight }), ..self }
    }

    fn deformation(&self) -> DeformationAt<'_> {
        DeformationAt {
            group: &self.group,
            blend: self.blend.as_ref(),
            poses: self.poses.as_deref(),
            offsets: self.offsets.as_deref(),
            time: 0.4,
        }
    }

    fn loss(&self) -> f64 {
        let image = render_deformed(&self.gaussians, &self.deformation(), &self.camera, &self.options).unwrap();
        let sum = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        sum(&image.rgb, &self.color) + sum(&image.alpha, &self.alpha)
    }

    fn gradients(&self) -> Gradients {
        let upstream = Upstream { color: &self.color, alpha: Some(&self.alpha) };
        image_gradients(&self.gaussians, &self.deformation(), &self.camera, &self.options, &upstream).unwrap()
    }

    /// Everything that decides which smooth piece of the function this is: what every pixel blends, in which order, which α
    /// and colours are clamped, and which tangents.
    fn piece(&self) -> Vec<u32> {
        let splats = visible_splats(&self.gaussians, &self.deformation(), &self.camera, &self.options).unwrap();
        let all: Vec<u32> = (0..splats.len() as u32).collect();
        let view = View::from(&self.camera);
        let mut piece = Vec::new();
        if let Some(blend) = &self.blend {
            piece.extend(blend.weight.chunks(blend.neighbors).map(|w| heaviest_slot(w) as u32));
        }
        for splat in &splats {
            let slope = (splat.mean - DVec2::new(self.camera.cx, self.camera.cy)) / view.focal;
            let clamps = [slope.x < view.tangent[0], slope.x > view.tangent[1], slope.y < view.tangent[2]];
            piece.push(splat.index as u32);
            piece.extend(clamps.map(u32::from));
            piece.push(u32::from(slope.y > view.tangent[3]));
            piece.extend(splat.color.map(|c| u32::from(c > 0.0)));
        }
        for y in 0..self.camera.height {
            for x in 0..self.camera.width {
                let found = contributions(&splats, &all, DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
                piece.extend(found.iter().map(|c| 2 * c.splat + u32::from(c.clamped)));
                piece.push(u32::MAX);
            }
        }
        piece
    }
}

/// The 4-point central difference of the loss along one parameter, and a bound of its own rounding error; `None` when a
/// point of the stencil lies on another smooth piece.
fn difference(case: &Case, at: &dyn Fn(&mut Case) -> &mut f64, step: f64) -> Option<(f64, f64)> {
    let here = case.piece();
    let mut values = [0.0; 4];
    for (value, factor) in values.iter_mut().zip([-2.0, -1.0, 1.0, 2.0]) {
        let mut moved = case.clone();
        *at(&mut moved) += factor * step;
        if moved.piece() != here {
            return None;
        }
        *value = moved.loss();
    }
    let size = values.iter().fold(1.0_f64, |a, b| a.max(b.abs()));
    let slope = (8.0 * (values[2] - values[1]) - (values[3] - values[0])) / (12.0 * step);
    Some((slope, 40.0 * f64::EPSILON * size / step))
}

/// Compares PAIRS random pairs of one kind of parameter. Pairs whose stencil crosses a threshold (α at 1/255 or 0.99, the
/// stop at T = 1e-4, a clamp, the order in depth) are left out, and so are those with a gradient of exactly 0 on both
/// sides, which would prove nothing.
fn check(
    kind: &str,
    moving: bool,
    nonrigid: bool,
    choose: fn(&mut Random, &Case) -> usize,
    value: fn(&mut Case, usize) -> &mut f64,
    gradient: fn(&Gradients, usize) -> f64,
) {
    check_of(kind, &|seed| Case::random(seed, moving, nonrigid), choose, value, gradient);
}

/// [`check`] in scenes of a kind, by their seeds.
fn check_of(
    kind: &str,
    scene: &dyn Fn(u64) -> Case,
    choose: fn(&mut Random, &Case) -> usize,
    value: fn(&mut Case, usize) -> &mut f64,
    gradient: fn(&Gradients, usize) -> f64,
) {
    let mut random = Random::new(kind.len() as u64 + 7);
    let (mut done, mut worst, mut seed) = (0, 0.0_f64, 0);
    while done < PAIRS {
        seed += 1;
        assert!(seed < 2000, "{kind}: only {done} pairs");
        let case = scene(seed);
        let gradients = case.gradients();
        for _ in 0..6 {
            let index = choose(&mut random, &case);
            let found = gradient(&gradients, index);
            let step = 2.0e-4;
            let Some((expected, noise)) = difference(&case, &|c| value(c, index), step) else {
                continue;
            };
            if found == 0.0 && expected.abs() <= noise {
                continue;
            }
            // Truncation of the stencil is of order step⁴: halve it until both agree, or rounding takes over.
            let relative = |expected: f64| (found - expected).abs() / expected.abs().max(found.abs()).max(1.0e-3);
            let mut error = relative(expected);
            if error > 1.0e-7
                && let Some((finer, _)) = difference(&case, &|c| value(c, index), 0.25 * step)
            {
                error = error.min(relative(finer));
            }
            assert!(error <= 1.0e-6, "{kind} [{index}], scene {seed}: {found} {expected}, error {error:e}");
            worst = worst.max(error);
            done += 1;
        }
    }
}

fn any(r: &mut Random, count: usize) -> usize {
    r.below(count)
}

#[test]
fn mean_agrees_with_differences() {
    for (moving, nonrigid) in [(false, false), (true, true)] {
        let kind = if moving { "mean, moving" } else { "mean" };
        let choose = |r: &mut Random, _: &Case| any(r, 3 * GAUSSIANS);
        check(kind, moving, nonrigid, choose, |c, i| &mut c.gaussians.mean[i / 3][i % 3], |g, i| g.mean[i / 3][i % 3]);
    }
}

#[test]
fn rotation_agrees_with_differences() {
    for (moving, nonrigid) in [(false, false), (true, true)] {
        let kind = if moving { "rotation, moving" } else { "rotation" };
        let choose = |r: &mut Random, _: &Case| any(r, 4 * GAUSSIANS);
        let value: fn(&mut Case, usize) -> &mut f64 = |c, i| &mut c.gaussians.rotation[i / 4][i % 4];
        check(kind, moving, nonrigid, choose, value, |g, i| g.rotation[i / 4][i % 4]);
    }
}

#[test]
fn log_scale_agrees_with_differences() {
    for (moving, nonrigid) in [(false, false), (true, true)] {
        let kind = if moving { "log_scale, moving" } else { "log_scale" };
        let choose = |r: &mut Random, _: &Case| any(r, 3 * GAUSSIANS);
        let value: fn(&mut Case, usize) -> &mut f64 = |c, i| &mut c.gaussians.log_scale[i / 3][i % 3];
        check(kind, moving, nonrigid, choose, value, |g, i| g.log_scale[i / 3][i % 3]);
    }
}

#[test]
fn opacity_logit_agrees_with_differences() {
    let choose = |r: &mut Random, _: &Case| any(r, GAUSSIANS);
    check("opacity_logit", false, false, choose, |c, i| &mut c.gaussians.opacity_logit[i], |g, i| g.opacity_logit[i]);
}

#[test]
fn sh_agrees_with_differences() {
    let choose = |r: &mut Random, c: &Case| any(r, c.gaussians.sh.len());
    check("sh", true, false, choose, |c, i| &mut c.gaussians.sh[i], |g, i| g.sh[i]);
}

#[test]
fn optional_parameters_agree_with_differences() {
    let choose = |r: &mut Random, c: &Case| any(r, c.gaussians.optional.numbers().count());
    let value: fn(&mut Case, usize) -> &mut f64 = |c, i| c.gaussians.optional.numbers_mut().nth(i).unwrap();
    check("optional", true, false, choose, value, |g, i| g.optional.numbers().nth(i).unwrap());
}

#[test]
fn superpoint_poses_agree_with_differences() {
    let choose = |r: &mut Random, _: &Case| any(r, 3 * SUPERPOINTS);
    for nonrigid in [false, true] {
        check(
            if nonrigid { "superpoint rotation, G" } else { "superpoint rotation" },
            true,
            nonrigid,
            choose,
            |c, i| &mut c.poses.as_mut().unwrap()[i / 3].rotation[i % 3],
            |g, i| g.poses[i / 3].rotation[i % 3],
        );
    }
    check(
        "superpoint translation",
        true,
        false,
        choose,
        |c, i| &mut c.poses.as_mut().unwrap()[i / 3].translation[i % 3],
        |g, i| g.poses[i / 3].translation[i % 3],
    );
}

#[test]
fn nonrigid_offsets_agree_with_differences() {
    let three = |r: &mut Random, _: &Case| any(r, 3 * GAUSSIANS);
    let four = |r: &mut Random, _: &Case| any(r, 4 * GAUSSIANS);
    let mean: fn(&mut Case, usize) -> &mut f64 = |c, i| &mut c.offsets.as_mut().unwrap()[i / 3].mean[i % 3];
    check("dx", true, true, three, mean, |g, i| g.offsets[i / 3].mean[i % 3]);
    let rotation: fn(&mut Case, usize) -> &mut f64 = |c, i| &mut c.offsets.as_mut().unwrap()[i / 4].rotation[i % 4];
    check("dq", true, true, four, rotation, |g, i| g.offsets[i / 4].rotation[i % 4]);
    let scale: fn(&mut Case, usize) -> &mut f64 = |c, i| &mut c.offsets.as_mut().unwrap()[i / 3].scale[i % 3];
    check("ds", true, true, three, scale, |g, i| g.offsets[i / 3].scale[i % 3]);
}

#[test]
fn soft_superpoints_agree_with_differences() {
    let rigid = |seed: u64| Case::random(seed, true, false).soft(seed);
    let nonrigid = |seed: u64| Case::random(seed, true, true).soft(seed);
    let three = |r: &mut Random, _: &Case| any(r, 3 * GAUSSIANS);
    let mean: fn(&mut Case, usize) -> &mut f64 = |c, i| &mut c.gaussians.mean[i / 3][i % 3];
    check_of("mean, soft", &rigid, three, mean, |g, i| g.mean[i / 3][i % 3]);
    let own: fn(&mut Case, usize) -> &mut f64 = |c, i| &mut c.gaussians.rotation[i / 4][i % 4];
    check_of("rotation, soft", &nonrigid, |r, _| any(r, 4 * GAUSSIANS), own, |g, i| g.rotation[i / 4][i % 4]);
    let of_pose = |r: &mut Random, _: &Case| any(r, 3 * SUPERPOINTS);
    let rotation: fn(&mut Case, usize) -> &mut f64 = |c, i| &mut c.poses.as_mut().unwrap()[i / 3].rotation[i % 3];
    for scene in [&rigid as &dyn Fn(u64) -> Case, &nonrigid] {
        check_of("superpoint rotation, soft", scene, of_pose, rotation, |g, i| g.poses[i / 3].rotation[i % 3]);
    }
    let shift: fn(&mut Case, usize) -> &mut f64 = |c, i| &mut c.poses.as_mut().unwrap()[i / 3].translation[i % 3];
    check_of("superpoint translation, soft", &rigid, of_pose, shift, |g, i| g.poses[i / 3].translation[i % 3]);
    let slot = |r: &mut Random, c: &Case| any(r, c.blend.as_ref().unwrap().weight.len());
    let weight: fn(&mut Case, usize) -> &mut f64 = |c, i| &mut c.blend.as_mut().unwrap().weight[i];
    for scene in [&rigid as &dyn Fn(u64) -> Case, &nonrigid] {
        check_of("weight", scene, slot, weight, |g, i| g.blend_weight[i]);
    }
}

/// One superpoint for each Gaussian, said as a blend, moves and has gradients to the last bit as without.
#[test]
fn a_blend_of_one_superpoint_is_hard() {
    for seed in 0..20 {
        let hard = Case::random(seed, true, seed % 2 == 0);
        let index: Vec<u32> = hard.group.iter().flat_map(|&j| [1, j]).collect();
        let weight = [0.0, 1.0].repeat(GAUSSIANS);
        let one = Blend64 { neighbors: 1, index: hard.group.clone(), weight: vec![1.0; GAUSSIANS] };
        let two = Blend64 { neighbors: 2, index, weight };
        let expected = hard.gradients();
        let mut found = Case { blend: Some(one), ..hard.clone() }.gradients();
        found.blend_weight.clear();
        assert_eq!(found, expected, "scene {seed}");
        let zero_and_one = Case { blend: Some(two), ..hard.clone() };
        assert_eq!(zero_and_one.loss().to_bits(), hard.loss().to_bits(), "scene {seed}");
        assert_eq!(zero_and_one.gradients().mean, expected.mean, "scene {seed}");
    }
}

#[test]
fn tangents_outside_the_image_are_exercised_and_agree() {
    // Large Gaussians beside the image: their centres are beyond the clamp, their tails inside.
    let mut checked = 0;
    for seed in 0..40 {
        let mut case = Case::random(seed, false, false);
        for (i, mean) in case.gaussians.mean.iter_mut().enumerate() {
            let side = case.camera.rotation.transpose() * DVec3::new(if i % 2 == 0 { 2.0 } else { -2.1 }, 0.1, 0.0);
            *mean = (DVec3::from_array(*mean) * 0.2 + side).to_array();
        }
        case.gaussians.log_scale.iter_mut().flatten().for_each(|s| *s = s.max(-1.2));
        let gradients = case.gradients();
        for i in 0..GAUSSIANS {
            for c in 0..3 {
                let Some((expected, _)) = difference(&case, &|k| &mut k.gaussians.mean[i][c], 5.0e-5) else { continue };
                let found = gradients.mean[i][c];
                let error = (found - expected).abs() / expected.abs().max(1.0e-2);
                assert!(error < 1.0e-6, "scene {seed}, mean [{i}][{c}]: {found} {expected}");
                checked += usize::from(found != 0.0);
            }
        }
    }
    assert!(checked > 300, "{checked}");
}

#[test]
fn clamped_alpha_colour_and_scale_pass_no_gradient() {
    let mut case = Case::random(1, false, true);
    let clean = case.gradients();
    let size = |i: &usize| clean.log_scale[*i][1].abs();
    let drawn = (0..GAUSSIANS).max_by(|a, b| size(a).total_cmp(&size(b))).unwrap();
    case.offsets.as_mut().unwrap()[drawn].scale[0] = -9.0;
    let gradients = case.gradients();
    assert_eq!((gradients.log_scale[drawn][0], gradients.offsets[drawn].scale[0]), (0.0, 0.0));
    assert!(gradients.log_scale[drawn][1] != 0.0);

    // One huge opaque Gaussian in front of everything: α is clamped at every pixel.
    let mut case = Case::random(1, false, false);
    case.gaussians.mean[0] = (case.camera.position * 0.5).to_array();
    case.gaussians.log_scale[0] = [5.0; 3];
    case.gaussians.opacity_logit[0] = 9.0;
    let values = case.gaussians.sh.len() / GAUSSIANS;
    case.gaussians.sh[..values].fill(0.0);
    case.gaussians.sh[0] = -5.0;
    let gradients = case.gradients();
    assert_eq!(gradients.opacity_logit[0], 0.0);
    assert_eq!(gradients.mean[0], [0.0; 3]);
    assert_eq!(gradients.sh[0], 0.0, "red is clamped at 0");
    assert!(gradients.sh[1] != 0.0, "green is not");
}

#[test]
fn a_sphere_has_no_rotation_gradient() {
    let mut case = Case::random(2, true, false);
    case.gaussians.log_scale.iter_mut().for_each(|s| *s = [s[0]; 3]);
    assert!(case.gradients().rotation.iter().flatten().all(|&g| g == 0.0));
}

#[test]
fn left_jacobian_is_the_derivative_of_exp() {
    let mut random = Random::new(5);
    for magnitude in [0.0, 1.0e-12, 1.0e-4, 0.49, 0.51, 2.0, 3.1, 9.0] {
        let r = random.direction() * magnitude;
        let jacobian = left_jacobian(r);
        for axis in 0..3 {
            let step = 1.0e-5;
            let mut change = DVec3::ZERO;
            change[axis] = step;
            // log of Exp(r + δ)Exp(r − δ)⁻¹ ≈ 2 J δ.
            let turn = exp_quaternion(r + change) * exp_quaternion(r - change).conjugate();
            let found = turn.to_scaled_axis() / (2.0 * step);
            assert!((found - jacobian.col(axis)).length() < 1.0e-9, "{magnitude} {axis}");
        }
    }
}

#[test]
fn the_quaternion_of_exp_is_exp() {
    let mut random = Random::new(6);
    for magnitude in [0.0, 1.0e-9, 0.01, 1.0, 3.0, 7.0] {
        let r = random.direction() * magnitude;
        let difference = exp(r) - DMat3::from_quat(exp_quaternion(r));
        assert!(difference.to_cols_array().iter().all(|x| x.abs() < 1.0e-14), "{magnitude}");
        assert!((exp_quaternion(r).w - (0.5 * magnitude).cos()).abs() < 1.0e-15);
        assert!((exp_quaternion(r).length() - DQuat::IDENTITY.length()).abs() < 1.0e-15);
    }
}

#[test]
fn rows_of_the_kernels_carry_the_same_sums() {
    let (first, second, color, absolute) = ([1.5, -0.25], [2.0, -1.0, 3.0], [0.1, 0.2, 0.3], [4.0, 2.5]);
    let gradient = SplatGradient { h: 0.5, first, second, color, pixels: 7.0, absolute };
    let back = SplatGradient::from_row(gradient.row());
    assert!((back.first[0] - 1.5).abs() < 1.0e-6 && (back.second[2] - 3.0).abs() < 1.0e-6);
    assert_eq!(back.pixels, 7.0);
    assert!((back.absolute[0] - 4.0).abs() < 1.0e-6 && (back.absolute[1] - 2.5).abs() < 1.0e-6);
    // κ² = log₂e / 2: u of the kernels squares to the exponent in powers of two.
    assert!((f64::from(gradient.row()[3]) - 2.0 * 0.5 * std::f64::consts::LOG2_E).abs() < 1.0e-6);
}
