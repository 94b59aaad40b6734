//! Blending in f64 by testing every splat at every pixel: slow, simple, and with the rules as arguments, so that what a rule
//! costs can be measured. With the rules of the image that is the truth it must agree with the reference.

use engine::reference::{ALPHA_MIN, Splat, TRANSMITTANCE_MIN};
use engine::scene::Camera;
use glam::DVec2;

/// What may differ between renderers.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rules {
    /// Smallest α that contributes.
    pub(super) alpha_min: f64,
    /// Whether a splat reaches a pixel at all, whatever its α there.
    pub(super) reaches: fn(&Splat, [u32; 2], &Camera) -> bool,
}

impl Default for Rules {
    fn default() -> Self {
        Self { alpha_min: ALPHA_MIN, reaches: |_, _, _| true }
    }
}

/// `[H,W,3]` colours of `splats`, blended in the order given.
pub(super) fn blend<'a>(
    splats: impl Iterator<Item = &'a Splat> + Clone,
    camera: &Camera,
    background: [f64; 3],
    rules: Rules,
) -> Vec<f64> {
    let mut rgb = Vec::with_capacity(3 * camera.width as usize * camera.height as usize);
    for y in 0..camera.height {
        for x in 0..camera.width {
            let point = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let mut transmittance = 1.0;
            let mut color = [0.0; 3];
            for splat in splats.clone() {
                let alpha = splat.alpha(point);
                if alpha < rules.alpha_min || !(rules.reaches)(splat, [x, y], camera) {
                    continue;
                }
                let next = transmittance * (1.0 - alpha);
                if next < TRANSMITTANCE_MIN {
                    break;
                }
                (0..3).for_each(|c| color[c] += alpha * transmittance * splat.color[c]);
                transmittance = next;
            }
            rgb.extend((0..3).map(|c| color[c] + transmittance * background[c]));
        }
    }
    rgb
}
