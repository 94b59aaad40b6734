//! Pictures of where two pictures differ.

use engine::image::Image;
use engine::metrics::{FlipMap, Planes};

/// Colours of errors from 0 to 1, dark to bright, of even steps in lightness.
const RAMP: [[f32; 3]; 8] = [
    [0.0, 0.0, 0.02],
    [0.16, 0.05, 0.33],
    [0.37, 0.08, 0.43],
    [0.58, 0.15, 0.40],
    [0.79, 0.25, 0.28],
    [0.93, 0.42, 0.13],
    [0.98, 0.66, 0.15],
    [0.99, 0.99, 0.70],
];

/// Factor of [`absolute`].
pub const GAIN: f64 = 4.0;

/// The map of FLIP in colours: black is no visible difference, pale yellow the largest.
pub fn flip(map: &FlipMap) -> Image {
    let rgba = map.error.iter().flat_map(|&e| color(e)).collect();
    Image { width: map.width as u32, height: map.height as u32, rgba, depth: Vec::new() }
}

/// |difference| of each channel, [`GAIN`] times.
pub fn absolute(reference: &Planes, test: &Planes) -> Image {
    let value = |c: usize, i: usize| (GAIN * (reference.rgb[c][i] - test.rgb[c][i]).abs()) as f32;
    let rgba = (0..reference.pixels()).flat_map(|i| [value(0, i), value(1, i), value(2, i), 1.0]).collect();
    Image { width: reference.width as u32, height: reference.height as u32, rgba, depth: Vec::new() }
}

/// Errors in grey, [`GAIN`] times, as bright as [`absolute`] shows them.
pub fn gained(error: &[f32], [width, height]: [u32; 2]) -> Image {
    let grey = |e: &f32| GAIN as f32 * e;
    let rgba = error.iter().map(grey).flat_map(|v| [v, v, v, 1.0]).collect();
    Image { width, height, rgba, depth: Vec::new() }
}

/// The largest |difference| of a pixel's channels in colours, by its power of ten: black is `from` and below, pale yellow
/// `to` and above.
pub fn decades(reference: &Planes, test: &Planes, [from, to]: [f64; 2]) -> Image {
    let value = |i: usize| {
        let channels = reference.rgb.iter().zip(&test.rgb).map(|(r, t)| (r[i] - t[i]).abs());
        ((channels.fold(0.0, f64::max).log10() - from) / (to - from)) as f32
    };
    let rgba = (0..reference.pixels()).flat_map(|i| color(value(i))).collect();
    Image { width: reference.width as u32, height: reference.height as u32, rgba, depth: Vec::new() }
}

/// Planes as an image.
pub fn image(planes: &Planes) -> Image {
    let [r, g, b] = &planes.rgb;
    let rgba = (0..planes.pixels()).flat_map(|i| [r[i] as f32, g[i] as f32, b[i] as f32, 1.0]).collect();
    Image { width: planes.width as u32, height: planes.height as u32, rgba, depth: Vec::new() }
}

fn color(error: f32) -> [f32; 4] {
    let place = error.clamp(0.0, 1.0) * (RAMP.len() - 1) as f32;
    let low = (place as usize).min(RAMP.len() - 2);
    let part = place - low as f32;
    let mix = |c: usize| RAMP[low][c] + part * (RAMP[low + 1][c] - RAMP[low][c]);
    [mix(0), mix(1), mix(2), 1.0]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_get_brighter() {
        let light = |e: f32| color(e)[..3].iter().sum::<f32>();
        assert!((0..100).all(|i| light(i as f32 / 100.0) < light((i + 1) as f32 / 100.0)));
        assert!(color(1.0)[..3].iter().zip(RAMP[7]).all(|(found, ramp)| (found - ramp).abs() < 1e-6));
        let map = FlipMap { width: 2, height: 1, error: vec![0.0, 1.0] };
        assert_eq!(flip(&map).rgba.len(), 8);
    }

    #[test]
    fn powers_of_ten_get_even_steps_of_colour() {
        let planes = |values: [f64; 3]| Planes { width: 3, height: 1, rgb: [0; 3].map(|_| values.to_vec()) };
        let image = decades(&planes([0.0; 3]), &planes([0.0, 1.0e-5, 0.5]), [-8.0, -2.0]);
        let expected = [color(0.0), color(0.5), color(1.0)].concat();
        assert!(image.rgba.iter().zip(&expected).all(|(found, expected)| (found - expected).abs() < 1.0e-6));
    }
}
