//! Deformation fields (Deformable-3DGS, 4D-GS, SC-GS) in f64, their f32 weights taken as exact numbers.

use glam::{DQuat, DVec3};
use rayon::prelude::*;

use super::motion::Offset;
use super::network::{Dense, Perceptron, encode};
use crate::scene::field::{
    ControlNodes, DeformationField, FIELD_PAIRS, FIELD_TIME_OCTAVES, FieldInput, FieldPlane, FieldPlanes, FieldRule,
};
use crate::scene::{Gaussians, Linear};

/// Smallest |w| of a screw whose direction is known; below it the centre moves by v.
const MIN_ANGLE: f64 = 1.0e-12;
/// What the released code adds to each component of a screw's unit axis and moment.
const SCREW_EPSILON: f64 = 1.0e-5;

/// Offsets of all Gaussians at `time`: μ + `mean`, norm(norm(q) + `rotation`), exp(log_scale) + `scale`, whatever the field's
/// rule ([`FieldRule`]) says in its own terms.
pub fn field_offsets(field: &DeformationField, gaussians: &Gaussians, time: f64) -> Vec<Offset> {
    match &field.nodes {
        Some(nodes) => node_offsets(field, nodes, gaussians, time),
        None => {
            let outputs = outputs(field, &gaussians.mean, time);
            let one = |(i, output): (usize, &Vec<f64>)| offset(field.rule(), gaussians, i, output);
            outputs.par_iter().enumerate().map(one).collect()
        }
    }
}

/// Outputs of the head at all points.
fn outputs(field: &DeformationField, points: &[[f32; 3]], time: f64) -> Vec<Vec<f64>> {
    let layers: Vec<Dense> = field.all_layers().map(|l| Dense::joined(&[l])).collect();
    let perceptron = Perceptron { layers, skip: field.skip_layer() };
    let seen = Seen::new(&field.input, time);
    points.par_iter().map(|p| perceptron.trace(&seen.of(p.map(f64::from))).output).collect()
}

/// The input of the perceptron, as far as only time decides.
enum Seen<'a> {
    /// Octaves of the point, and what stands for the time.
    Waves(usize, Vec<f64>),
    Planes(&'a FieldPlanes, f64),
}

impl<'a> Seen<'a> {
    fn new(input: &'a FieldInput, time: f64) -> Self {
        match input {
            FieldInput::Planes(planes) => Self::Planes(planes, time),
            FieldInput::Waves { octaves, time: network } => {
                let mut code = Vec::new();
                encode(&[time], FIELD_TIME_OCTAVES[usize::from(network.is_some())], &mut code);
                Self::Waves(
                    *octaves,
                    network.as_ref().map_or_else(|| code.clone(), |network| time_code(network, &code)),
                )
            }
        }
    }

    fn of(&self, point: [f64; 3]) -> Vec<f64> {
        match self {
            Self::Waves(octaves, code) => {
                let mut values = Vec::new();
                encode(&point, *octaves, &mut values);
                values.extend(code);
                values
            }
            Self::Planes(planes, time) => features(planes, point, *time),
        }
    }
}

fn time_code(network: &[Linear; 2], code: &[f64]) -> Vec<f64> {
    let [first, second] = network;
    Perceptron { layers: vec![Dense::joined(&[first]), Dense::joined(&[second])], skip: None }.trace(code).output
}

/// At each resolution the product of the six planes.
fn features(planes: &FieldPlanes, point: [f64; 3], time: f64) -> Vec<f64> {
    let [low, high] = planes.bounds.map(|b| b.map(f64::from));
    let share = |a: usize| (point[a] - low[a]) * 2.0 / (high[a] - low[a]) - 1.0;
    let place = [share(0), share(1), share(2), time];
    let of_scale = |scale: &[FieldPlane; 6]| {
        let taps = FIELD_PAIRS.map(|[column, row]| [place[column], place[row]]);
        let value = |c: usize| scale.iter().zip(&taps).map(|(plane, at)| bilinear(plane, c, *at)).product::<f64>();
        (0..planes.channels).map(value).collect::<Vec<f64>>()
    };
    planes.scales.iter().flat_map(of_scale).collect()
}

/// Between −1 (the first value) and 1 (the last), held outside.
fn bilinear(plane: &FieldPlane, channel: usize, [x, y]: [f64; 2]) -> f64 {
    let along = |v: f64, size: usize| {
        let last = (size - 1) as f64;
        let place = ((v + 1.0) * 0.5 * last).clamp(0.0, last);
        (place as usize, (place as usize + 1).min(size - 1), place.fract())
    };
    let ((x0, x1, wx), (y0, y1, wy)) = (along(x, plane.width), along(y, plane.height));
    let at = |y: usize, x: usize| f64::from(plane.values[(channel * plane.height + y) * plane.width + x]);
    let row = |y: usize| at(y, x0) * (1.0 - wx) + at(y, x1) * wx;
    row(y0) * (1.0 - wy) + row(y1) * wy
}

/// The outputs for Gaussian `i` as an offset.
fn offset(rule: FieldRule, g: &Gaussians, i: usize, output: &[f64]) -> Offset {
    let first = if rule == FieldRule::Screw { 6 } else { 3 };
    let rotation: [f64; 4] = std::array::from_fn(|c| output[first + c]);
    let scale: [f64; 3] = std::array::from_fn(|a| output[first + 4 + a]);
    match rule {
        FieldRule::Added => Offset { mean: [output[0], output[1], output[2]], rotation, scale },
        FieldRule::Screw => {
            let mean = screw(DVec3::from_slice(output), DVec3::from_slice(&output[3..]), promote(g.mean[i]));
            Offset { mean: mean.to_array(), rotation, scale }
        }
        FieldRule::Raw => Offset {
            mean: [output[0], output[1], output[2]],
            rotation: rotation.map(|c| c / length(g.rotation[i])),
            scale: std::array::from_fn(|a| f64::from(g.log_scale[i][a]).exp() * scale[a].exp_m1()),
        },
    }
}

/// exp(θ (ŵ, v̂)) x − x, θ = |w|, ŵ = w/θ + 10⁻⁵, v̂ = v/θ + 10⁻⁵ in every component, which is what the released code of
/// Deformable-3DGS (6-DoF) does: R = I + sinθ W + (1 − cosθ) W², p = (θ I + (1 − cosθ) W + (θ − sinθ) W²) v̂.
fn screw(w: DVec3, v: DVec3, x: DVec3) -> DVec3 {
    let theta = w.length();
    if theta < MIN_ANGLE {
        return v;
    }
    let (axis, moment) = (w / theta + SCREW_EPSILON, v / theta + SCREW_EPSILON);
    let (sine, cosine) = theta.sin_cos();
    let turned = |p: DVec3| axis.cross(p);
    let twice = |p: DVec3| turned(turned(p));
    let rotated = sine * turned(x) + (1.0 - cosine) * twice(x);
    rotated + theta * moment + (1.0 - cosine) * turned(moment) + (theta - sine) * twice(moment)
}

/// Each Gaussian follows its nodes: the centre by Σ w·Δ, or, where nodes turn, to Σ w·(R(x − n) + n + Δ); Σ w·Δq is added to
/// the quaternion as it is stored, Σ w·Δs to the scale.
fn node_offsets(field: &DeformationField, nodes: &ControlNodes, g: &Gaussians, time: f64) -> Vec<Offset> {
    let outputs = outputs(field, &nodes.position, time);
    let turn = ControlNodes::turn(field.head.outputs);
    let of_gaussian = |i: usize| {
        let x = promote(g.mean[i]);
        let (mut mean, mut rotation, mut scale) = (DVec3::ZERO, [0.0; 4], [0.0; 3]);
        for e in i * nodes.neighbors..(i + 1) * nodes.neighbors {
            let (j, weight) = (nodes.neighbor[e] as usize, f64::from(nodes.weight[e]));
            let (node, output) = (promote(nodes.position[j]), &outputs[j]);
            let around = if turn { local_turn(&output[10..]) * (x - node) - (x - node) } else { DVec3::ZERO };
            mean += weight * (DVec3::from_slice(output) + around);
            (0..4).for_each(|c| rotation[c] += weight * output[3 + c]);
            (0..3).for_each(|a| scale[a] += weight * output[7 + a]);
        }
        let share = f64::from(nodes.share[i]);
        Offset {
            mean: (share * mean).to_array(),
            rotation: rotation.map(|c| share * c / length(g.rotation[i])),
            scale: scale.map(|s| share * s),
        }
    };
    (0..g.len()).into_par_iter().map(of_gaussian).collect()
}

/// The quaternion 1 plus an offset, normalised.
fn local_turn(offset: &[f64]) -> DQuat {
    DQuat::from_xyzw(offset[1], offset[2], offset[3], 1.0 + offset[0]).normalize()
}

fn length(q: [f32; 4]) -> f64 {
    q.map(f64::from).iter().map(|c| c * c).sum::<f64>().sqrt()
}

fn promote(v: [f32; 3]) -> DVec3 {
    DVec3::from_array(v.map(f64::from))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::exp;

    #[test]
    fn a_screw_is_the_exponential_of_its_axis() {
        // A quarter turn about z through the origin, and one unit per radian along z.
        let quarter = std::f64::consts::FRAC_PI_2;
        let moved = DVec3::X + screw(DVec3::Z * quarter, DVec3::Z * quarter, DVec3::X);
        assert!(moved.distance(DVec3::new(0.0, 1.0, quarter)) < 1e-4, "{moved}");
        let w = DVec3::new(0.3, -0.2, 0.5);
        let x = DVec3::new(1.0, 2.0, 3.0);
        assert!((x + screw(w, DVec3::ZERO, x)).distance(exp(w) * x) < 1e-3);
        assert_eq!(screw(DVec3::ZERO, DVec3::Y, x), DVec3::Y);
    }
}
