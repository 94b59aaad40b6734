//! The exposure of a photo in f64, which the kernels are measured against.

use super::EXPOSURE_VALUES;

/// The map that changes nothing.
pub const IDENTITY: [f64; EXPOSURE_VALUES] = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];

/// `[H,W,3]` image, mapped.
pub fn exposed(map: &[f64; EXPOSURE_VALUES], image: &[f64]) -> Vec<f64> {
    let pixel = |c: &[f64; 3]| [0, 1, 2].map(|k| (0..3).map(|i| map[4 * k + i] * c[i]).sum::<f64>() + map[4 * k + 3]);
    image.as_chunks().0.iter().flat_map(pixel).collect()
}

/// Gradients of a loss by the image and by the map, from that by the mapped image, `[H,W,3]`.
pub fn backward(map: &[f64; EXPOSURE_VALUES], image: &[f64], by_exposed: &[f64]) -> (Vec<f64>, [f64; EXPOSURE_VALUES]) {
    let mut by_map = [0.0; EXPOSURE_VALUES];
    let mut by_image = Vec::with_capacity(image.len());
    for (c, g) in image.as_chunks::<3>().0.iter().zip(by_exposed.as_chunks::<3>().0) {
        for k in 0..3 {
            (0..3).for_each(|i| by_map[4 * k + i] += g[k] * c[i]);
            by_map[4 * k + 3] += g[k];
        }
        by_image.extend([0, 1, 2].map(|i| (0..3).map(|k| map[4 * k + i] * g[k]).sum::<f64>()));
    }
    (by_image, by_map)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::gradient::loss::image_loss;
    use crate::scene::synthetic::Random;

    #[test]
    fn gradients_are_those_of_the_loss() {
        let mut random = Random::new(3);
        let size = [9, 7];
        let [image, target] = [(); 2].map(|()| (0..189).map(|_| random.uniform()).collect::<Vec<f64>>());
        let mut map = IDENTITY;
        map.iter_mut().for_each(|v| *v += 0.2 * random.normal());
        let loss = |map: &[f64; 12], image: &[f64]| image_loss(&exposed(map, image), &target, size, 0.3);
        let (by_image, by_map) = backward(&map, &image, &loss(&map, &image).gradient);
        let h = 1e-6;
        for k in 0..EXPOSURE_VALUES {
            let at = |d: f64| {
                let mut other = map;
                other[k] += d;
                loss(&other, &image).loss
            };
            let difference = (at(h) - at(-h)) / (2.0 * h);
            assert!((difference - by_map[k]).abs() < 1e-6, "{k}: {difference} against {}", by_map[k]);
        }
        for i in [0, 5, 70, 188] {
            let at = |d: f64| {
                let mut other = image.clone();
                other[i] += d;
                loss(&map, &other).loss
            };
            let difference = (at(h) - at(-h)) / (2.0 * h);
            assert!((difference - by_image[i]).abs() < 1e-6, "{i}: {difference} against {}", by_image[i]);
        }
    }
}
