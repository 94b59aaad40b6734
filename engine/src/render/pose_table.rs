//! What the host makes of the motion table before or during play-back: fewer keys, and poses along screws.

use glam::{DMat3, DQuat, DVec3};

use super::quality::Interpolation;
use crate::scene::Motion;

/// Every `step`-th key of a table, and its last one.
pub(crate) fn thinned(motion: &Motion, step: u32) -> Motion {
    let last = motion.times.len().saturating_sub(1);
    let kept: Vec<usize> = (0..motion.times.len()).filter(|k| k % step.max(1) as usize == 0 || *k == last).collect();
    let m = motion.superpoint_count();
    let rows = |list: &[[f32; 3]]| kept.iter().flat_map(|k| list[k * m..(k + 1) * m].to_vec()).collect();
    Motion {
        times: kept.iter().map(|k| motion.times[*k]).collect(),
        rotation: rows(&motion.rotation),
        translation: rows(&motion.translation),
    }
}

/// A rigid motion x → R x + t.
#[derive(Debug, Clone, Copy)]
struct Rigid {
    rotation: DQuat,
    translation: DVec3,
}

impl Rigid {
    fn key(motion: &Motion, at: usize) -> Self {
        let of = |list: &[[f32; 3]]| DVec3::from(list[at].map(f64::from));
        Self { rotation: DQuat::from_scaled_axis(of(&motion.rotation)), translation: of(&motion.translation) }
    }

    /// `weight` of the way from `self` to `to` along the screw: Exp(weight · Log(to ∘ self⁻¹)) ∘ self in SE(3), the shorter
    /// way round.
    fn towards(self, to: Self, weight: f64) -> Self {
        let between = (to.rotation * self.rotation.inverse()).normalize();
        let between = if between.w < 0.0 { -between } else { between };
        let axis = between.to_scaled_axis();
        let shift = to.translation - between * self.translation;
        let velocity = left_jacobian(axis).inverse() * shift;
        let rotation = DQuat::from_scaled_axis(axis * weight);
        let translation = left_jacobian(axis * weight) * (velocity * weight) + rotation * self.translation;
        Self { rotation: rotation * self.rotation, translation }
    }
}

/// V(ω) = I + (1 − cos θ)/θ² \[ω\] + (θ − sin θ)/θ³ \[ω\]²: the translation of the screw with rotation ω and velocity v is V v.
fn left_jacobian(axis: DVec3) -> DMat3 {
    let angle2 = axis.length_squared();
    let cross = DMat3::from_cols(
        DVec3::new(0.0, axis.z, -axis.y),
        DVec3::new(-axis.z, 0.0, axis.x),
        DVec3::new(axis.y, -axis.x, 0.0),
    );
    let (a, b) = if angle2 < 1e-8 {
        (0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0)
    } else {
        let angle = angle2.sqrt();
        ((1.0 - angle.cos()) / angle2, (angle - angle.sin()) / (angle2 * angle))
    };
    DMat3::IDENTITY + cross * a + cross * cross * b
}

/// Poses at `time` as `[M,2]` vec4, relative to `origin` o: R(μ' + o) + τ − o = Rμ' + τ'.
#[cfg(test)]
fn poses_at(motion: &Motion, interpolation: Interpolation, time: f64, origin: DVec3) -> Vec<[f32; 4]> {
    let mut out = Vec::new();
    write_poses(motion, interpolation, time, origin, &mut out);
    out
}

/// Poses at `time` as `[M,2]` vec4, relative to `origin` o: R(μ' + o) + τ − o = Rμ' + τ'; they replace what is in `out`.
pub(crate) fn write_poses(
    motion: &Motion,
    interpolation: Interpolation,
    time: f64,
    origin: DVec3,
    out: &mut Vec<[f32; 4]>,
) {
    let interval = motion.interval(time);
    let m = motion.superpoint_count();
    let (first, second) = (interval.first as usize * m, interval.second as usize * m);
    let lerp = |list: &[[f32; 3]], i: usize| {
        let (a, b) = (DVec3::from(list[first + i].map(f64::from)), DVec3::from(list[second + i].map(f64::from)));
        a + (b - a) * interval.weight
    };
    out.clear();
    out.reserve(2 * m);
    for i in 0..m {
        let (r, rotation, translation) = match interpolation {
            Interpolation::Linear => {
                let r = lerp(&motion.rotation, i);
                let angle = r.length();
                let rotation = if angle > 0.0 { DMat3::from_axis_angle(r / angle, angle) } else { DMat3::IDENTITY };
                (r, rotation, lerp(&motion.translation, i))
            }
            Interpolation::Geodesic => {
                let (from, to) = (Rigid::key(motion, first + i), Rigid::key(motion, second + i));
                let pose = from.towards(to, interval.weight);
                (pose.rotation.to_scaled_axis(), DMat3::from_quat(pose.rotation), pose.translation)
            }
        };
        let translation = rotation * origin - origin + translation;
        out.push(r.as_vec3().extend(0.0).to_array());
        out.push(translation.as_vec3().extend(0.0).to_array());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A table of one superpoint that turns about the point `c` by `angle` between keys.
    fn turning(c: DVec3, axis: DVec3, angle: f64, keys: usize) -> Motion {
        let mut motion = Motion::default();
        for k in 0..keys {
            let r = axis.normalize() * angle * k as f64;
            let t = c - DQuat::from_scaled_axis(r) * c;
            motion.times.push(k as f32);
            motion.rotation.push(r.as_vec3().to_array());
            motion.translation.push(t.as_vec3().to_array());
        }
        motion
    }

    fn point(pose: &[[f32; 4]], p: DVec3) -> DVec3 {
        let of = |v: [f32; 4]| DVec3::new(v[0].into(), v[1].into(), v[2].into());
        DQuat::from_scaled_axis(of(pose[0])) * p + of(pose[1])
    }

    #[test]
    fn thinning_keeps_the_first_every_step_and_the_last() {
        let motion = turning(DVec3::X, DVec3::Y, 0.1, 8);
        assert_eq!(thinned(&motion, 3).times, [0.0, 3.0, 6.0, 7.0]);
        assert_eq!(thinned(&motion, 3).rotation[2], motion.rotation[6]);
        assert_eq!(thinned(&motion, 1), motion);
        assert_eq!(thinned(&Motion::default(), 4), Motion::default());
    }

    #[test]
    fn a_screw_turns_about_its_axis_where_linear_cuts_the_corner() {
        let (c, axis) = (DVec3::new(3.0, 0.5, -1.0), DVec3::new(0.2, 1.0, 0.4));
        let motion = turning(c, axis, 0.8, 2);
        let p = c + DVec3::new(0.0, 0.0, 0.5);
        for weight in [0.0, 0.25, 0.5, 1.0] {
            let truth = c + DQuat::from_scaled_axis(axis.normalize() * 0.8 * weight) * (p - c);
            let geodesic = point(&poses_at(&motion, Interpolation::Geodesic, weight, DVec3::ZERO), p);
            assert!(geodesic.distance(truth) < 5e-6, "{geodesic} {truth}");
            let linear = point(&poses_at(&motion, Interpolation::Linear, weight, DVec3::ZERO), p);
            assert!(weight.fract() == 0.0 || linear.distance(truth) > 1e-2);
        }
    }

    #[test]
    fn keys_are_met_and_the_shorter_way_is_taken_past_half_a_turn() {
        let motion = Motion {
            times: vec![0.0, 1.0],
            rotation: vec![[3.1, 0.0, 0.0], [-3.1, 0.0, 0.0]],
            translation: vec![[1.0, 2.0, 3.0], [1.0, 2.0, 3.5]],
        };
        let p = DVec3::new(0.3, -0.7, 0.2);
        let middle = point(&poses_at(&motion, Interpolation::Geodesic, 0.5, DVec3::ZERO), p);
        let half_turn = DQuat::from_scaled_axis(DVec3::X * std::f64::consts::PI) * p + DVec3::new(1.0, 2.0, 3.25);
        assert!(middle.distance(half_turn) < 0.1, "{middle} {half_turn}");
        for (weight, key) in [(0.0, 0), (1.0, 1)] {
            let pose = Rigid::key(&motion, key);
            let at = point(&poses_at(&motion, Interpolation::Geodesic, weight, DVec3::ZERO), p);
            assert!(at.distance(pose.rotation * p + pose.translation) < 1e-5);
        }
    }

    #[test]
    fn no_rotation_is_a_straight_line() {
        assert!((left_jacobian(DVec3::ZERO) - DMat3::IDENTITY).to_cols_array().iter().all(|v| *v == 0.0));
        let small = left_jacobian(DVec3::X * 1.01e-4) - left_jacobian(DVec3::X * 0.99e-4);
        assert!(small.to_cols_array().iter().all(|v| v.abs() < 2e-6), "no step between series and formula");
    }
}
