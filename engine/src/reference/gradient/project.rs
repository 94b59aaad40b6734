//! Backward of one Gaussian: from its splat to all its parameters.
//!
//! Everything is taken in whitened coordinates, where nothing cancels. With the columns eₖ = J·aₖ (px per world unit; aₖ the
//! k-th axis in camera space), M = (sₖeₖ), Σ₂ = MMᵀ + δI and its inverse's root L (LᵀL = Σ₂⁻¹, upper), let pₖ = L·eₖ and
//! nₖ = sₖpₖ, |nₖ| ≤ 1. From the splat's moments g = Σh(u,v) and H = Σh(u,v)(u,v)ᵀ:
//!
//! - dL/d mean2d = Lᵀg, dL/dΣ₂ = ½LᵀHL, dL/d(sₖeₖ) = LᵀHnₖ;
//! - dL/d ln sₖ = nₖᵀHnₖ;
//! - by a right tangent of the rotation about axis k: (sᵢ² − sⱼ²)·pᵢᵀHpⱼ with i, j, k cyclic (0 for a sphere, exactly);
//! - through z of 1/z in J: −Σ nₖᵀHnₖ / z; through the tangents x/z, y/z of J: −f/z·Lᵀ Σ sₖaₖ.z·Hnₖ, 0 where clamped.
//!
//! Antialiased, the opacity has a factor √(det(MMᵀ) / det Σ₂), of whose logarithm g = Σh is the gradient:
//!
//! - its denominator takes g off the diagonal of H;
//! - det(MMᵀ) = Σ (mₖsᵢsⱼ)² with the minors mₖ = fₓf_y/z²·(x/z, y/z, 1)·aₖ gives dL/d ln sₖ = g·(1 − (mₖsᵢsⱼ)² / det), about axis k
//!   g·mᵢmⱼ·sₖ²(sⱼ² − sᵢ²) / det, and by the tangents g·Σ mₖ(sᵢsⱼ)²·fₓf_y/z²·aₖ.xy / det.
//!
//! With a smoothing σ all of this is by s'ₖ = √(sₖ² + σ²). Then dL/d ln sₖ = (sₖ/s'ₖ)²·dL/d ln s'ₖ + (1 − (sₖ/s'ₖ)²)·g, because
//! the opacity has a factor Π sₖ/s'ₖ, and dL/dσ = Σ (dL/d ln s'ₖ − g)·σ/s'ₖ².
//!
//! The first component of L·eₖ is (δ·eₖ.x + Σⱼ sⱼ²eⱼ.y·(eₖ × eⱼ)) / √(c·det): the difference l₁₁eₖ.x + l₁₂eₖ.y of two large
//! numbers, for a needle, written as a sum of minors.

use glam::{DMat3, DQuat, DVec2, DVec3};

use super::motion::{PoseGradient, pose_gradients, rotation_gradient};
use super::sh::color_gradient;
use super::splats::SplatGradient;
use crate::reference::motion::rigid_quaternion;
use crate::reference::project::tangent_limit;
use crate::reference::soft::{WeightedPose, shift, turn, turned, turned_back};
use crate::reference::{DILATION, Offset, SCALE_MIN};
use crate::scene::Camera;
use crate::scene::parameter::{LIFESPAN, Optional, SMOOTHING, smoothed};

/// A camera as the projection sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// World → camera.
    pub rotation: DMat3,
    /// Camera centre, world units.
    pub position: DVec3,
    /// fx, fy, px.
    pub focal: DVec2,
    /// Ranges in which x/z and y/z enter J: x min, x max, y min, y max.
    pub tangent: [f64; 4],
    /// Of the image.
    pub time: f64,
}

impl From<&Camera> for View {
    fn from(camera: &Camera) -> Self {
        let (x_min, x_max) = tangent_limit(camera.width, camera.fx, camera.cx);
        let (y_min, y_max) = tangent_limit(camera.height, camera.fy, camera.cy);
        Self {
            rotation: camera.rotation,
            position: camera.position,
            focal: DVec2::new(camera.fx, camera.fy),
            tangent: [x_min, x_max, y_min, y_max],
            time: camera.time,
        }
    }
}

/// The parameters of one Gaussian and what moves it.
#[derive(Debug, Clone, PartialEq)]
pub struct OneGaussian {
    /// Canonical centre.
    pub mean: DVec3,
    /// Raw quaternion w,x,y,z.
    pub rotation: [f64; 4],
    /// Log of the standard deviations.
    pub log_scale: [f64; 3],
    /// Before the sigmoid.
    pub opacity_logit: f64,
    /// `[K,3]`.
    pub sh: Vec<f64>,
    /// Of `sh`.
    pub sh_degree: u32,
    /// What moves it: nothing, its superpoint's pose (`vec![pose.into()]`), or `[K]` poses with weights that sum to 1.
    pub poses: Vec<WeightedPose>,
    /// Its non-rigid offset.
    pub offset: Option<Offset>,
    /// Its optional parameters.
    pub optional: Optional<f64>,
    /// [`Gaussians::antialiased`](crate::scene::Gaussians::antialiased).
    pub antialiased: bool,
}

/// Gradients of one Gaussian.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct OneGradient {
    /// Of the canonical centre.
    pub mean: DVec3,
    /// Of the raw quaternion w,x,y,z.
    pub rotation: [f64; 4],
    /// Of the log of the standard deviations.
    pub log_scale: [f64; 3],
    /// Of the opacity before the sigmoid.
    pub opacity_logit: f64,
    /// `[K,3]`.
    pub sh: Vec<f64>,
    /// Of the projected centre, px.
    pub mean2d: DVec2,
    /// `[K]` of the poses that move it.
    pub poses: Vec<PoseGradient>,
    /// Of the non-rigid offset.
    pub offset: Offset,
    /// Of its optional parameters.
    pub optional: Optional<f64>,
    /// Larger eigenvalue of Σ₂, px².
    pub variance: f64,
    /// Pixels per world unit at the centre: the larger focal length over z.
    pub sampling: f64,
}

impl OneGradient {
    /// Of the pose in `slot`; 0 where there is none, as of a Gaussian that is not drawn.
    pub fn pose(&self, slot: usize) -> PoseGradient {
        self.poses.get(slot).copied().unwrap_or_default()
    }
}

/// The projected covariance in whitened coordinates.
struct Whitened {
    /// pₖ = L·eₖ.
    axes: [DVec2; 3],
    /// L = [[x, y], [0, z]].
    factor: DVec3,
    /// Larger eigenvalue of Σ₂.
    variance: f64,
}

fn whiten(axes: [DVec2; 3], scale: [f64; 3]) -> Whitened {
    let m: [DVec2; 3] = std::array::from_fn(|k| axes[k] * scale[k]);
    let sum = |f: fn(DVec2) -> f64| m.iter().map(|&v| f(v)).sum::<f64>();
    let (xx, xy, yy) = (sum(|v| v.x * v.x), sum(|v| v.x * v.y), sum(|v| v.y * v.y));
    let minor = |i: usize, j: usize| (axes[i].perp_dot(axes[j]) * scale[i] * scale[j]).powi(2);
    let det = minor(0, 1) + minor(0, 2) + minor(1, 2) + DILATION * (xx + yy) + DILATION * DILATION;
    let c = yy + DILATION;
    let whitened = |k: usize| {
        let e = axes[k];
        let across: f64 = (0..3).map(|j| m[j].y * scale[j] * e.perp_dot(axes[j])).sum();
        DVec2::new((DILATION * e.x + across) / (c.sqrt() * det.sqrt()), e.y / c.sqrt())
    };
    let half = 0.5 * (xx - yy);
    // 3DGS takes at least √0.1 px² for the root, so that a round splat's radius is a little larger.
    let root = (half * half + xy * xy).max(0.1).sqrt();
    Whitened {
        axes: [whitened(0), whitened(1), whitened(2)],
        factor: DVec3::new((c / det).sqrt(), -xy / (c.sqrt() * det.sqrt()), 1.0 / c.sqrt()),
        variance: 0.5 * (xx + yy) + DILATION + root,
    }
}

/// Backward of one visible Gaussian. `color` is dL/d colour behind the clamp: 0 in channels that are clamped at 0.
pub fn backward(g: &OneGaussian, view: &View, splat: &SplatGradient, color: [f64; 3]) -> OneGradient {
    let turned_mean = turned(&g.poses, g.mean);
    let shift = shift(&g.poses) + g.offset.map_or(DVec3::ZERO, |o| o.mean.into());
    let offset = turned_mean + shift - view.position;
    let p = view.rotation * offset;
    let turn = turn(&g.poses);
    let quaternion = rigid_quaternion(g.rotation, turn) + g.offset.map_or(DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), dq);
    let axes = view.rotation * DMat3::from_quat(quaternion.normalize());
    let own: [f64; 3] = g.log_scale.map(f64::exp);
    let added: [f64; 3] = std::array::from_fn(|k| own[k] + g.offset.map_or(0.0, |o| o.scale[k]));
    let sharp: [f64; 3] = if g.offset.is_some() { added.map(|s| s.max(SCALE_MIN)) } else { own };
    let sigma = g.optional.get(SMOOTHING).and_then(|s| s.first()).copied().unwrap_or(0.0);
    let scale = smoothed(sharp, sigma).0;

    let slope = DVec2::new(p.x / p.z, p.y / p.z);
    let [x_min, x_max, y_min, y_max] = view.tangent;
    let tangent = DVec2::new(slope.x.max(x_min).min(x_max), slope.y.max(y_min).min(y_max));
    let axis = |k: usize| view.focal / p.z * (axes.col(k).truncate() - tangent * axes.col(k).z);
    let w = whiten([axis(0), axis(1), axis(2)], scale);

    let area = if g.antialiased { splat.h } else { 0.0 };
    let [uu, uv, vv] = splat.second;
    let (uu, vv) = (uu - area, vv - area);
    let times_h = |a: DVec2| DVec2::new(uu * a.x + uv * a.y, uv * a.x + vv * a.y);
    let times_factor = |a: DVec2| DVec2::new(w.factor.x * a.x, w.factor.y * a.x + w.factor.z * a.y);
    let mean2d = times_factor(DVec2::from_array(splat.first));
    let without = own_area(axes, scale, tangent, view.focal / p.z, area);
    let relative: [f64; 3] =
        std::array::from_fn(|k| scale[k] * scale[k] * w.axes[k].dot(times_h(w.axes[k])) + without.relative[k]);
    let turn_about =
        |i: usize, j: usize| (scale[i] - scale[j]) * (scale[i] + scale[j]) * w.axes[i].dot(times_h(w.axes[j]));
    let local = DVec3::new(turn_about(1, 2), turn_about(2, 0), turn_about(0, 1)) + without.local;
    let depth_weighted: DVec2 = (0..3).map(|k| times_h(w.axes[k]) * (scale[k] * scale[k] * axes.col(k).z)).sum();
    let mut slope_gradient = -view.focal / p.z * times_factor(depth_weighted) + without.tangent;
    let inside = |at: f64, low: f64, high: f64| f64::from(u8::from(at > low && at < high));
    slope_gradient *= DVec2::new(inside(slope.x, x_min, x_max), inside(slope.y, y_min, y_max));
    slope_gradient += view.focal * mean2d;
    let camera_gradient = DVec3::new(
        slope_gradient.x / p.z,
        slope_gradient.y / p.z,
        -(slope_gradient.dot(slope) + relative.iter().sum::<f64>()) / p.z,
    );

    let (sh, direction) = color_gradient(&g.sh, g.sh_degree, offset, color);
    let moved = view.rotation.transpose() * camera_gradient + direction;
    let rotation = rotation_gradient(g.rotation, turn.unwrap_or(DQuat::IDENTITY), g.offset.map(|o| o.rotation), local);
    // dL/ds; clamped standard deviations do not depend on anything.
    let by_sharp = |k: usize| {
        let share = (sharp[k] / scale[k]).powi(2);
        share * relative[k] + (1.0 - share) * splat.h
    };
    let free: [f64; 3] = std::array::from_fn(|k| if sharp[k] > added[k] { 0.0 } else { by_sharp(k) / sharp[k] });
    let by_sigma = (0..3).map(|k| (relative[k] - splat.h) * sigma / scale[k].powi(2)).sum();
    OneGradient {
        mean: turned_back(&g.poses, moved),
        rotation: rotation.raw,
        log_scale: std::array::from_fn(|k| free[k] * own[k]),
        opacity_logit: splat.h / (1.0 + g.opacity_logit.exp()),
        sh,
        mean2d,
        poses: pose_gradients(&g.poses, g.mean, moved, rotation.world),
        offset: Offset { mean: moved.to_array(), rotation: rotation.offset, scale: free },
        optional: optional_gradient(g, view.time, splat.h, by_sigma),
        variance: w.variance,
        sampling: view.focal.max_element() / p.z,
    }
}

/// What the area of a Gaussian without dilation passes on.
#[derive(Default)]
struct AreaGradient {
    relative: [f64; 3],
    local: DVec3,
    tangent: DVec2,
}

/// `g`: dL/d ln √det(MMᵀ); `focal`: over z.
fn own_area(axes: DMat3, scale: [f64; 3], tangent: DVec2, focal: DVec2, g: f64) -> AreaGradient {
    if g == 0.0 {
        return AreaGradient::default();
    }
    let ray = tangent.extend(1.0);
    let minor: [f64; 3] = std::array::from_fn(|k| focal.x * focal.y * axes.col(k).dot(ray));
    let opposite: [f64; 3] = std::array::from_fn(|k| (scale[(k + 1) % 3] * scale[(k + 2) % 3]).powi(2));
    let squared: [f64; 3] = std::array::from_fn(|k| minor[k] * minor[k] * opposite[k]);
    let share = g / squared.iter().sum::<f64>();
    let about = |k: usize| {
        let [i, j] = [(k + 1) % 3, (k + 2) % 3];
        share * minor[i] * minor[j] * scale[k] * scale[k] * (scale[j] - scale[i]) * (scale[j] + scale[i])
    };
    let pull: DVec3 = (0..3).map(|k| axes.col(k) * (minor[k] * opposite[k])).sum();
    AreaGradient {
        relative: std::array::from_fn(|k| share * (squared[(k + 1) % 3] + squared[(k + 2) % 3])),
        local: DVec3::new(about(0), about(1), about(2)),
        tangent: share * focal.x * focal.y * pull.truncate(),
    }
}

/// Gradients of the optional parameters; `h`: of the log of the opacity, `by_sigma`: of the smoothing.
fn optional_gradient(g: &OneGaussian, time: f64, h: f64, by_sigma: f64) -> Optional<f64> {
    let mut gradient = Optional::default();
    if let Some(&[middle, log_length]) = g.optional.get(LIFESPAN) {
        let inverse = (-log_length).exp();
        let x = (time - middle) * inverse;
        gradient.set(LIFESPAN, vec![h * x * inverse, h * x * x]);
    }
    if g.optional.get(SMOOTHING).is_some() {
        gradient.set(SMOOTHING, vec![by_sigma]);
    }
    gradient
}

fn dq(offset: Offset) -> DQuat {
    let [w, x, y, z] = offset.rotation;
    DQuat::from_xyzw(x, y, z, w)
}
