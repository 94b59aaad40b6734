//! Random clouds for benches and tests, standing still or moving.

use glam::{DQuat, DVec3};

use super::Random;
use crate::scene::network::DeformSize;
use crate::scene::parameter::{Optional, PARAMETERS, REQUIRED, SMOOTHING};
use crate::scene::{Blend, DeformNetwork, Gaussians, Linear, Motion, Scene, SuperpointDeformation, Superpoints};

/// Number of Gaussians at which the standard deviations below cover the shells as a trained model would.
const NOMINAL_COUNT: f64 = 50_000.0;

/// `n` flat Gaussians scattered on four overlapping shells within about 1.3 units of the origin, with the spread of sizes
/// and opacities of a trained object: standard deviations log-normal around 0.014 (thickness 0.003) at 50,000 Gaussians and
/// shrinking with √n, opacity logits 0.7 ± 1.2, colours over the whole range, higher SH ± 0.05.
pub fn random_gaussians(n: usize, seed: u64, sh_degree: u32) -> Gaussians {
    let mut random = Random::new(seed);
    let shells: Vec<(DVec3, f64)> = (0..4).map(|_| (0.45 * random.normal3(), random.range(0.35, 0.7))).collect();
    let shrink = 0.5 * (NOMINAL_COUNT / n.max(1) as f64).ln();
    let mut gaussians = Gaussians { sh_degree: sh_degree.min(3), ..Gaussians::default() };
    let coefficients = gaussians.sh_coefficients();
    for _ in 0..n {
        let (center, radius) = shells[random.below(shells.len())];
        let normal = random.direction();
        let mean = (center + radius * normal).clamp(DVec3::splat(-1.25), DVec3::splat(1.25));
        let turn = DQuat::from_rotation_arc(DVec3::Z, normal) * DQuat::from_rotation_z(random.range(0.0, 6.2));
        let scale = [-4.27, -4.27, -5.88].map(|s| (s + shrink + 0.35 * random.normal()) as f32);
        gaussians.mean.push(mean.as_vec3().to_array());
        gaussians.log_scale.push(scale);
        gaussians.rotation.push([turn.w as f32, turn.x as f32, turn.y as f32, turn.z as f32]);
        gaussians.opacity_logit.push((0.7 + 1.2 * random.normal()).clamp(-4.0, 5.0) as f32);
        gaussians.sh.extend((0..3).map(|_| random.range(-1.7, 1.7) as f32));
        gaussians.sh.extend((3..3 * coefficients).map(|_| (0.05 * random.normal()) as f32));
    }
    gaussians
}

/// Every optional parameter of `n` Gaussians, around what it starts with.
pub fn random_optional(n: usize, seed: u64) -> Optional {
    let (mut random, mut made) = (Random::new(seed), Optional::default());
    for (parameter, p) in PARAMETERS.iter().enumerate().skip(REQUIRED) {
        let start = p.start.repeat(n).into_iter();
        // About as wide as the Gaussians: wider ones would hardly be seen.
        let size = if parameter == SMOOTHING { 0.015 } else { 1.0 };
        made.set(parameter, start.map(|start| start + (size * random.range(-1.0, 0.5)) as f32).collect());
    }
    made
}

/// [`random_gaussians`] as a scene that stands still.
pub fn random_scene(n: usize, seed: u64, sh_degree: u32) -> Scene {
    Scene { gaussians: random_gaussians(n, seed, sh_degree), ..Scene::default() }
}

/// [`random_gaussians`] of SH degree 3 that move: `m` superpoints (each Gaussian goes with the nearest centre), each
/// rocking by up to half a radian about its centre and drifting by up to 0.15 units, smoothly and once around over
/// t ∈ [0, 1], sampled at `t` key times. With `network` the scene also has a [`random_network`].
///
/// `m` and `t` are at least 1.
pub fn moving_scene(n: usize, m: usize, t: usize, seed: u64, network: bool) -> Scene {
    let gaussians = random_gaussians(n, seed, 3);
    let mut random = Random::new(seed ^ 0x5eed);
    let centers: Vec<DVec3> = (0..m.max(1))
        .map(|_| match n {
            0 => random.normal3(),
            _ => glam::Vec3::from_array(gaussians.mean[random.below(n)]).as_dvec3(),
        })
        .collect();
    let superpoints = Superpoints {
        of_gaussian: gaussians.mean.iter().map(|&mean| nearest(&centers, mean)).collect(),
        position: centers.iter().map(|c| c.as_vec3().to_array()).collect(),
    };
    let deformation = SuperpointDeformation {
        superpoints,
        table: Some(rocking(&centers, t.max(1), &mut random)),
        network: network.then(|| random_network(seed)),
        ..SuperpointDeformation::default()
    };
    Scene { gaussians, deformation: deformation.into(), ..Scene::default() }
}

fn nearest(centers: &[DVec3], mean: [f32; 3]) -> u32 {
    let mean = glam::Vec3::from_array(mean).as_dvec3();
    let distances = centers.iter().map(|c| c.distance_squared(mean)).enumerate();
    distances.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(i, _)| i as u32)
}

fn rocking(centers: &[DVec3], t: usize, random: &mut Random) -> Motion {
    let swings: Vec<(DVec3, DVec3, f64)> =
        centers.iter().map(|_| (0.5 * random.direction(), 0.15 * random.direction(), random.uniform())).collect();
    let mut motion = Motion::default();
    for k in 0..t {
        let time = k as f64 / (t - 1).max(1) as f64;
        motion.times.push(time as f32);
        for (&center, &(axis, drift, phase)) in centers.iter().zip(&swings) {
            let swing = (std::f64::consts::TAU * (time + phase)).sin();
            let rotation = axis * swing;
            let translation = center + drift * swing - DQuat::from_scaled_axis(rotation) * center;
            motion.rotation.push(rotation.as_vec3().to_array());
            motion.translation.push(translation.as_vec3().to_array());
        }
    }
    motion
}

/// Network F with random weights whose output moves superpoints by about 0.05 units and radians, smoothly in time and
/// space: weights keep the variance through the ReLU layers, and those of the encoding's frequency 2^k are divided by 2^k
/// (a trained F is as smooth).
pub fn random_network(seed: u64) -> DeformNetwork {
    let mut random = Random::new(seed ^ 0xf);
    let size = DeformSize::PAPER;
    let linear = (0..size.layers)
        .map(|i| {
            let inputs = size.layer_inputs(i);
            let encoded = inputs % size.width;
            layer(inputs, size.width, (2.0 / inputs as f64).sqrt(), encoded, &mut random)
        })
        .collect();
    let head = 0.05 / (size.width as f64).sqrt();
    DeformNetwork {
        linear,
        translation: layer(size.width, 3, head, 0, &mut random),
        rotation: layer(size.width, 3, head, 0, &mut random),
    }
}

/// Normal weights of deviation `deviation`; the first `encoded` inputs are the positional encoding.
fn layer(inputs: usize, outputs: usize, deviation: f64, encoded: usize, random: &mut Random) -> Linear {
    let damping = |column: usize| if column < encoded { 0.5f64.powi(octave(column) as i32) } else { 1.0 };
    let weight = (0..outputs * inputs).map(|i| (deviation * damping(i % inputs) * random.normal()) as f32).collect();
    Linear { inputs, outputs, weight, bias: (0..outputs).map(|_| (0.05 * random.normal()) as f32).collect() }
}

/// k of the frequency 2^k of an encoding column (0 for the plain inputs).
fn octave(column: usize) -> usize {
    match column {
        0..3 => 0,
        3..63 => (column - 3) / 6,
        63 => 0,
        _ => (column - 64) / 2,
    }
}

/// Soft superpoints of `n` Gaussians, `neighbors` of `m` for each, with weights of any sum: some 0, some equal.
pub fn random_blend(n: usize, m: usize, neighbors: usize, seed: u64) -> Blend {
    let mut random = Random::new(seed);
    let mut weight = |slot: usize| match random.below(6) {
        0 if slot > 0 => 0.0,
        1 => 0.5,
        _ => random.range(0.01, 2.0) as f32,
    };
    let weight = (0..n * neighbors).map(|at| weight(at % neighbors)).collect();
    let mut random = Random::new(seed + 1);
    Blend { neighbors, index: (0..n * neighbors).map(|_| random.below(m) as u32).collect(), weight }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::scene::Rejected;
    use crate::scene::network::ENCODING_WIDTH;

    #[test]
    fn clouds_are_valid_and_reproducible() {
        for degree in 0..4 {
            let g = random_gaussians(300, 5, degree);
            assert_eq!((g.len(), g.sh.len()), (300, 300 * 3 * g.sh_coefficients()));
            let mut rejected = Rejected::default();
            assert!((0..300).all(|i| g.is_valid(i, &mut rejected)));
            assert_eq!(g, random_gaussians(300, 5, degree));
            assert_ne!(g, random_gaussians(300, 6, degree));
        }
    }

    #[test]
    fn moving_scene_has_consistent_arrays() {
        let scene = moving_scene(200, 7, 5, 1, true);
        let deformation = scene.deformation.superpoint_deformation().unwrap().clone();
        let (superpoints, motion) = (deformation.superpoints, deformation.table.unwrap());
        assert!(superpoints.of_gaussian.iter().all(|&m| m < 7));
        assert_eq!((superpoints.of_gaussian.len(), superpoints.position.len()), (200, 7));
        assert_eq!((motion.times.len(), motion.rotation.len(), motion.translation.len()), (5, 35, 35));
        assert!(motion.times.windows(2).all(|w| w[0] < w[1]));
        let network = deformation.network.unwrap();
        for (i, layer) in network.linear.iter().enumerate() {
            assert_eq!(layer.inputs, DeformSize::PAPER.layer_inputs(i));
            assert_eq!((layer.weight.len(), layer.bias.len()), (layer.inputs * 256, 256));
        }
        assert_eq!(octave(ENCODING_WIDTH - 1), 5);
        assert_eq!((octave(62), octave(3), octave(9)), (9, 0, 1));
        assert_eq!(moving_scene(0, 0, 0, 1, false).deformation.key_times(), [0.0]);
    }
}
