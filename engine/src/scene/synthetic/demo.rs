//! The built-in moving scene of `spgs demo`: a gyroscope of three spinning rings around a glowing core, balls orbiting it
//! and a chain of beads swimming around it, above a static floor. Each rigid piece is a superpoint; the motion loops over
//! t ∈ [0, 1].

use std::f64::consts::TAU;

use glam::{DQuat, DVec2, DVec3};

use super::Random;
use crate::scene::{Camera, Gaussians, Motion, Scene, SuperpointDeformation, Superpoints};

/// Background colour that the demo's lighting is made for.
pub const DEMO_BACKGROUND: [f32; 3] = [0.035, 0.045, 0.075];

const KEY_TIMES: usize = 129;
const RINGS: usize = 3;
const BALLS: usize = 9;
const BEADS: usize = 26;
/// Centre of the gyroscope, world units, z up.
const CENTER: DVec3 = DVec3::new(0.0, 0.0, 1.45);
/// Direction to the lamp.
const LAMP: DVec3 = DVec3::new(0.4, -0.55, 0.733);

/// A piece: where it is canonically, and how it moves.
struct Piece {
    pivot: DVec3,
    path: Box<dyn Fn(f64) -> (DVec3, DVec3)>,
}

/// What a surface point looks like.
#[derive(Clone, Copy)]
struct Surface {
    point: DVec3,
    normal: DVec3,
    color: DVec3,
    gloss: f64,
    /// Standard deviation along the surface.
    size: f64,
    opacity: f64,
}

/// The demo scene: about 43,000 Gaussians of SH degree 2, 40 superpoints, 129 key times over [0, 1].
pub fn demo_scene() -> Scene {
    let mut random = Random::new(2024);
    let mut builder = Builder::default();
    floor(&mut builder, &mut random);
    core(&mut builder);
    (0..RINGS).for_each(|i| ring(&mut builder, i));
    (0..BALLS).for_each(|i| ball(&mut builder, i, &mut random));
    (0..BEADS).for_each(|i| bead(&mut builder, i, &mut random));
    builder.finish()
}

/// A camera for the demo scene: swings gently from side to side as `time` goes from 0 to 1, and back.
pub fn demo_camera(time: f64, width: u32, height: u32) -> Camera {
    let swing = (TAU * time).sin();
    let angle = -1.1 + 0.3 * swing;
    let eye = DVec3::new(7.2 * angle.cos(), 7.2 * angle.sin(), 3.4 + 0.25 * (TAU * time).cos());
    // The scene is about as high as wide, so the narrower side of the image decides.
    let fov = if width > height { 0.8 * f64::from(width) / f64::from(height) } else { 0.8 };
    let camera = Camera::look_at(eye, DVec3::new(0.0, 0.0, 1.0), DVec3::Z, fov.min(2.0) * 0.75, [width, height]);
    Camera { time, ..camera }
}

#[derive(Default)]
struct Builder {
    gaussians: Gaussians,
    of_gaussian: Vec<u32>,
    pieces: Vec<Piece>,
}

impl Builder {
    fn piece(&mut self, pivot: DVec3, path: impl Fn(f64) -> (DVec3, DVec3) + 'static) {
        self.pieces.push(Piece { pivot, path: Box::new(path) });
    }

    /// Adds a flat Gaussian on the surface of the piece added last.
    fn add(&mut self, surface: Surface) {
        let turn = DQuat::from_rotation_arc(DVec3::Z, surface.normal);
        let flat = surface.size.ln() as f32;
        let g = &mut self.gaussians;
        g.sh_degree = 2;
        g.mean.push(surface.point.as_vec3().to_array());
        g.log_scale.push([flat, flat, flat - 2.3]);
        g.rotation.push([turn.w as f32, turn.x as f32, turn.y as f32, turn.z as f32]);
        g.opacity_logit.push((surface.opacity / (1.0 - surface.opacity)).ln() as f32);
        g.sh.extend(shaded(&surface));
        self.of_gaussian.push(self.pieces.len() as u32 - 1);
    }

    fn finish(self) -> Scene {
        let mut motion = Motion::default();
        for k in 0..KEY_TIMES {
            let time = k as f64 / (KEY_TIMES - 1) as f64;
            motion.times.push(time as f32);
            for piece in &self.pieces {
                let (rotation, position) = (piece.path)(time);
                let translation = position - DQuat::from_scaled_axis(rotation) * piece.pivot;
                motion.rotation.push(rotation.as_vec3().to_array());
                motion.translation.push(translation.as_vec3().to_array());
            }
        }
        let position = self.pieces.iter().map(|p| p.pivot.as_vec3().to_array()).collect();
        let superpoints = Superpoints { of_gaussian: self.of_gaussian, position };
        Scene {
            gaussians: self.gaussians,
            deformation: SuperpointDeformation::of_table(superpoints, motion).into(),
            ..Scene::default()
        }
    }
}

/// SH of degree 2 for a lamp, a soft sky and a highlight: diffuse light is constant; the highlight is
/// gloss·((1 + v·m)/2)² in the view direction v around the mirror direction m of the lamp.
fn shaded(s: &Surface) -> Vec<f32> {
    let diffuse = 0.30 + 0.20 * s.normal.z.max(-0.5) + 0.75 * s.normal.dot(LAMP).max(0.0);
    let mirror = 2.0 * s.normal.dot(LAMP) * s.normal - LAMP;
    let lobe = highlight(mirror);
    let base = s.color * diffuse;
    let mut sh = Vec::with_capacity(27);
    for (k, weight) in lobe.iter().enumerate() {
        for channel in 0..3 {
            // The 0.5 that the renderer adds belongs to the constant term.
            let constant = if k == 0 { (base[channel] - 0.5) / 0.282_094_79 } else { 0.0 };
            sh.push((constant + s.gloss * weight) as f32);
        }
    }
    sh
}

/// SH coefficients of ((1 + v·m)/2)² where v = −d and d is the direction that SH are evaluated at.
fn highlight(m: DVec3) -> [f64; 9] {
    let (linear, square) = (0.5 / 0.488_602_511_9, 0.25);
    let cross = 2.0 * square / 1.092_548_430_6;
    [
        (0.25 + square / 3.0) / 0.282_094_791_8,
        linear * m.y,
        -linear * m.z,
        linear * m.x,
        cross * m.x * m.y,
        -cross * m.y * m.z,
        square * (3.0 * m.z * m.z - 1.0) / (6.0 * 0.315_391_565_3),
        -cross * m.x * m.z,
        square * 0.5 * (m.x * m.x - m.y * m.y) / 0.546_274_215_3,
    ]
}

/// Bright colour of a hue in [0, 1).
fn hue(h: f64) -> DVec3 {
    let wave = |shift: f64| 0.5 + 0.5 * (TAU * (h + shift)).cos();
    DVec3::new(wave(0.0), wave(-1.0 / 3.0), wave(1.0 / 3.0)) * 0.85 + DVec3::splat(0.1)
}

/// A disc of dark tiles that fades out, with a soft shadow below the gyroscope; stands still.
fn floor(builder: &mut Builder, random: &mut Random) {
    builder.piece(DVec3::ZERO, |_| (DVec3::ZERO, DVec3::ZERO));
    let count = 12_000;
    for i in 0..count {
        // A sunflower: evenly spread over the disc.
        let radius = 4.6 * ((i as f64 + 0.5) / f64::from(count)).sqrt();
        let angle = TAU * 0.618_033_988_75 * f64::from(i);
        let p = DVec2::from_angle(angle) * radius;
        let tile = ((p.x / 0.6).floor() + (p.y / 0.6).floor()).rem_euclid(2.0);
        let shadow = 1.0 - 0.75 * (-(radius / 1.3).powi(2)).exp();
        let fade = (1.0 - (radius / 4.6).powi(2)).max(0.0);
        let tint = if tile < 0.5 { DVec3::new(0.16, 0.19, 0.26) } else { DVec3::new(0.42, 0.46, 0.55) };
        builder.add(Surface {
            point: p.extend(0.003 * random.normal()),
            normal: DVec3::Z,
            color: tint * shadow * (0.25 + 0.75 * fade),
            gloss: 0.10 * fade,
            size: 0.037,
            opacity: 0.03 + 0.92 * fade.sqrt(),
        });
    }
}

/// A glowing ball, breathing up and down.
fn core(builder: &mut Builder) {
    builder.piece(CENTER, |t| (DVec3::Z * TAU * t, CENTER + DVec3::Z * 0.06 * (TAU * t).sin()));
    for i in 0..2200 {
        let normal = sphere_point(i, 2200);
        let swirl = 0.5 + 0.5 * (3.0 * normal.z + 2.0 * normal.y.atan2(normal.x)).sin();
        let color = DVec3::new(2.2, 1.1, 0.35).lerp(DVec3::new(2.4, 1.9, 1.0), swirl);
        // Lit from within: undo the lamp.
        let glow = 0.30 + 0.20 * normal.z.max(-0.5) + 0.75 * normal.dot(LAMP).max(0.0);
        let point = CENTER + normal * 0.36;
        builder.add(Surface { point, normal, color: color * (0.5 / glow), gloss: 0.0, size: 0.022, opacity: 0.95 });
    }
}

/// Even points on the unit sphere.
fn sphere_point(i: usize, count: usize) -> DVec3 {
    let z = 1.0 - (2.0 * i as f64 + 1.0) / count as f64;
    let angle = TAU * 0.618_033_988_75 * i as f64;
    (DVec2::from_angle(angle) * (1.0 - z * z).sqrt()).extend(z)
}

/// Ring `i` of the gyroscope: a torus turning once about an axis in its plane.
fn ring(builder: &mut Builder, i: usize) {
    let (major, minor) = (0.68 + 0.27 * i as f64, 0.055);
    let axis = [DVec3::X, DVec3::new(0.0, 0.8, 0.6), DVec3::new(0.6, -0.8, 0.0)][i];
    let turns = [2.0, -1.0, 1.0][i];
    builder.piece(CENTER, move |t| (axis * (TAU * turns * t), CENTER + DVec3::Z * 0.06 * (TAU * t).sin()));
    // The ring's plane holds its axis.
    let tilt = DQuat::from_rotation_arc(DVec3::X, axis);
    let count = (4200.0 * major) as usize;
    let tint = [DVec3::new(0.95, 0.25, 0.30), DVec3::new(0.20, 0.75, 0.85), DVec3::new(0.95, 0.72, 0.18)][i];
    for k in 0..count {
        // A two-dimensional golden sequence: even without rows or columns.
        let (along, around) = (TAU * (0.754_877_666_2 * k as f64).fract(), TAU * (0.569_840_291_0 * k as f64).fract());
        let out = DVec2::from_angle(along).extend(0.0);
        let normal = out * around.cos() + DVec3::Z * around.sin();
        let notch = if (along * 16.0 / TAU).fract() < 0.25 { 0.25 } else { 1.0 };
        builder.add(Surface {
            point: CENTER + tilt * (out * major + normal * minor),
            normal: tilt * normal,
            color: tint * notch,
            gloss: 0.45,
            size: 0.015,
            opacity: 0.96,
        });
    }
}

/// Ball `i`: orbits the gyroscope, bobbing, and spins.
fn ball(builder: &mut Builder, i: usize, random: &mut Random) {
    let phase = i as f64 / BALLS as f64;
    let radius = 0.2 + 0.06 * (i % 3) as f64;
    let orbit = move |t: f64| {
        let height = 0.75 + 0.35 * (TAU * (2.0 * t + 3.0 * phase)).sin();
        (DVec2::from_angle(TAU * (phase + t)) * (1.95 + 0.15 * (TAU * 2.0 * phase).cos())).extend(height)
    };
    let spin = DVec3::new(0.3, 0.2, 1.0).normalize() * TAU;
    builder.piece(orbit(0.0), move |t| (spin * t, orbit(t)));
    let stripes = random.direction();
    for k in 0..900 {
        let normal = sphere_point(k, 900);
        let band = (normal.dot(stripes) * 5.0).rem_euclid(2.0) < 1.0;
        let color = if band { hue(phase) } else { DVec3::splat(0.85) };
        let point = orbit(0.0) + normal * radius;
        builder.add(Surface { point, normal, color, gloss: 0.35, size: 0.066 * radius, opacity: 0.96 });
    }
}

/// Bead `i` of the chain: swims along a wave around everything, head first.
fn bead(builder: &mut Builder, i: usize, random: &mut Random) {
    let lag = 0.0115 * i as f64;
    let path = move |t: f64| {
        let phase = TAU * (lag - t);
        (DVec2::from_angle(phase) * 2.75).extend(0.5 + 0.22 * (5.0 * phase).sin())
    };
    builder.piece(path(0.0), move |t| (DVec3::Z * (-TAU * t), path(t)));
    let share = i as f64 / BEADS as f64;
    let radius = if i == 0 { 0.19 } else { 0.15 * (1.0 - 0.7 * share) };
    let count = if i == 0 { 700 } else { 320 };
    for k in 0..count {
        let normal = sphere_point(k, count);
        let speckle = 0.9 + 0.1 * random.normal().clamp(-1.5, 1.5);
        let color = hue(0.33 + 0.42 * share) * speckle;
        let point = path(0.0) + normal * radius;
        let size = 2.0 * radius / (count as f64).sqrt();
        builder.add(Surface { point, normal, color, gloss: 0.3, size, opacity: 0.96 });
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::scene::Rejected;

    #[test]
    fn demo_is_valid_and_loops() {
        let scene = demo_scene();
        let n = scene.gaussians.len();
        assert!((25_000..45_000).contains(&n), "{n}");
        let mut rejected = Rejected::default();
        assert!((0..n).all(|i| scene.gaussians.is_valid(i, &mut rejected)));
        let (superpoints, motion) = (scene.deformation.superpoints().unwrap(), scene.deformation.table().unwrap());
        let m = superpoints.position.len();
        assert_eq!(m, 2 + RINGS + BALLS + BEADS);
        assert_eq!((motion.times.len(), motion.superpoint_count()), (KEY_TIMES, m));
        let place = |k: usize, i: usize| {
            let r = glam::Vec3::from_array(motion.rotation[k * m + i]).as_dvec3();
            let p = glam::Vec3::from_array(superpoints.position[i]).as_dvec3() + DVec3::new(0.1, 0.2, 0.3);
            DQuat::from_scaled_axis(r) * p + glam::Vec3::from_array(motion.translation[k * m + i]).as_dvec3()
        };
        for i in 0..m {
            assert!(place(0, i).distance(place(KEY_TIMES - 1, i)) < 1.0e-4, "piece {i} does not loop");
            let still = glam::Vec3::from_array(superpoints.position[i]).as_dvec3() + DVec3::new(0.1, 0.2, 0.3);
            assert!(place(0, i).distance(still) < 1.0e-5, "piece {i} is not canonical at t = 0");
        }
    }
}
