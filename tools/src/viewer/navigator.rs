//! Moving the camera: turntable, fly and trackpad, as pure functions of pixels and seconds.
//!
//! The camera looks at `target` from `distance`; orbiting turns both about it, flying moves it along. Axes are OpenCV's (x
//! right, y down, z forward). Angles per pixel, zoom per notch and keys follow Blender and the usual splat viewers.

use engine::scene::Camera;
use glam::{DMat3, DQuat, DVec3};

/// Radians per window height that is dragged.
const TURN_PER_HEIGHT: f64 = std::f64::consts::PI;
/// Share of the distance that a notch of the wheel takes away.
const ZOOM_PER_NOTCH: f64 = 0.12;
/// Closest that the turntable comes to looking straight up or down, radians.
const POLE: f64 = 0.01;
/// Seconds of the way to a preset.
const GLIDE_S: f64 = 0.25;
/// Distances per second that the keys move.
const FLY_PER_SECOND: f64 = 0.6;
/// How much faster with Shift.
const FAST: f64 = 4.0;

/// How dragging moves the camera.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) enum Navigation {
    /// About the point that is looked at.
    #[default]
    Orbit,
    /// About the camera itself.
    Fly,
}

/// Where the camera is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pose {
    /// The point that is looked at.
    pub(super) target: DVec3,
    /// From the camera to it.
    pub(super) distance: f64,
    /// Camera → world.
    pub(super) rotation: DQuat,
    /// Vertical field of view, radians.
    pub(super) fov_y: f64,
}

impl Pose {
    /// The camera's centre.
    pub(super) fn position(&self) -> DVec3 {
        self.target - self.distance * self.forward()
    }

    pub(super) fn forward(&self) -> DVec3 {
        self.rotation * DVec3::Z
    }

    /// Of a camera that looks at something `distance` away.
    pub(super) fn of_camera(camera: &Camera, distance: f64) -> Self {
        let rotation = DQuat::from_mat3(&camera.rotation.transpose()).normalize();
        let target = camera.position + distance * (rotation * DVec3::Z);
        let fov_y = 2.0 * (0.5 * f64::from(camera.height) / camera.fy).atan();
        Self { target, distance, rotation, fov_y }
    }

    /// The engine's camera for an image of this size.
    pub(super) fn camera(&self, size: [u32; 2], time: f64) -> Camera {
        let f = 0.5 * f64::from(size[1]) / (0.5 * self.fov_y).tan();
        Camera {
            name: String::new(),
            width: size[0],
            height: size[1],
            fx: f,
            fy: f,
            cx: 0.5 * f64::from(size[0]),
            cy: 0.5 * f64::from(size[1]),
            rotation: DMat3::from_quat(self.rotation).transpose(),
            position: self.position(),
            time,
        }
    }

    fn between(a: &Self, b: &Self, t: f64) -> Self {
        let smooth = t * t * (3.0 - 2.0 * t);
        let distance = a.distance * (b.distance / a.distance).powf(smooth);
        let rotation = a.rotation.slerp(b.rotation, smooth);
        // The camera moves straight; the target follows from it.
        let position = a.position().lerp(b.position(), smooth);
        let target = position + distance * (rotation * DVec3::Z);
        Self { target, distance, rotation, fov_y: a.fov_y + (b.fov_y - a.fov_y) * smooth }
    }
}

/// Keys that are held: right, down, forward, each −1, 0 or 1.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Thrust {
    /// Along the camera's axes.
    pub(super) direction: DVec3,
    /// Shift.
    pub(super) fast: bool,
}

/// The camera and how it is moved.
#[derive(Debug, Clone)]
pub(super) struct Navigator {
    pub(super) pose: Pose,
    pub(super) mode: Navigation,
    /// World direction that stays up.
    pub(super) up: DVec3,
    /// Multiplies the speed of flying.
    pub(super) speed: f64,
    glide: Option<(Pose, Pose, f64)>,
}

impl Navigator {
    pub(super) fn new(pose: Pose, up: DVec3) -> Self {
        Self { pose, mode: Navigation::Orbit, up, speed: 1.0, glide: None }
    }

    /// Goes to a pose within a moment.
    pub(super) fn glide_to(&mut self, pose: Pose) {
        self.glide = Some((self.pose, pose, 0.0));
    }

    /// Is there at once.
    pub(super) fn jump_to(&mut self, pose: Pose) {
        self.glide = None;
        self.pose = pose;
    }

    /// Where the camera is going.
    pub(super) fn goal(&self) -> Pose {
        self.glide.map_or(self.pose, |(_, goal, _)| goal)
    }

    /// Whether the camera moves by itself.
    pub(super) fn is_gliding(&self) -> bool {
        self.glide.is_some()
    }

    /// Lets `dt` seconds pass with these keys held; true when the camera moved.
    pub(super) fn advance(&mut self, dt: f64, thrust: Thrust) -> bool {
        if let Some((from, to, passed)) = &mut self.glide {
            *passed += dt;
            let t = (*passed / GLIDE_S).min(1.0);
            self.pose = if t < 1.0 { Pose::between(from, to, t) } else { *to };
            if t >= 1.0 {
                self.glide = None;
            }
            return true;
        }
        if thrust.direction == DVec3::ZERO {
            return false;
        }
        let step = FLY_PER_SECOND * self.speed * self.pose.distance * if thrust.fast { FAST } else { 1.0 } * dt;
        self.pose.target += self.pose.rotation * thrust.direction.normalize() * step;
        true
    }

    /// A drag by `delta` pixels in a window of `height` pixels: turns about the target, or about the camera.
    pub(super) fn drag_turn(&mut self, delta: [f64; 2], height: f64) {
        self.glide = None;
        let per_pixel = TURN_PER_HEIGHT / height.max(1.0);
        match self.mode {
            Navigation::Orbit => self.turn(delta[0] * per_pixel, delta[1] * per_pixel),
            Navigation::Fly => {
                // The picture follows the pointer half as fast: one looks around, one does not spin.
                let position = self.pose.position();
                self.turn(-0.5 * delta[0] * per_pixel, -0.5 * delta[1] * per_pixel);
                self.pose.target = position + self.pose.distance * self.pose.forward();
            }
        }
    }

    /// Turntable: by `yaw` about the world's up, by `pitch` about the camera's right, up to the poles.
    fn turn(&mut self, yaw: f64, pitch: f64) {
        // Dragging to the right turns the scene to the right, so the camera goes to the left.
        let about_up = DQuat::from_axis_angle(self.up, if self.is_upside_down() { yaw } else { -yaw });
        let turned = (about_up * self.pose.rotation).normalize();
        let right = turned * DVec3::X;
        let elevation = (turned * DVec3::Z).dot(self.up).clamp(-1.0, 1.0).asin();
        let limit = std::f64::consts::FRAC_PI_2 - POLE;
        let wanted = (elevation - pitch).clamp(-limit, limit);
        // A camera with roll has another right than the turntable's; it then pitches freely.
        let change = if right.dot(self.up).abs() < 1e-6 { wanted - elevation } else { -pitch };
        self.pose.rotation = (DQuat::from_axis_angle(right, change) * turned).normalize();
    }

    fn is_upside_down(&self) -> bool {
        (self.pose.rotation * DVec3::Y).dot(self.up) > 1e-6
    }

    /// Moves the target with the pointer: what is at the target's depth stays under it.
    pub(super) fn drag_pan(&mut self, delta: [f64; 2], height: f64) {
        self.glide = None;
        let world_per_pixel = 2.0 * (0.5 * self.pose.fov_y).tan() * self.pose.distance / height.max(1.0);
        self.pose.target -= self.pose.rotation * DVec3::new(delta[0], delta[1], 0.0) * world_per_pixel;
    }

    /// Zooms by a vertical drag, as Ctrl with the middle button does in Blender.
    pub(super) fn drag_zoom(&mut self, delta: [f64; 2], height: f64) {
        self.zoom(-8.0 * delta[1] / height.max(1.0) * 2.0);
    }

    /// Notches of the wheel: closer to the target, or faster when flying.
    pub(super) fn wheel(&mut self, notches: f64) {
        match self.mode {
            Navigation::Orbit => self.zoom(notches),
            Navigation::Fly => self.speed = (self.speed * (1.0 + ZOOM_PER_NOTCH).powf(notches)).clamp(0.01, 100.0),
        }
    }

    /// Comes closer by notches of the wheel.
    pub(super) fn zoom(&mut self, notches: f64) {
        self.glide = None;
        self.pose.distance = (self.pose.distance * (1.0 - ZOOM_PER_NOTCH).powf(notches)).clamp(1e-4, 1e7);
    }

    /// Two fingers on a trackpad, pixels.
    pub(super) fn swipe(&mut self, delta: [f64; 2], height: f64, shift: bool, control: bool) {
        match (shift, control) {
            (_, true) => self.zoom(delta[1] / 20.0),
            (true, _) => self.drag_pan(delta, height),
            _ => self.drag_turn(delta, height),
        }
    }

    /// A pose that has a ball around `center` within `angle` of the axis (radians), from the same direction.
    pub(super) fn framing(&self, center: DVec3, radius: f64, angle: f64) -> Pose {
        Pose { target: center, distance: radius / angle.sin(), ..self.pose }
    }

    /// A pose that looks along `direction` at the same target, upright.
    pub(super) fn looking(&self, direction: DVec3) -> Pose {
        let up = if direction.dot(self.up).abs() > 0.99 { self.up.any_orthonormal_vector() } else { self.up };
        let camera = Camera::look_at(DVec3::ZERO, direction, up, 1.0, [2, 2]);
        Pose { rotation: DQuat::from_mat3(&camera.rotation.transpose()).normalize(), ..self.pose }
    }

    /// Changes the world's up; the camera stands upright in it.
    pub(super) fn set_up(&mut self, up: DVec3) {
        self.up = up;
        let pose = self.looking(self.pose.forward());
        self.glide_to(pose);
    }
}

/// Up as a set of cameras has it: the mean of their own.
pub(super) fn up_of_cameras(cameras: &[Camera]) -> DVec3 {
    let sum: DVec3 = cameras.iter().map(|c| -(c.rotation.transpose() * DVec3::Y)).sum();
    let mean = sum.normalize_or(DVec3::NEG_Y);
    // Close to an axis it is meant to be that axis.
    let axis = [DVec3::X, DVec3::Y, DVec3::Z].into_iter().flat_map(|a| [a, -a]).find(|a| a.dot(mean) > 0.9);
    axis.unwrap_or(mean)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn navigator() -> Navigator {
        let camera =
            Camera::look_at(DVec3::new(0.0, -1.0, -5.0), DVec3::new(0.5, 0.0, 0.0), DVec3::NEG_Y, 0.8, [640, 480]);
        Navigator::new(Pose::of_camera(&camera, 5.0), DVec3::NEG_Y)
    }

    #[test]
    fn a_camera_survives_the_way_through_a_pose() {
        let camera = Camera::look_at(DVec3::new(3.0, 1.0, -2.0), DVec3::ZERO, DVec3::Z, 0.7, [640, 480]);
        let back = Pose::of_camera(&camera, 2.0).camera([640, 480], 0.25);
        assert!(back.position.distance(camera.position) < 1e-9 && (back.fx - camera.fx).abs() < 1e-6);
        let rotation = (back.rotation - camera.rotation).to_cols_array();
        assert!(rotation.iter().all(|v| v.abs() < 1e-9) && back.time == 0.25);
    }

    #[test]
    fn orbiting_keeps_target_distance_and_horizon() {
        let mut n = navigator();
        let before = n.pose;
        for delta in [[120.0, 35.0], [-40.0, 900.0], [0.0, -2000.0], [333.0, 4.0]] {
            n.drag_turn(delta, 480.0);
            assert!(n.pose.target.distance(before.target) < 1e-9);
            assert!((n.pose.position().distance(before.target) - before.distance).abs() < 1e-9);
            let right = n.pose.rotation * DVec3::X;
            assert!(right.dot(n.up).abs() < 1e-6, "the horizon tilts: {right}");
            assert!((n.pose.rotation * DVec3::Y).dot(n.up) < 0.0, "upside down");
        }
    }

    #[test]
    fn the_scene_follows_the_pointer() {
        // A point in front of the target moves to the right and down with a drag to the right and down.
        let (mut n, size) = (navigator(), [640, 480]);
        let point = n.pose.target - 0.5 * n.pose.forward();
        let pixel = |n: &Navigator| {
            let c = n.pose.camera(size, 0.0);
            let p = c.rotation * (point - c.position);
            [c.fx * p.x / p.z + c.cx, c.fy * p.y / p.z + c.cy]
        };
        let before = pixel(&n);
        n.drag_turn([30.0, 20.0], 480.0);
        let after = pixel(&n);
        assert!(after[0] > before[0] && after[1] > before[1], "{before:?} {after:?}");
        // Panning keeps the target exactly under the pointer.
        let mut n = navigator();
        let target = n.pose.target;
        n.drag_pan([64.0, -48.0], 480.0);
        let c = n.pose.camera(size, 0.0);
        let p = c.rotation * (target - c.position);
        assert!((c.fx * p.x / p.z + c.cx - 384.0).abs() < 1e-6 && (c.fy * p.y / p.z + c.cy - 192.0).abs() < 1e-6);
    }

    #[test]
    fn flying_turns_about_the_camera_and_moves_along_it() {
        let mut n = navigator();
        n.mode = Navigation::Fly;
        let position = n.pose.position();
        n.drag_turn([50.0, -30.0], 480.0);
        assert!(n.pose.position().distance(position) < 1e-9);
        let forward = n.pose.forward();
        assert!(n.advance(0.5, Thrust { direction: DVec3::Z, fast: false }));
        let moved = n.pose.position() - position;
        assert!(moved.normalize().dot(forward) > 0.999_999);
        let slow = moved.length();
        n.advance(0.5, Thrust { direction: DVec3::Z, fast: true });
        assert!(((n.pose.position() - position).length() - slow * 5.0).abs() < 1e-9);
        assert!(!n.advance(0.5, Thrust::default()));
        let speed = n.speed;
        n.wheel(1.0);
        assert!(n.speed > speed);
    }

    #[test]
    fn zooming_in_and_out_comes_back() {
        let mut n = navigator();
        n.wheel(3.0);
        assert!(n.pose.distance < 5.0);
        n.wheel(-3.0);
        assert!((n.pose.distance - 5.0).abs() < 1e-9);
        n.swipe([0.0, 40.0], 480.0, false, true);
        assert!(n.pose.distance < 5.0);
    }

    #[test]
    fn gliding_ends_exactly_there() {
        let mut n = navigator();
        let goal = n.looking(DVec3::Y);
        assert!(goal.forward().distance(DVec3::Y) < 1e-9);
        n.glide_to(goal);
        let mut steps = 0;
        while n.advance(0.016, Thrust::default()) {
            steps += 1;
        }
        assert!((10..40).contains(&steps) && n.pose == goal);
        let framed = n.framing(DVec3::ONE, 2.0, 0.5);
        assert!(framed.target == DVec3::ONE && (framed.distance * 0.5_f64.sin() - 2.0).abs() < 1e-9);
    }

    #[test]
    fn up_is_what_the_cameras_agree_on() {
        let ring: Vec<Camera> = (0..8)
            .map(|i| {
                let a = f64::from(i);
                Camera::look_at(DVec3::new(a.cos(), a.sin(), 0.7), DVec3::ZERO, DVec3::Z, 0.7, [4, 4])
            })
            .collect();
        assert_eq!(up_of_cameras(&ring), DVec3::Z);
        assert_eq!(up_of_cameras(&[]), DVec3::NEG_Y);
    }
}
