//! New key times in a table.

use crate::error::Result;
use crate::reference::Pose;
use crate::scene::Motion;

/// Puts the poses `[M]` of a time into a table: as a new key, or in place of the one that it has at that time. Returns whether the
/// key is new.
///
/// # Errors
/// [`crate::Error::NonFinite`] for a pose that is not finite as f32.
pub fn put(motion: &mut Motion, time: f64, poses: &[Pose]) -> Result<bool> {
    let key = time as f32;
    let rows = |vector: fn(&Pose) -> glam::DVec3| poses.iter().map(move |p| vector(p).as_vec3().to_array());
    let (rotation, translation): (Vec<_>, Vec<_>) = rows(|p| p.rotation).zip(rows(|p| p.translation)).unzip();
    let values = rotation.iter().zip(&translation).flat_map(|(r, t)| [r, t]).flatten();
    for (index, value) in std::iter::once(&key).chain(values).enumerate() {
        if !value.is_finite() {
            let what = format!("pose at time {time}");
            return Err(crate::Error::NonFinite { what, index, value: value.to_string() });
        }
    }
    let m = poses.len();
    let (at, is_new) = match motion.times.binary_search_by(|t| t.total_cmp(&key)) {
        Ok(at) => (at, false),
        Err(at) => (at, true),
    };
    let replaced = at * m..at * m + if is_new { 0 } else { m };
    motion.rotation.splice(replaced.clone(), rotation);
    motion.translation.splice(replaced, translation);
    if is_new {
        motion.times.insert(at, key);
    }
    Ok(is_new)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::reference::table_poses;
    use crate::scene::synthetic::moving_scene;
    use glam::DVec3;

    #[test]
    fn keys_come_in_order_and_replace_their_own() {
        let scene = moving_scene(50, 4, 5, 2, false);
        let motion = scene.deformation.table().unwrap();
        let pose = Pose { rotation: DVec3::X, translation: DVec3::new(0.0, 2.0, 0.5) };
        for (time, keys) in [(-1.0, 6), (0.125, 6), (0.25, 5), (1.0, 5), (3.5, 6)] {
            let mut changed = motion.clone();
            assert_eq!(put(&mut changed, time, &[pose; 4]).unwrap(), keys == 6);
            assert_eq!(changed.times.len(), keys);
            assert!(changed.times.windows(2).all(|w| w[0] < w[1]));
            assert_eq!(table_poses(&changed, time), [pose; 4]);
            for &other in motion.times.iter().filter(|t| f64::from(**t) != time) {
                assert_eq!(table_poses(&changed, other.into()), table_poses(motion, other.into()));
            }
        }
        let wrong = Pose { rotation: DVec3::NAN, ..pose };
        assert!(put(&mut motion.clone(), 0.5, &[pose, wrong, pose, pose]).is_err());
        assert!(put(&mut motion.clone(), f64::NAN, &[pose; 4]).is_err());
    }
}
