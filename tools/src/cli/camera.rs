//! A camera for a model that comes without one, and the times that a model covers.

use engine::reference::Pose;
use engine::render::RenderOptions;
use engine::scene::{Camera, MotionSource, Scene};
use glam::{DMat3, DVec3};

/// Horizontal field of view of the default camera, radians.
const FOV_X: f64 = 0.8;
/// What an overview leaves around the scene: Gaussians reach beyond their centres.
pub const MARGIN: f64 = 1.08;

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
    let [start, end] = scene.time_range();
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

/// Gaussians that [`whole`] looks at, at most.
const SAMPLES: usize = 20_000;
/// Times that [`whole`] looks at.
const TIMES: usize = 5;
/// Fainter Gaussians do not count in [`whole`].
const FAINT_LOGIT: f32 = -2.2;

/// A ball that holds what is seen of the scene at all its times: centre and radius. Gaussians that lie far from nearly all others
/// (the background of a capture) do not count, nor do faint ones.
pub fn whole(scene: &Scene) -> (DVec3, f64) {
    let points = positions(scene);
    if points.is_empty() {
        return (DVec3::ZERO, 1.0);
    }
    let mut axes: [Vec<f64>; 3] = [0, 1, 2].map(|a| points.iter().map(|p| p[a]).collect());
    let middle = axes.each_mut().map(|values| {
        let rank = values.len() / 2;
        *values.select_nth_unstable_by(rank, f64::total_cmp).1
    });
    let median = DVec3::from_array(middle);
    let mut distances: Vec<f64> = points.iter().map(|p| p.distance(median)).collect();
    distances.sort_unstable_by(f64::total_cmp);
    let quantile = |q: f64| distances[((distances.len() - 1) as f64 * q) as usize];
    // As many as do not lie much farther out than most.
    let most = quantile(0.9);
    let reach = [0.995, 0.98, 0.95].into_iter().map(quantile).find(|r| *r <= 3.0 * most).unwrap_or(most);
    let kept = || points.iter().filter(|p| p.distance(median) <= reach);
    let low = kept().fold(DVec3::INFINITY, |a, p| a.min(*p));
    let high = kept().fold(DVec3::NEG_INFINITY, |a, p| a.max(*p));
    let center = 0.5 * (low + high);
    let radius = kept().map(|p| p.distance(center)).fold(0.0, f64::max);
    (center, radius.max(1e-3))
}

/// Near plane for cameras that the program makes itself: that of the renderer, or a tenth of the scene's radius where it is small.
pub fn near(scene: &Scene) -> f32 {
    (0.1 * extent(scene).1 as f32).min(RenderOptions::default().near)
}

/// Some of the Gaussians' centres, at times spread over the motion of superpoints.
fn positions(scene: &Scene) -> Vec<DVec3> {
    let g = &scene.gaussians;
    let stride = g.len().div_ceil(SAMPLES).max(1);
    let all = || (0..g.len()).step_by(stride).filter(|&i| g.mean[i].iter().all(|v| v.is_finite()));
    let visible: Vec<usize> = all().filter(|&i| g.opacity_logit[i] >= FAINT_LOGIT).collect();
    let used = if visible.len() * 10 >= all().count() { visible } else { all().collect() };
    let at = |i: usize| DVec3::from_array(g.mean[i].map(f64::from));
    let [start, end] = scene.time_range();
    let Some(superpoints) = scene.deformation.superpoint_deformation().filter(|_| end > start) else {
        return used.into_iter().map(at).collect();
    };
    let mut moved = Vec::with_capacity(TIMES * used.len());
    for time in (0..TIMES).map(|k| start + (end - start) * k as f64 / (TIMES - 1) as f64) {
        let Ok(Some(poses)) = engine::reference::poses(scene, time, MotionSource::Auto) else { continue };
        moved.extend(used.iter().filter_map(|&i| {
            let by = |pose: &Pose| engine::reference::exp(pose.rotation) * at(i) + pose.translation;
            let moved = superpoints.slots(i).map(|(j, weight)| poses.get(j).map(|pose| weight * by(pose)));
            moved.sum::<Option<DVec3>>().filter(|p| p.is_finite())
        }));
    }
    if moved.is_empty() { used.into_iter().map(at).collect() } else { moved }
}

/// The direction of [`default_camera`], with all of [`whole`] in the image.
pub fn overview(scene: &Scene, size: [u32; 2]) -> Camera {
    let (center, radius) = whole(scene);
    let [width, height] = size.map(f64::from);
    let tangent = (0.5 * FOV_X).tan() * (height / width).min(1.0);
    let distance = MARGIN * radius / tangent.atan().sin();
    let eye = center + distance * DVec3::new(0.25, -0.25, -1.0).normalize();
    Camera::look_at(eye, center, DVec3::NEG_Y, FOV_X, size)
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

    /// How far from the middle of the image, as a share of half of it, a point of the world is seen.
    fn off_middle(camera: &Camera, p: DVec3) -> f64 {
        let q = camera.rotation * (p - camera.position);
        let [x, y] = [camera.fx * q.x / q.z + camera.cx, camera.fy * q.y / q.z + camera.cy];
        let axis = |v: f64, size: u32| (v / (0.5 * f64::from(size)) - 1.0).abs();
        if q.z > 0.0 { axis(x, camera.width).max(axis(y, camera.height)) } else { f64::INFINITY }
    }

    #[test]
    fn an_overview_has_all_of_the_scene_and_not_its_background() {
        // A guitar: a body with most of the Gaussians, and a long thin neck.
        let mut means: Vec<[f32; 3]> =
            (0..900).map(|i| [(i % 30) as f32 * 0.01, (i / 30) as f32 * 0.01, 0.0]).collect();
        means.extend((0..80).map(|i| [0.15, -0.005 * i as f32, 0.0]));
        let count = means.len();
        // What lies far behind.
        means.extend((0..20).map(|i| [50.0 * (i as f32).sin(), 50.0, 50.0]));
        let mut scene = engine::scene::synthetic::random_scene(means.len(), 1, 0);
        scene.gaussians.mean = means;
        scene.gaussians.opacity_logit.fill(1.0);
        for size in [[300, 200], [200, 300], [1000, 100]] {
            let camera = overview(&scene, size);
            let far = (0..count)
                .map(|i| off_middle(&camera, DVec3::from_array(scene.gaussians.mean[i].map(f64::from))))
                .fold(0.0, f64::max);
            assert!((0.3..1.0).contains(&far), "{size:?}: {far}");
        }
    }

    #[test]
    fn an_overview_has_what_moves_at_all_times() {
        let scene = engine::scene::synthetic::moving_scene(400, 8, 9, 3, false);
        let camera = overview(&scene, [400, 300]);
        for time in [0.0, 0.3, 0.7, 1.0] {
            let moved = engine::reference::freeze(&scene, time, MotionSource::Auto).unwrap();
            let inside = moved.mean.iter().filter(|m| off_middle(&camera, DVec3::from_array(m.map(f64::from))) < 1.0);
            assert!(inside.count() >= 396, "{time}");
        }
    }

    #[test]
    fn near_planes_are_small_in_small_scenes() {
        let mut scene = engine::scene::synthetic::random_scene(50, 1, 0);
        let whole = near(&scene);
        scene.gaussians.mean.iter_mut().flatten().for_each(|v| *v *= 0.01);
        assert!(near(&scene) <= 0.011 * whole.max(0.2) && near(&scene) > 0.0 && whole <= 0.2);
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
