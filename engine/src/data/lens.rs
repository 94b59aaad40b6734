//! Lenses: how a direction becomes a pixel of a photo.
//!
//! Formulas of OpenCV's `calib3d` and `fisheye`, which COLMAP, google/nerfies and nerfstudio use with the same
//! coefficients: with (x, y) the direction divided by its depth and r² = x² + y²,
//!
//! ```text
//! d   = (1 + k1 r² + k2 r⁴ + k3 r⁶ [+ k r⁸]) / (1 + k4 r² + k5 r⁴ + k6 r⁶)
//! x'  = d x + 2 p1 x y + p2 (r² + 2x²)        y' = d y + p1 (r² + 2y²) + 2 p2 x y
//! fisheye: θ = atan r,  (x', y') = (x, y) θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸) / r
//! u = fx x' + skew y' + cx,  v = fy y' + cy
//! ```

/// Deviation of a lens from a pinhole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Distortion {
    /// A pinhole.
    None,
    /// Radial and tangential.
    Brown {
        /// Coefficients of r², r⁴, r⁶, r⁸ (k1, k2, k3, nerfstudio's k4).
        radial: [f64; 4],
        /// Coefficients of r², r⁴, r⁶ in the denominator (OpenCV's k4, k5, k6).
        rational: [f64; 3],
        /// p1, p2.
        tangential: [f64; 2],
    },
    /// Equidistant fisheye with coefficients of θ², θ⁴, θ⁶, θ⁸.
    Fisheye([f64; 4]),
}

impl Distortion {
    /// [`Distortion::Brown`], or [`Distortion::None`] where all coefficients are 0.
    pub fn brown(radial: [f64; 4], rational: [f64; 3], tangential: [f64; 2]) -> Self {
        let zero = radial.iter().chain(&rational).chain(&tangential).all(|&c| c == 0.0);
        if zero { Self::None } else { Self::Brown { radial, rational, tangential } }
    }

    /// Factor of the radius at radius `r` (of the ray, on the plane at depth 1), without the tangential part.
    fn radial_factor(&self, r: f64) -> f64 {
        let polynomial = |c: &[f64], q: f64| 1.0 + q * c.iter().rev().fold(0.0, |sum, k| k + q * sum);
        match self {
            Self::None => 1.0,
            Self::Brown { radial, rational, .. } => polynomial(radial, r * r) / polynomial(rational, r * r),
            Self::Fisheye(k) => {
                let theta = r.atan();
                let scale = if r > 1.0e-12 { theta / r } else { 1.0 };
                scale * polynomial(k, theta * theta)
            }
        }
    }

    /// The distorted point of the plane at depth 1.
    fn apply(&self, x: f64, y: f64) -> [f64; 2] {
        let r2 = x * x + y * y;
        let d = self.radial_factor(r2.sqrt());
        let [p1, p2] = if let Self::Brown { tangential, .. } = self { *tangential } else { [0.0; 2] };
        [d * x + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x), d * y + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y]
    }

    /// Largest radius up to `limit` below which the distorted radius grows: beyond it the polynomial folds back and means
    /// nothing.
    pub fn valid_radius(&self, limit: f64) -> f64 {
        const STEPS: u32 = 256;
        let distorted = |r: f64| r * self.radial_factor(r);
        let mut last = 0.0;
        for i in 1..=STEPS {
            let r = limit * f64::from(i) / f64::from(STEPS);
            let here = distorted(r);
            if here.is_nan() || here <= last {
                return limit * f64::from(i - 1) / f64::from(STEPS);
            }
            last = here;
        }
        limit
    }
}

/// Intrinsics in pixels (centre of the first pixel at 0.5) and distortion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    /// fx, fy.
    pub focal: [f64; 2],
    /// cx, cy.
    pub principal: [f64; 2],
    /// Pixels that u moves per unit of y.
    pub skew: f64,
    /// Deviation from a pinhole.
    pub distortion: Distortion,
}

impl Lens {
    /// Whether no resampling is needed to make the photo that of a pinhole camera.
    pub fn is_pinhole(&self) -> bool {
        self.distortion == Distortion::None && self.skew == 0.0
    }

    /// The lens of the same photo with its sides scaled.
    pub fn scaled(&self, x: f64, y: f64) -> Self {
        Self {
            focal: [self.focal[0] * x, self.focal[1] * y],
            principal: [self.principal[0] * x, self.principal[1] * y],
            skew: self.skew * x,
            ..*self
        }
    }

    /// Pixel of the photo where the direction (x, y, 1) of the camera appears.
    pub fn project(&self, x: f64, y: f64) -> [f64; 2] {
        let [x, y] = self.distortion.apply(x, y);
        [self.focal[0] * x + self.skew * y + self.principal[0], self.focal[1] * y + self.principal[1]]
    }

    /// Direction (x, y, 1) that the undistorted pinhole picture shows at a pixel: same focal lengths and principal point.
    pub fn pinhole_direction(&self, u: f64, v: f64) -> [f64; 2] {
        [(u - self.principal[0]) / self.focal[0], (v - self.principal[1]) / self.focal[1]]
    }

    /// Largest radius of a direction within the undistorted picture of this size.
    pub fn picture_radius(&self, size: [u32; 2]) -> f64 {
        let [w, h] = size.map(f64::from);
        let corners = [[0.0, 0.0], [w, 0.0], [0.0, h], [w, h]].map(|[u, v]| self.pinhole_direction(u, v));
        corners.into_iter().map(|[x, y]| x.hypot(y)).fold(0.0, f64::max)
    }
}
