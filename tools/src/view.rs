//! A camera for a model that comes without one, and the times that a model covers.

use engine::scene::{Camera, Scene};
use glam::{DMat3, DVec3};

/// Horizontal field of view of the default camera, radians.
const FOV_X: f64 = 0.8;

/// A view of the whole scene from the front and a little above. `up` is −y, as in most captures (OpenCV axes).
pub fn default_camera(scene: &Scene, size: [u32; 2]) -> Camera {
    let (center, radius) = extent(scene);
    let distance = radius / (0.5 * FOV_X).sin();
    let eye = center + distance * DVec3::new(0.25, -0.25, -1.0).normalize();
    Camera::look_at(eye, center, DVec3::NEG_Y, FOV_X, size)
}

/// `count` views like [`default_camera`] around the vertical axis through the scene's centre, at times evenly spread over the
/// motion.
pub fn orbit(scene: &Scene, size: [u32; 2], count: usize) -> Vec<Camera> {
    let first = default_camera(scene, size);
    let (center, _) = extent(scene);
    let [start, end] = time_range(scene);
    let view = |i: usize| {
        let turn = DMat3::from_axis_angle(DVec3::Y, std::f64::consts::TAU * i as f64 / count as f64);
        let eye = center + turn * (first.position - center);
        let time = start + (end - start) * (i as f64 + 0.5) / count as f64;
        Camera { name: format!("orbit {i}"), time, ..Camera::look_at(eye, center, DVec3::NEG_Y, FOV_X, size) }
    };
    (0..count).map(view).collect()
}

/// Median centre, and the radius within which 90 % of the Gaussians lie. Values that are not finite do not count.
pub fn extent(scene: &Scene) -> (DVec3, f64) {
    let finite: Vec<DVec3> =
        scene.gaussians.mean.iter().map(|m| DVec3::from_array(m.map(f64::from))).filter(|m| m.is_finite()).collect();
    if finite.is_empty() {
        return (DVec3::ZERO, 1.0);
    }
    let quantile = |mut values: Vec<f64>, q: f64| {
        let rank = ((values.len() - 1) as f64 * q) as usize;
        *values.select_nth_unstable_by(rank, f64::total_cmp).1
    };
    let axis = |a: usize| quantile(finite.iter().map(|m| m[a]).collect(), 0.5);
    let center = DVec3::new(axis(0), axis(1), axis(2));
    let radius = quantile(finite.iter().map(|m| m.distance(center)).collect(), 0.9);
    (center, radius.max(1e-3))
}

/// First and last key time; [0, 1] for network F, which is trained on it; [0, 0] for what does not move.
pub fn time_range(scene: &Scene) -> [f64; 2] {
    let key = |t: Option<&f32>| t.map_or(0.0, |t| f64::from(*t));
    match &scene.motion {
        _ if !scene.is_dynamic() => [0.0, 0.0],
        Some(motion) => [key(motion.times.first()), key(motion.times.last())],
        None => [0.0, 1.0],
    }
}

/// `camera` at another size: both sides given, one of them (the other in proportion), or none.
pub fn resized(camera: &Camera, width: Option<u32>, height: Option<u32>) -> Camera {
    let scale = |side: u32, from: u32, to: u32| {
        let scaled = f64::from(side) * f64::from(to) / f64::from(from.max(1));
        (scaled.round() as u32).max(1)
    };
    match (width, height) {
        (None, None) => camera.clone(),
        (Some(w), Some(h)) => camera.resized(w, h),
        (Some(w), None) => camera.resized(w, scale(camera.height, camera.width, w)),
        (None, Some(h)) => camera.resized(scale(camera.width, camera.height, h), h),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    #[test]
    fn the_default_view_sees_the_centre_and_ignores_what_is_not_finite() {
        let mut scene = Scene::default();
        scene.gaussians.mean = vec![[1.0, 2.0, 3.0], [1.5, 2.0, 3.0], [0.5, 2.0, 3.0], [f32::NAN; 3]];
        let camera = default_camera(&scene, [200, 100]);
        let p = camera.rotation * (DVec3::new(1.0, 2.0, 3.0) - camera.position);
        assert!(p.z > 0.5 && p.x.abs() < 1e-9 && p.y.abs() < 1e-9, "{p}");
        assert_eq!((camera.width, camera.height), (200, 100));
    }

    #[test]
    fn an_orbit_looks_at_the_scene_from_all_sides() {
        let scene = engine::scene::synthetic::moving_scene(50, 3, 5, 1, false);
        let cameras = orbit(&scene, [64, 48], 3);
        let (center, _) = extent(&scene);
        for camera in &cameras {
            let p = camera.rotation * (center - camera.position);
            assert!(p.z > 0.5 && p.x.abs() < 1e-9 && p.y.abs() < 1e-9, "{p}");
        }
        assert!(cameras[0].position.distance(cameras[1].position) > 1.0 && cameras[0].time < cameras[2].time);
    }

    #[test]
    fn one_side_keeps_the_proportion() {
        let camera = default_camera(&Scene::default(), [640, 480]);
        let half = resized(&camera, Some(320), None);
        assert_eq!((half.width, half.height), (320, 240));
        assert!((half.fx - camera.fx / 2.0).abs() < 1e-9);
        let thin = resized(&camera, None, Some(1));
        assert_eq!((thin.width, thin.height), (1, 1));
    }
}
