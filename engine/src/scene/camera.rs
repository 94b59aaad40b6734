//! Pinhole camera, OpenCV axes (x right, y down, z forward), pixel centres at +0.5.

use glam::{DMat3, DMat4, DVec2, DVec3};

/// A posed image plane at a time.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// Name of the frame in the camera file.
    pub name: String,
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// Focal length, pixels.
    pub fx: f64,
    /// Focal length, pixels.
    pub fy: f64,
    /// Principal point, pixels from the left edge of the image.
    pub cx: f64,
    /// Principal point, pixels from the top edge of the image.
    pub cy: f64,
    /// Rotation world → camera (orthonormal).
    pub rotation: DMat3,
    /// Camera centre, world units.
    pub position: DVec3,
    /// Time of the frame, in the unit of the motion table.
    pub time: f64,
}

impl Camera {
    /// From a world-to-camera matrix with a rigid upper 3×4 part.
    pub fn from_world_to_camera(matrix: DMat4, intrinsics: [f64; 4], size: [u32; 2]) -> Self {
        let rotation = DMat3::from_mat4(matrix);
        let translation = matrix.w_axis.truncate();
        let [fx, fy, cx, cy] = intrinsics;
        Self {
            name: String::new(),
            width: size[0],
            height: size[1],
            fx,
            fy,
            cx,
            cy,
            rotation,
            position: -(rotation.transpose() * translation),
            time: 0.0,
        }
    }

    /// Looks from `eye` at `target`, `up` pointing up in the image; horizontal field of view in radians.
    pub fn look_at(eye: DVec3, target: DVec3, up: DVec3, fov_x: f64, size: [u32; 2]) -> Self {
        let z = (target - eye).normalize_or(DVec3::Z);
        let x = z.cross(up).normalize_or(z.any_orthonormal_vector());
        let y = z.cross(x);
        let f = 0.5 * f64::from(size[0]) / (0.5 * fov_x).tan();
        Self {
            name: String::new(),
            width: size[0],
            height: size[1],
            fx: f,
            fy: f,
            cx: 0.5 * f64::from(size[0]),
            cy: 0.5 * f64::from(size[1]),
            rotation: DMat3::from_cols(x, y, z).transpose(),
            position: eye,
            time: 0.0,
        }
    }

    /// The same view at another resolution (focal and principal point scale with it).
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let sx = f64::from(width) / f64::from(self.width);
        let sy = f64::from(height) / f64::from(self.height);
        Self { width, height, fx: self.fx * sx, fy: self.fy * sy, cx: self.cx * sx, cy: self.cy * sy, ..self.clone() }
    }

    /// A part of the view, from pixel `first` on.
    #[must_use]
    pub fn cropped(&self, first: [u32; 2], [width, height]: [u32; 2]) -> Self {
        let [x, y] = first.map(f64::from);
        Self { width, height, cx: self.cx - x, cy: self.cy - y, ..self.clone() }
    }

    /// Where the camera sees a point (world units), pixels; `None` behind it.
    pub fn project(&self, point: DVec3) -> Option<DVec2> {
        let p = self.rotation * (point - self.position);
        (p.z > 0.0).then(|| DVec2::new(self.fx * p.x / p.z + self.cx, self.fy * p.y / p.z + self.cy))
    }

    /// World-to-camera matrix.
    pub fn world_to_camera(&self) -> DMat4 {
        let t = -(self.rotation * self.position);
        DMat4::from_cols(
            self.rotation.x_axis.extend(0.0),
            self.rotation.y_axis.extend(0.0),
            self.rotation.z_axis.extend(0.0),
            t.extend(1.0),
        )
    }
}
