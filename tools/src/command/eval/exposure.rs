//! `--fit-exposure`: a rendering as each photo was exposed, before it is scored.

use engine::image::Image;
use glam::{DMat4, DVec4};

/// What holds the map to none, in pixels that say so: a photo of one colour does not settle it.
const HOLD: f64 = 1e-3;

/// Maps the colours of `rendered` by the affine map that brings them nearest to `truth`, by least squares.
pub(super) fn fit(rendered: &mut Image, truth: &Image) {
    let color = |p: &[f32; 4]| DVec4::new(p[0].into(), p[1].into(), p[2].into(), 1.0);
    let pairs = || rendered.rgba.as_chunks::<4>().0.iter().zip(truth.rgba.as_chunks::<4>().0);
    let outer = |a: DVec4, b: DVec4| DMat4::from_cols(a * b.x, a * b.y, a * b.z, a * b.w);
    let mut normal = DMat4::from_diagonal(DVec4::splat(HOLD));
    let mut right = DMat4::from_diagonal(DVec4::splat(HOLD));
    for (ours, photo) in pairs() {
        let x = color(ours);
        normal += outer(x, x);
        right += outer(x, color(photo));
    }
    // Columns of the solution are the maps of the channels.
    let map = normal.inverse() * right;
    if map.is_finite() {
        for pixel in rendered.rgba.as_chunks_mut::<4>().0 {
            let x = color(pixel);
            [map.x_axis, map.y_axis, map.z_axis].iter().zip(pixel).for_each(|(m, v)| *v = m.dot(x) as f32);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(pixel: impl Fn(u32) -> [f32; 4]) -> Image {
        Image { width: 16, height: 4, rgba: (0..64).flat_map(pixel).collect(), depth: Vec::new() }
    }

    #[test]
    fn the_map_between_rendering_and_photo_is_found() {
        let ours = |i: u32| [0.1 + 0.01 * i as f32, 0.9 - 0.013 * i as f32, ((i * 29) % 64) as f32 / 70.0, 1.0];
        let photo = |i: u32| {
            let [r, g, b, _] = ours(i);
            [0.7 * r + 0.1 * g + 0.02, 0.9 * g + 0.05 * b, 1.2 * b - 0.1 * r - 0.03, 1.0]
        };
        let (mut rendered, truth) = (image(ours), image(photo));
        fit(&mut rendered, &truth);
        let off = rendered.rgba.iter().zip(&truth.rgba).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(off < 1e-4, "{off}");
    }

    #[test]
    fn one_colour_becomes_the_photo_s_and_stays_finite() {
        for level in [0.0, 0.4] {
            let (mut rendered, truth) = (image(|_| [level; 4]), image(|_| [0.2, 0.3, 0.4, 1.0]));
            fit(&mut rendered, &truth);
            assert!((rendered.rgba[0] - 0.2).abs() < 1e-3 && rendered.rgba.iter().all(|v| v.is_finite()));
        }
    }
}
