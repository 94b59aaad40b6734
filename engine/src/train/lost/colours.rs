//! Colours of which something is made: pixels fall into a few classes, so that each object of one colour is looked for by itself.
//! Hue and saturation count more than brightness: the shaded side of an object is its own.

use glam::{Vec3, Vec4};

/// Weights of a channel's share of the brightness and of brightness.
const CHROMA: f32 = 0.33;
const BRIGHTNESS: f32 = 0.35;
/// Added to brightness where shares are taken: near black there are none.
const DARK: f32 = 0.1;
/// Pixels that the classes are found from, at most, at equal distances.
const SAMPLES: usize = 20_000;
/// Share of them among which the farthest begins a class: the last ones are alone.
const NEARER: f64 = 0.97;
/// Rounds of moving classes to their middles (Lloyd's algorithm).
const ROUNDS: usize = 15;

/// Classes of colours, by their middles.
#[derive(Debug)]
pub(super) struct Colours(Vec<Vec4>);

impl Colours {
    /// So many classes of pixels, RGB in [0, 1].
    pub(super) fn new(pixels: &[[f32; 3]], classes: usize) -> Self {
        let count = pixels.len().min(SAMPLES);
        let features: Vec<Vec4> = (0..count).map(|k| feature(pixels[k * pixels.len() / count])).collect();
        let mut classes = Self(first_middles(&features, classes));
        for _ in 0..ROUNDS {
            let mut sums = vec![(Vec4::ZERO, 0.0); classes.0.len()];
            for f in &features {
                let (sum, count) = &mut sums[classes.nearest(*f)];
                (*sum, *count) = (*sum + *f, *count + 1.0);
            }
            let middles = classes.0.iter_mut().zip(sums).filter(|(_, (_, count))| *count > 0.0);
            middles.for_each(|(middle, (sum, count))| *middle = sum / count);
        }
        classes
    }

    /// The class of a colour.
    pub(super) fn of(&self, rgb: [f32; 3]) -> usize {
        self.nearest(feature(rgb))
    }

    fn nearest(&self, feature: Vec4) -> usize {
        let far = |k: &usize| self.0[*k].distance_squared(feature);
        (0..self.0.len()).min_by(|a, b| far(a).total_cmp(&far(b))).unwrap_or(0)
    }
}

fn feature(rgb: [f32; 3]) -> Vec4 {
    let rgb = Vec3::from_array(rgb);
    let mean = rgb.element_sum() / 3.0;
    (CHROMA / (mean + DARK) * (rgb - mean)).extend(BRIGHTNESS * mean)
}

/// The mean, then in turn what is farthest from those before.
fn first_middles(features: &[Vec4], count: usize) -> Vec<Vec4> {
    let mut middles = vec![features.iter().sum::<Vec4>() / features.len().max(1) as f32];
    let mut far = vec![f32::INFINITY; features.len()];
    while middles.len() < count && !features.is_empty() {
        let last = middles[middles.len() - 1];
        far.iter_mut().zip(features).for_each(|(far, f)| *far = far.min(last.distance_squared(*f)));
        let mut order: Vec<usize> = (0..far.len()).collect();
        order.sort_by(|a, b| far[*a].total_cmp(&far[*b]));
        middles.push(features[order[(NEARER * (order.len() - 1) as f64) as usize]]);
    }
    middles
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_fall_apart_and_shades_stay_together() {
        let shades = |rgb: [f32; 3], count: usize| {
            (0..count).map(move |k| rgb.map(|c| c * (0.6 + 0.4 * k as f32 / count as f32)))
        };
        let [red, green, white] = [[0.9, 0.3, 0.3], [0.3, 0.9, 0.3], [1.0; 3]];
        let pixels: Vec<[f32; 3]> = shades(red, 300).chain(shades(green, 200)).chain(shades(white, 4000)).collect();
        let colours = Colours::new(&pixels, 3);
        let of = |rgb: [f32; 3]| shades(rgb, 10).map(|c| colours.of(c)).collect::<std::collections::BTreeSet<_>>();
        let [red, green, white] = [of(red), of(green), of(white)];
        assert_eq!([red.len(), green.len(), white.len()], [1; 3], "{colours:?}");
        assert!(red.is_disjoint(&green) && red.is_disjoint(&white) && green.is_disjoint(&white), "{colours:?}");
    }

    #[test]
    fn pixels_that_are_few_or_alike_make_no_trouble() {
        assert_eq!(Colours::new(&[], 6).of([0.5; 3]), 0);
        assert_eq!(Colours::new(&[[0.2; 3]], 6).of([0.5; 3]), 0);
        assert!(Colours::new(&[[0.2; 3]; 100], 6).of([0.2; 3]) < 6);
    }
}
