//! The views through which a scene is looked at: from all sides, where it is at each view's time.

use engine::error::Result;
use engine::scene::{Camera, Scene};

use super::moment::Moments;
use crate::cli::camera;

/// Cameras, and the near plane that suits them all.
pub(crate) struct Around {
    pub(crate) cameras: Vec<Camera>,
    pub(crate) near: f32,
}

/// Cameras around a scene, all at one time where that is given. A scene need not be where it is at rest, nor as large: each
/// looks at it as it is at its own time.
pub(crate) fn around(moments: &Moments<'_>, size: [u32; 2], count: usize, time: Option<f64>) -> Result<Around> {
    let scene = moments.scene();
    let mut cameras = camera::orbit(scene, size, count);
    if let Some(time) = time {
        cameras.iter_mut().for_each(|c| c.time = time);
    }
    if !scene.is_dynamic() {
        return Ok(Around { cameras, near: camera::near(scene) });
    }
    let mut near = f32::INFINITY;
    let mut placed: Option<(f64, Scene)> = None;
    for (i, camera) in cameras.iter_mut().enumerate() {
        let time = camera.time;
        let known = placed.take().filter(|(t, _)| *t == time).map(|(_, scene)| scene);
        let there = match known {
            Some(scene) => scene,
            None => Scene { gaussians: moments.at(time)?, ..Scene::default() },
        };
        *camera = Camera { time, ..camera::orbit(&there, size, count).swap_remove(i) };
        near = near.min(camera::near(&there));
        placed = Some((time, there));
    }
    Ok(Around { cameras, near })
}
