//! Hard cases: small scenes, each of which has broken some renderer. Every one has an exact f64 image to be compared with.

mod build;
mod motion;

use self::build::{ahead, case, cloud, constant_color, look, sized, stack};
use super::Random;
use crate::scene::{Camera, Gaussians, Scene};

/// One hard case.
#[derive(Debug, Clone, PartialEq)]
pub struct HardCase {
    /// Short name, unique.
    pub name: &'static str,
    /// What is hard about it, in one sentence.
    pub doc: &'static str,
    /// What to render.
    pub scene: Scene,
    /// From where.
    pub camera: Camera,
    /// When.
    pub time: f64,
    /// Near plane, world units.
    pub near: f32,
    /// Colour behind everything.
    pub background: [f32; 3],
    /// How many Gaussians must be rejected as unusable.
    pub rejected: usize,
    /// Whether nothing at all is to be seen.
    pub empty: bool,
}

/// All hard cases. Each takes well under a second on a CPU.
pub fn hard_cases() -> Vec<HardCase> {
    let mut cases = shapes();
    cases.extend(near_plane());
    cases.extend(order());
    cases.extend(opacities());
    cases.extend(views());
    cases.extend(counts());
    cases.extend(image_sizes());
    cases.extend(motion::cases());
    cases
}

fn shapes() -> Vec<HardCase> {
    let needles = |ratio: f64| {
        let mut g = cloud(300, 1);
        for scale in &mut g.log_scale {
            *scale = [-1.0, (-1.0 - ratio.ln()) as f32, (-1.0 - ratio.ln()) as f32];
        }
        g
    };
    let mut unnormalised = cloud(300, 2);
    for (i, q) in unnormalised.rotation.iter_mut().enumerate() {
        *q = q.map(|x| x * 10.0f32.powi(i as i32 % 19 - 9));
    }
    let mut poisoned = cloud(306, 3);
    poison(&mut poisoned);
    let mut extreme = sized(cloud(60, 4), (-20.0f64).exp());
    extreme.log_scale[7] = [20.0; 3];
    extreme.opacity_logit[7] = -3.0;
    extreme.log_scale[8] = [20.0, -20.0, 0.0];
    let mut huge = sized(cloud(20, 5), 100.0);
    huge.opacity_logit.fill(-2.0);
    vec![
        case("needles_1e2", "Axis ratio 1e2: the 2-D covariance is nearly singular.", needles(1.0e2), look(96, 96)),
        case("needles_1e4", "Axis ratio 1e4: ac − b² cancels completely in f32.", needles(1.0e4), look(96, 96)),
        case("needles_1e6", "Axis ratio 1e6: only the dilation gives needles a width.", needles(1.0e6), look(96, 96)),
        case(
            "scale_1e-8",
            "Standard deviations 1e-8: splats are pure dilation.",
            sized(cloud(500, 6), 1.0e-8),
            look(64, 64),
        ),
        case("scale_beyond_frustum", "Gaussians larger than the frustum cover every tile.", huge, look(64, 64)),
        case("scale_e20", "Standard deviations e^-20, and two of e^20 in the same scene.", extreme, look(64, 64)),
        case("quaternion_lengths", "Quaternions of length 1e-9 to 1e9.", unnormalised, look(64, 64)),
        HardCase {
            rejected: 6,
            ..case(
                "poison",
                "NaN, infinity, a zero quaternion and absurd sizes among good Gaussians.",
                poisoned,
                look(64, 64),
            )
        },
    ]
}

/// Makes Gaussians 0, 50, …, 250 unusable, each in another way.
fn poison(g: &mut Gaussians) {
    g.mean[0] = [f32::NAN, 0.0, 0.0];
    g.log_scale[50][1] = f32::INFINITY;
    g.rotation[100] = [0.0; 4];
    g.opacity_logit[150] = f32::NAN;
    g.log_scale[200] = [80.0; 3];
    g.sh[250 * 3] = f32::NEG_INFINITY;
}

fn near_plane() -> Vec<HardCase> {
    let near = 0.2f32;
    let ulps = [near.next_down(), near, near.next_up(), 0.25, -near, 0.0, f32::MIN_POSITIVE, -0.0];
    let mut at_plane = stack(&ulps, 0.5, 0.05);
    constant_color(&mut at_plane);
    let mut inside = cloud(200, 11);
    inside.mean[0] = [0.1, -0.05, -3.5];
    inside.log_scale[0] = [0.5; 3];
    inside.opacity_logit[0] = 0.0;
    let mut at_eye = cloud(100, 12);
    at_eye.mean[0] = [0.0, 0.0, -4.0];
    at_eye.mean[1] = [0.0, 1.0e-20, -4.0];
    let close: Vec<f32> = (0..40).map(|i| 0.0101 + 0.0005 * i as f32).collect();
    vec![
        case(
            "near_plane_ulps",
            "Centres one ulp before, on and behind the near plane, at z = 0 and behind.",
            at_plane,
            ahead(48, 48),
        ),
        case("camera_inside", "The camera is inside a Gaussian whose centre is in front.", inside, look(64, 64)),
        case("mean_at_camera", "A centre at the camera itself has no direction and no depth.", at_eye, look(64, 64)),
        HardCase {
            near: 0.01,
            ..case(
                "almost_zero_depth",
                "Depths just beyond a near plane at 0.01 magnify a hundredfold.",
                stack(&close, 0.3, 0.002),
                ahead(64, 64),
            )
        },
    ]
}

fn order() -> Vec<HardCase> {
    let mut random = Random::new(21);
    let mut ties = stack(&[2.0; 300], 0.6, 0.15);
    for mean in &mut ties.mean {
        (mean[0], mean[1]) = (random.range(-0.7, 0.7) as f32, random.range(-0.7, 0.7) as f32);
    }
    let mut reversed = stack(&(0..300).map(|i| 3.0 - 0.005 * i as f32).collect::<Vec<_>>(), 0.4, 0.3);
    reversed.mean.iter_mut().for_each(|m| m[0] = random.range(-0.5, 0.5) as f32);
    let depths: Vec<f32> = (0..800).map(|_| 10.0f64.powf(random.range(-3.0, 5.0)) as f32).collect();
    let mut wide = stack(&depths, 0.3, 1.0);
    for (i, z) in depths.iter().enumerate() {
        wide.mean[i] = [z * random.range(-0.6, 0.6) as f32, z * random.range(-0.6, 0.6) as f32, *z];
        wide.log_scale[i] = [(0.04 * z).ln(); 3];
    }
    vec![
        case("equal_depths", "300 overlapping Gaussians at one depth: the index decides.", ties, ahead(64, 64)),
        case(
            "one_point",
            "500 Gaussians of different colours at one point.",
            stack(&[2.0; 500], 0.05, 0.2),
            ahead(48, 48),
        ),
        case("reverse_order", "Stored back to front.", reversed, ahead(64, 64)),
        HardCase { near: 1.0e-4, ..case("depth_range", "Depths from 1e-3 to 1e5 in one image.", wide, ahead(96, 96)) },
    ]
}

fn opacities() -> Vec<HardCase> {
    let depths = |n: usize| (0..n).map(|i| 1.0 + 0.01 * i as f32).collect::<Vec<_>>();
    let mut opaque = stack(&depths(12), 1.0, 0.4);
    for (i, mean) in opaque.mean.iter_mut().enumerate() {
        mean[0] = 0.02 * i as f32 - 0.1;
    }
    let mut limits = cloud(200, 31);
    for (i, logit) in limits.opacity_logit.iter_mut().enumerate() {
        let threshold = -(254.0f32).ln();
        let choices =
            [f32::INFINITY, f32::NEG_INFINITY, threshold, threshold + 1.0e-4, threshold - 1.0e-4, 88.0, -104.0];
        *logit = choices[i % choices.len()];
    }
    let faint = stack(&depths(300), 1.05 / 255.0, 0.5);
    let mut saturated = cloud(300, 32);
    saturated.sh.iter_mut().for_each(|c| *c *= 50.0);
    vec![
        case("faint_layers", "300 layers with α just above 1/255.", faint, ahead(48, 48)),
        HardCase {
            background: [1.0, 0.0, 0.5],
            ..case(
                "alpha_clamp",
                "Fully opaque layers: α is clamped at 0.99, and two of them leave exactly T = 1e-4, which does not stop a pixel.",
                opaque,
                ahead(48, 48),
            )
        },
        case(
            "opacity_limits",
            "Opacity logits ±infinity, ±overflow of exp, and at 1/255 ± a little.",
            limits,
            look(64, 64),
        ),
        case("bright_and_dark", "Colours far above 1 and far below 0 (clamped at 0 only).", saturated, look(64, 64)),
    ]
}

fn views() -> Vec<HardCase> {
    let wide = Camera { fx: 12.0, fy: 12.0, ..look(96, 96) };
    let mut border = cloud(400, 41);
    border.mean.iter_mut().for_each(|m| *m = m.map(|x| 6.0 * x));
    let off_center = Camera { cx: -8.0, cy: 70.0, ..look(64, 64) };
    let uneven = Camera { fx: 150.0, fy: 40.0, ..look(64, 64) };
    let mut far = cloud(400, 42);
    let offset = [1.0e6f32, -1.0e6, 1.0e6];
    for (mean, scale) in far.mean.iter_mut().zip(&mut far.log_scale) {
        *mean = std::array::from_fn(|k| 100.0 * mean[k] + offset[k]);
        *scale = scale.map(|s| s + 100.0f32.ln());
    }
    let mut far_camera = look(64, 64);
    far_camera.position = far_camera.position * 100.0 + glam::DVec3::from_array(offset.map(f64::from));
    vec![
        case(
            "wide_field_of_view",
            "152 degrees: Gaussians beside and behind the camera, Jacobians clamped.",
            border,
            wide,
        ),
        case("principal_point_outside", "The principal point is outside the image.", cloud(400, 43), off_center),
        case("uneven_focal_lengths", "fx and fy differ by a factor of four.", cloud(400, 44), uneven),
        case("world_offset_1e6", "Everything a million units from the origin.", far, far_camera),
    ]
}

fn counts() -> Vec<HardCase> {
    let mut random = Random::new(51);
    let mut crowd = stack(&vec![1.0; 66_000], 1.2 / 255.0, 0.02);
    for mean in &mut crowd.mean {
        *mean = [random.range(-0.2, 0.2) as f32, random.range(-0.2, 0.2) as f32, random.range(1.0, 2.0) as f32];
    }
    let mut full = sized(cloud(2000, 52), 3.0);
    full.opacity_logit.fill(-3.5);
    let mut behind = cloud(300, 53);
    behind.mean.iter_mut().for_each(|m| m[2] -= 10.0);
    let nothing = |name, doc, g, camera| HardCase { empty: true, ..case(name, doc, g, camera) };
    vec![
        nothing("no_gaussians", "An empty scene shows the background.", cloud(0, 0), look(33, 17)),
        nothing("none_visible", "All Gaussians are behind the camera.", behind, look(33, 17)),
        case("one_gaussian", "A single Gaussian.", sized(cloud(1, 56), 1.0), look(33, 17)),
        case("two_gaussians", "Two Gaussians.", sized(cloud(2, 55), 1.0), look(33, 17)),
        case("crowded_tile", "66,000 splats in one tile: more than 16 bits count.", crowd, ahead(16, 16)),
        case("all_full_screen", "2,000 Gaussians, each covering the whole image.", full, look(64, 64)),
    ]
}

fn image_sizes() -> Vec<HardCase> {
    let sizes: [(&str, u32, u32); 9] = [
        ("image_1x1", 1, 1),
        ("image_1x17", 1, 17),
        ("image_17x1", 17, 1),
        ("image_15x15", 15, 15),
        ("image_16x16", 16, 16),
        ("image_17x17", 17, 17),
        ("image_257x257", 257, 257),
        ("image_16384x1", 16384, 1),
        ("image_1x16384", 1, 16384),
    ];
    sizes
        .map(|(name, width, height)| {
            // Sizes beside the multiples of the tile and at the largest one; the focal length follows the longer side.
            case(name, "An image size at or beside a limit.", cloud(300, 61), look(width, height))
        })
        .to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_cases_are_small() {
        let cases = hard_cases();
        let mut names: Vec<&str> = cases.iter().map(|c| c.name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), cases.len());
        assert!(cases.len() >= 45, "{}", cases.len());
        assert!(cases.iter().all(|c| c.doc.ends_with('.') && c.scene.gaussians.len() <= 66_000));
    }
}
