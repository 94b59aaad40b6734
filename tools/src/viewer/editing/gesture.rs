//! Moving, turning and scaling with the pointer or with typed numbers, as Blender's G, R and S do.

use engine::scene::Camera;
use glam::{DAffine3, DMat3, DQuat, DVec2, DVec3};

/// What a gesture does.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) enum Kind {
    #[default]
    Move,
    Turn,
    Scale,
}

/// A gesture that goes on.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Gesture {
    pub(crate) kind: Kind,
    /// The world's axis that it keeps to: 0, 1 or 2.
    pub(crate) axis: Option<usize>,
    /// Where the pointer was at its start and is now, pixels of the window.
    pub(crate) from: DVec2,
    pub(crate) to: DVec2,
    /// A number that is typed instead.
    pub(crate) typed: String,
    /// What stays where it is in a turn or a scale, world units.
    pub(crate) center: DVec3,
    /// It ends when the button is let go.
    pub(crate) held: bool,
}

/// What comes of a gesture: numbers as they stand in its command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Amount {
    /// By this vector, world units.
    Move(DVec3),
    /// Around this axis, degrees.
    Turn(DVec3, f64),
    /// By factors along the axes.
    Scale(DVec3),
}

impl Amount {
    /// The map of points, about `center`.
    pub(crate) fn map(&self, center: DVec3) -> DAffine3 {
        let about = |matrix: DMat3| DAffine3::from_mat3_translation(matrix, center - matrix * center);
        match self {
            Self::Move(by) => DAffine3::from_translation(*by),
            Self::Turn(axis, degrees) => {
                let turn = DQuat::from_axis_angle(axis.normalize_or(DVec3::Z), degrees.to_radians());
                about(DMat3::from_quat(turn))
            }
            Self::Scale(factors) => about(DMat3::from_diagonal(*factors)),
        }
    }
}

impl Gesture {
    /// What it comes to so far, seen through `camera`.
    pub(crate) fn amount(&self, camera: &Camera) -> Amount {
        let typed: Option<f64> = self.typed.parse().ok().filter(|v: &f64| v.is_finite());
        let axis = self.axis.map(|k| DVec3::AXES[k]);
        match self.kind {
            Kind::Move => Amount::Move(match typed {
                // No zeros with a sign.
                Some(by) => by * axis.unwrap_or(DVec3::X) + DVec3::ZERO,
                None => self.shift(camera, axis),
            }),
            Kind::Turn => {
                let forward = camera.rotation.row(2);
                let degrees = typed.unwrap_or_else(|| {
                    let side = if axis.is_some_and(|axis| axis.dot(forward) < 0.0) { -1.0 } else { 1.0 };
                    side * rounded(self.angle(camera).to_degrees(), 1)
                });
                Amount::Turn(axis.unwrap_or(forward), degrees)
            }
            Kind::Scale => {
                let factor = typed.unwrap_or_else(|| rounded(self.factor(camera), 3)).max(1e-3);
                let along = |axis: DVec3| DVec3::ONE + (factor - 1.0) * axis;
                Amount::Scale(axis.map_or(DVec3::splat(factor), along))
            }
        }
    }

    /// As far as the pointer has moved at the depth of the centre, or along an axis. Rounded to less than a pixel.
    fn shift(&self, camera: &Camera, axis: Option<DVec3>) -> DVec3 {
        let depth = (camera.rotation * (self.center - camera.position)).z;
        if depth <= 0.0 {
            return DVec3::ZERO;
        }
        let by = match axis {
            None => {
                let by = self.to - self.from;
                camera.rotation.transpose() * DVec3::new(by.x / camera.fx, by.y / camera.fy, 0.0) * depth
            }
            Some(axis) => axis * (self.along(camera, axis, self.to) - self.along(camera, axis, self.from)),
        };
        let decimals = (camera.fx / depth).log10().ceil().clamp(0.0, 12.0) as usize;
        DVec3::from_array(by.to_array().map(|v| rounded(v, decimals)))
    }

    /// Where on the axis through the centre the ray of a pixel comes closest; 0 of rays along the axis.
    fn along(&self, camera: &Camera, axis: DVec3, at: DVec2) -> f64 {
        let ray = DVec3::new((at.x - camera.cx) / camera.fx, (at.y - camera.cy) / camera.fy, 1.0);
        let ray = camera.rotation.transpose() * ray.normalize();
        let (to_eye, slope) = (camera.position - self.center, axis.dot(ray));
        let sine2 = 1.0 - slope * slope;
        if sine2 < 1e-4 { 0.0 } else { (to_eye.dot(axis) - slope * to_eye.dot(ray)) / sine2 }
    }

    /// Pixel of the centre.
    fn pivot(&self, camera: &Camera) -> DVec2 {
        let v = camera.rotation * (self.center - camera.position);
        let z = if v.z.abs() < 1e-9 { 1e-9 } else { v.z };
        DVec2::new(camera.cx + camera.fx * v.x / z, camera.cy + camera.fy * v.y / z)
    }

    /// By which the pointer has gone around the centre, radians: to the right of a clock's hands where above 0.
    fn angle(&self, camera: &Camera) -> f64 {
        let pivot = self.pivot(camera);
        let [a, b] = [self.from - pivot, self.to - pivot];
        if a == DVec2::ZERO || b == DVec2::ZERO { 0.0 } else { a.angle_to(b) }
    }

    /// How many times as far from the centre the pointer is.
    fn factor(&self, camera: &Camera) -> f64 {
        let pivot = self.pivot(camera);
        self.to.distance(pivot) / self.from.distance(pivot).max(1.0)
    }
}

/// Rounded to decimals, so that commands are short.
fn rounded(value: f64, decimals: usize) -> f64 {
    let rounded = format!("{value:.decimals$}").parse().unwrap_or(value);
    if rounded == 0.0 { 0.0 } else { rounded }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera::look_at(DVec3::new(0.0, -5.0, 0.0), DVec3::ZERO, DVec3::Z, 0.8, [800, 600])
    }

    fn gesture(kind: Kind, axis: Option<usize>, by: [f64; 2]) -> Gesture {
        let from = DVec2::new(500.0, 300.0);
        Gesture {
            kind,
            axis,
            from,
            to: from + DVec2::from_array(by),
            typed: String::new(),
            center: DVec3::ZERO,
            held: false,
        }
    }

    fn pixel(camera: &Camera, x: DVec3) -> DVec2 {
        Gesture { center: x, ..gesture(Kind::Move, None, [0.0; 2]) }.pivot(camera)
    }

    #[test]
    fn what_moves_stays_under_the_pointer() {
        let camera = camera();
        for axis in [None, Some(0), Some(2)] {
            let by = if axis == Some(2) { [0.0, -120.0] } else { [90.0, 0.0] };
            let map = gesture(Kind::Move, axis, by).amount(&camera).map(DVec3::ZERO);
            let moved = pixel(&camera, map.transform_point3(DVec3::ZERO)) - pixel(&camera, DVec3::ZERO);
            // Along an axis it is the nearest point of it, from a pointer beside it.
            assert!(moved.distance(DVec2::from_array(by)) < 2.0, "{axis:?}: {moved}");
        }
        // Straight at the axis there is no way along it.
        assert_eq!(gesture(Kind::Move, Some(1), [0.0, 0.0]).amount(&camera), Amount::Move(DVec3::ZERO));
    }

    #[test]
    fn turns_follow_the_pointer_around_the_centre() {
        // From the right of the centre to below it: a quarter with the clock.
        let camera = camera();
        let point = DVec3::new(0.5, 0.0, 0.0);
        for axis in [None, Some(1)] {
            let map = gesture(Kind::Turn, axis, [-100.0, 100.0]).amount(&camera).map(DVec3::ZERO);
            let turned = map.transform_point3(point);
            assert!(turned.distance(DVec3::new(0.0, 0.0, -0.5)) < 1e-9, "{axis:?}: {turned}");
        }
        let behind = Camera::look_at(DVec3::new(0.0, 5.0, 0.0), DVec3::ZERO, DVec3::Z, 0.8, [800, 600]);
        let map = gesture(Kind::Turn, Some(1), [-100.0, 100.0]).amount(&behind).map(DVec3::ZERO);
        let (was, is) = (pixel(&behind, point), pixel(&behind, map.transform_point3(point)));
        assert!((was.x < 400.0) && is.y < 300.0, "{was} {is}");
    }

    #[test]
    fn scales_and_typed_numbers() {
        let camera = camera();
        assert_eq!(gesture(Kind::Scale, None, [50.0, 0.0]).amount(&camera), Amount::Scale(DVec3::splat(1.5)));
        let along = gesture(Kind::Scale, Some(2), [100.0, 0.0]).amount(&camera);
        assert_eq!(along, Amount::Scale(DVec3::new(1.0, 1.0, 2.0)));
        let typed = |kind, axis, typed: &str| {
            Gesture { typed: typed.into(), ..gesture(kind, axis, [13.0, 7.0]) }.amount(&camera)
        };
        assert_eq!(typed(Kind::Move, Some(1), "-0.25"), Amount::Move(DVec3::new(0.0, -0.25, 0.0)));
        assert_eq!(typed(Kind::Turn, Some(2), "30"), Amount::Turn(DVec3::Z, 30.0));
        assert_eq!(typed(Kind::Scale, None, "0"), Amount::Scale(DVec3::splat(1e-3)));
    }
}
