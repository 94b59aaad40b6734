//! Where the Gaussians of a scene can be, for depth keys with fewer bits than a float.

use glam::{DMat3, DQuat, DVec3};

use super::deformation::Poses;
use super::frame::Frame;
use crate::scene::{Deformation, Motion, SuperpointDeformation};

/// Room beyond the box, as a share of its diagonal, for poses between keys.
const MARGIN: f64 = 0.01;
/// The same where networks move the scene to places that are not known before.
const NETWORK_MARGIN: f64 = 0.25;

/// An axis-aligned box around all centres, at all times. Gaussians outside are drawn too; only their order among each
/// other follows their index.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bounds {
    low: DVec3,
    high: DVec3,
}

impl Bounds {
    /// Nothing is known.
    pub(crate) const EVERYWHERE: Self = Self { low: DVec3::NEG_INFINITY, high: DVec3::INFINITY };
    const NOTHING: Self = Self { low: DVec3::INFINITY, high: DVec3::NEG_INFINITY };

    /// Of a scene whose centres `mean` are relative to `origin`; NaN centres are left out.
    pub(crate) fn of(deformation: &Deformation, mean: &[[f32; 3]], poses: &Poses, origin: DVec3) -> Self {
        let centre = |m: &[f32; 3]| DVec3::from(m.map(f64::from));
        let canonical = mean.iter().map(centre).filter(|m| m.is_finite()).fold(Self::NOTHING, Self::with);
        let (bounds, margin) = match (poses, deformation.superpoint_deformation()) {
            (Poses::Table(motion) | Poses::Host(motion, _), Some(superpoints)) => {
                let spheres = spheres(mean, superpoints, motion.superpoint_count());
                (moved(&spheres, motion, origin), MARGIN)
            }
            (Poses::Static, _) => (canonical, 0.0),
            _ => (canonical, NETWORK_MARGIN),
        };
        let margin = if deformation.changes_scales() { NETWORK_MARGIN } else { margin };
        let room = DVec3::splat(margin * (bounds.high - bounds.low).length());
        Self { low: bounds.low - room, high: bounds.high + room }
    }

    fn with(self, p: DVec3) -> Self {
        Self { low: self.low.min(p), high: self.high.max(p) }
    }

    /// Tells `compact` which depths there are: the lowest one in `world_to_camera_0.w`, and in `world_to_camera_1.w` how many
    /// low bits of the distance to it (in units in the last place) do not fit into `bits`.
    pub(crate) fn set_depth_key(&self, frame: &mut Frame, bits: u32) {
        if bits >= 32 {
            return;
        }
        let near = frame.near;
        let position = |i: usize| f64::from(frame.camera_position_high[i]) + f64::from(frame.camera_position_low[i]);
        let position = DVec3::new(position(0), position(1), position(2));
        let [x, y, z, _] = frame.world_to_camera_2.map(f64::from);
        let forward = DVec3::new(x, y, z);
        let centre = forward.dot((self.low + self.high) * 0.5 - position);
        let half = forward.abs().dot((self.high - self.low) * 0.5);
        let slack = 1e-5 * (centre.abs() + half);
        let (low, high) = ((centre - half - slack) as f32, (centre + half + slack) as f32);
        let low = if low.is_finite() { low.max(near) } else { near };
        let high = if high.is_finite() { high.max(low) } else { f32::MAX };
        let range = high.to_bits() - low.to_bits();
        let shift = (u32::BITS - range.leading_zeros()).saturating_sub(bits);
        frame.world_to_camera_0[3] = low;
        frame.world_to_camera_1[3] = shift as f32;
    }
}

/// Bounding sphere (centre of the box, largest distance) of each superpoint's Gaussians. One that moves with several is in the
/// sphere of each: its centre is a weighted mean of where they take it.
fn spheres(mean: &[[f32; 3]], moving: &SuperpointDeformation, superpoints: usize) -> Vec<(DVec3, f64)> {
    let mut boxes = vec![Bounds::NOTHING; superpoints];
    let members = || {
        let centres = mean.iter().map(|m| DVec3::from(m.map(f64::from))).enumerate().filter(|(_, m)| m.is_finite());
        let slots = centres.flat_map(|(i, m)| moving.slots(i).map(move |(j, _)| (m, j)));
        slots.filter(|(_, j)| *j < superpoints)
    };
    members().for_each(|(m, j)| boxes[j] = boxes[j].with(m));
    let mut spheres: Vec<(DVec3, f64)> = boxes.iter().map(|b| ((b.low + b.high) * 0.5, -1.0)).collect();
    members().for_each(|(m, j)| spheres[j].1 = spheres[j].1.max(m.distance(spheres[j].0)));
    spheres
}

/// Box around the spheres at every key: where a sphere's centre goes, the whole sphere goes.
fn moved(spheres: &[(DVec3, f64)], motion: &Motion, origin: DVec3) -> Bounds {
    let m = motion.superpoint_count().max(1);
    let mut bounds = Bounds::NOTHING;
    for (i, (r, t)) in motion.rotation.iter().zip(&motion.translation).enumerate() {
        let (centre, radius) = spheres[i % m];
        let rotation = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::from(r.map(f64::from))));
        let at = rotation * (centre + origin) + DVec3::from(t.map(f64::from)) - origin;
        if radius >= 0.0 && at.is_finite() {
            bounds = bounds.with(at - radius).with(at + radius);
        }
    }
    bounds
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::reference::place_scene;
    use crate::render::frame::FrameOptions;
    use crate::scene::synthetic::{moving_scene, random_blend};
    use crate::scene::{Camera, MotionSource};

    fn frame(eye: DVec3, bounds: &Bounds, bits: u32) -> Frame {
        let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Y, 0.8, [8, 8]);
        let mut frame = Frame::new(&camera, DVec3::ZERO, &FrameOptions::default()).unwrap();
        bounds.set_depth_key(&mut frame, bits);
        frame
    }

    #[test]
    fn a_narrow_range_of_depths_loses_nothing_with_24_bits() {
        let cube = Bounds { low: DVec3::splat(-1.0), high: DVec3::splat(1.0) };
        let far = frame(DVec3::new(0.0, 0.0, 4.0), &cube, 24);
        assert!(far.world_to_camera_0[3] > 2.99 && far.world_to_camera_0[3] <= 3.0);
        assert_eq!(far.world_to_camera_1[3], 0.0);
        let inside = frame(DVec3::new(0.0, 0.0, 0.5), &cube, 24);
        assert_eq!(inside.world_to_camera_0[3], 0.2, "the near plane is the lowest depth");
        assert!(inside.world_to_camera_1[3] > 0.0);
        assert!(frame(DVec3::Z, &Bounds::EVERYWHERE, 12).world_to_camera_1[3] >= 18.0);
        assert_eq!(frame(DVec3::Z * 4.0, &cube, 32).world_to_camera_0[3], 0.0);
    }

    #[test]
    fn the_box_of_a_moving_scene_holds_it_at_every_key() {
        let scene = moving_scene(200, 7, 5, 3, false);
        let motion = scene.deformation.table().unwrap().clone();
        let bounds = Bounds::of(&scene.deformation, &scene.gaussians.mean, &Poses::Table(motion.clone()), DVec3::ZERO);
        let of_gaussian = scene.deformation.superpoint_of_gaussian();
        for key in 0..motion.times.len() {
            for (mean, j) in scene.gaussians.mean.iter().zip(of_gaussian) {
                let at = key * 7 + *j as usize;
                let rotation = DQuat::from_scaled_axis(DVec3::from(motion.rotation[at].map(f64::from)));
                let p =
                    rotation * DVec3::from(mean.map(f64::from)) + DVec3::from(motion.translation[at].map(f64::from));
                assert!(p.cmpge(bounds.low).all() && p.cmple(bounds.high).all(), "{p} outside {bounds:?}");
            }
        }
    }

    #[test]
    fn the_box_holds_what_moves_with_several_superpoints() {
        let mut scene = moving_scene(200, 7, 5, 3, false);
        let s = scene.deformation.superpoint_deformation_mut().unwrap();
        // Superpoint 6 goes far away, and has no Gaussian of its own.
        let motion = s.table.as_mut().unwrap();
        motion.translation.iter_mut().skip(6).step_by(7).for_each(|t| t[0] += 50.0);
        let poses = Poses::Table(motion.clone());
        let mut blend = random_blend(200, 6, 3, 1);
        for (index, weight) in blend.index.chunks_exact_mut(3).zip(blend.weight.chunks_exact_mut(3)) {
            (index[0], weight[0], weight[1]) = (6, 0.005, 1.0);
        }
        (s.superpoints.of_gaussian, s.blend) = (blend.of_gaussian(), Some(blend));
        let bounds = Bounds::of(&scene.deformation, &scene.gaussians.mean, &poses, DVec3::ZERO);
        let mut last = 0.0_f64;
        for &time in scene.deformation.key_times() {
            for p in place_scene(&scene, f64::from(time), MotionSource::Auto).unwrap().mean {
                assert!(p.cmpge(bounds.low).all() && p.cmple(bounds.high).all(), "{p} outside {bounds:?}");
                last = last.max(p.x);
            }
        }
        let mut hard = scene.clone();
        hard.deformation.superpoint_deformation_mut().unwrap().blend = None;
        let without = Bounds::of(&hard.deformation, &scene.gaussians.mean, &poses, DVec3::ZERO);
        assert!(last < bounds.high.x && without.high.x < bounds.high.x - 10.0);
    }
}
