//! Paths of a camera through a scene: standing still, once around, or through given views.

use glam::{DMat3, DQuat, DVec3};

use super::Camera;

/// Where a camera goes while a share from 0 to 1 of its way passes.
#[derive(Debug, Clone, PartialEq)]
pub enum CameraPath {
    /// It stays, and only time passes.
    Still(Camera),
    /// Once around the axis through `centre`, starting from `first`; the end is the start again.
    Turntable {
        /// The view at the start.
        first: Camera,
        /// A point of the axis, world units.
        centre: DVec3,
        /// Direction of the axis.
        up: DVec3,
    },
    /// Smoothly through these views, the same share of the way from each to the next.
    Through(Vec<Camera>),
}

impl CameraPath {
    /// The camera at share `s` of the way (held within 0 to 1), with the views' own time interpolated. `None`: a path
    /// through no views.
    pub fn at(&self, s: f64) -> Option<Camera> {
        let s = if s.is_finite() { s.clamp(0.0, 1.0) } else { 0.0 };
        match self {
            Self::Still(camera) => Some(camera.clone()),
            Self::Turntable { first, centre, up } => {
                let turn = DMat3::from_axis_angle(up.normalize_or(DVec3::Z), std::f64::consts::TAU * s);
                let position = *centre + turn * (first.position - *centre);
                Some(Camera { rotation: first.rotation * turn.transpose(), position, ..first.clone() })
            }
            Self::Through(views) => through(views, s),
        }
    }
}

/// Catmull-Rom through the positions, great circles between the orientations, everything else linear. Size and name are
/// those of the view before.
fn through(views: &[Camera], s: f64) -> Option<Camera> {
    let last = views.len().checked_sub(1)?;
    let along = s * last as f64;
    let index = (along.floor() as usize).min(last.saturating_sub(1));
    let u = along - index as f64;
    let at = |i: usize| &views[i.min(last)];
    let (before, a, b, after) = (at(index.saturating_sub(1)), at(index), at(index + 1), at(index + 2));
    let lerp = |x: f64, y: f64| x + (y - x) * u;
    let tangents = [(b.position - before.position) * 0.5, (after.position - a.position) * 0.5];
    let (u2, u3) = (u * u, u * u * u);
    let position = a.position * (2.0 * u3 - 3.0 * u2 + 1.0)
        + tangents[0] * (u3 - 2.0 * u2 + u)
        + b.position * (3.0 * u2 - 2.0 * u3)
        + tangents[1] * (u3 - u2);
    // `slerp` takes the shorter way.
    let [from, to] = [a, b].map(|c| DQuat::from_mat3(&c.rotation).normalize());
    // Views of different sizes are brought to the first one's.
    let scale =
        |c: &Camera| [f64::from(a.width) / f64::from(c.width.max(1)), f64::from(a.height) / f64::from(c.height.max(1))];
    let [sx, sy] = scale(b);
    Some(Camera {
        fx: lerp(a.fx, b.fx * sx),
        fy: lerp(a.fy, b.fy * sy),
        cx: lerp(a.cx, b.cx * sx),
        cy: lerp(a.cy, b.cy * sy),
        rotation: DMat3::from_quat(from.slerp(to, u)),
        position,
        time: lerp(a.time, b.time),
        ..a.clone()
    })
}

/// The direction that is up in these views, on average; `None` when they disagree or there are none.
pub fn mean_up(cameras: &[Camera]) -> Option<DVec3> {
    let sum: DVec3 = cameras.iter().map(|c| c.rotation.transpose() * DVec3::NEG_Y).sum();
    (sum.length() > 0.2 * cameras.len().max(1) as f64).then(|| sum.normalize())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    fn view(eye: DVec3, time: f64) -> Camera {
        Camera { time, ..Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.8, [64, 48]) }
    }

    fn same(a: &Camera, b: &Camera) -> bool {
        let turned = (a.rotation - b.rotation).to_cols_array().iter().all(|v| v.abs() < 1e-9);
        turned && (a.position - b.position).length() < 1e-9 && (a.time - b.time).abs() < 1e-12
    }

    #[test]
    fn a_turntable_comes_back_and_keeps_its_distance() {
        let first = view(DVec3::new(3.0, 1.0, 1.0), 0.0);
        let path = CameraPath::Turntable { first: first.clone(), centre: DVec3::ZERO, up: DVec3::Z };
        assert!(same(&path.at(0.0).unwrap(), &first));
        assert!(same(&path.at(1.0).unwrap(), &first));
        let half = path.at(0.5).unwrap();
        assert!((half.position - DVec3::new(-3.0, -1.0, 1.0)).length() < 1e-9);
        // It looks at the centre all the way.
        for i in 0..20 {
            let c = path.at(f64::from(i) / 20.0).unwrap();
            let centre = c.rotation * (DVec3::ZERO - c.position);
            assert!(centre.x.abs() < 1e-9 && centre.y.abs() < 1e-9 && centre.z > 3.0);
        }
    }

    #[test]
    fn a_path_goes_through_its_views_and_is_smooth() {
        let views: Vec<Camera> = (0..5)
            .map(|i| {
                let angle = f64::from(i) * 0.7;
                view(DVec3::new(3.0 * angle.cos(), 3.0 * angle.sin(), 1.0 + 0.1 * f64::from(i)), f64::from(i) * 0.25)
            })
            .collect();
        let path = CameraPath::Through(views.clone());
        for (i, expected) in views.iter().enumerate() {
            assert!(same(&path.at(i as f64 / 4.0).unwrap(), expected), "{i}");
        }
        let positions: Vec<DVec3> = (0..=400).map(|i| path.at(f64::from(i) / 400.0).unwrap().position).collect();
        let turns = positions.windows(3).map(|p| (p[2] - 2.0 * p[1] + p[0]).length());
        assert!(turns.fold(0.0, f64::max) < 2e-3);
        for i in 0..=400 {
            let r = path.at(f64::from(i) / 400.0).unwrap().rotation;
            assert!((r * r.transpose() - DMat3::IDENTITY).to_cols_array().iter().all(|v| v.abs() < 1e-9));
        }
        assert_eq!(CameraPath::Through(Vec::new()).at(0.5), None);
        assert!(same(&CameraPath::Through(vec![views[2].clone()]).at(0.9).unwrap(), &views[2]));
        assert!(same(&path.at(f64::NAN).unwrap(), &views[0]));
    }

    #[test]
    fn up_is_what_the_views_agree_on() {
        let views = [view(DVec3::new(3.0, 1.0, 0.5), 0.0), view(DVec3::new(-3.0, 1.0, 0.5), 0.0)];
        assert!((mean_up(&views).unwrap() - DVec3::Z).length() < 0.2);
        let mut turned = views[0].clone();
        turned.rotation = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0)) * turned.rotation;
        assert_eq!(mean_up(&[views[0].clone(), turned]), None);
        assert_eq!(mean_up(&[]), None);
    }
}
