//! Supersampling and motion blur: averages of the stored values, which are linear.

use engine::image::Image;

/// The mean of K × K pixels for each pixel of a picture that was drawn K times as wide and high.
pub(crate) fn reduced(image: Image, k: u32) -> Image {
    if k <= 1 {
        return image;
    }
    let (width, height) = (image.width / k, image.height / k);
    let plane = |from: &[f32], channels: usize| -> Vec<f32> {
        if from.is_empty() {
            return Vec::new();
        }
        let row = image.width as usize * channels;
        let mut out = Vec::with_capacity((width * height) as usize * channels);
        for y in 0..height as usize {
            for x in 0..width as usize {
                out.extend((0..channels).map(|c| {
                    let inside = (0..k as usize * k as usize)
                        .map(|i| (x * k as usize + i % k as usize, y * k as usize + i / k as usize));
                    let sum: f64 = inside.map(|(x, y)| f64::from(from[y * row + x * channels + c])).sum();
                    (sum / f64::from(k * k)) as f32
                }));
            }
        }
        out
    };
    Image { width, height, rgba: plane(&image.rgba, 4), depth: plane(&image.depth, 1) }
}

/// A mean of pictures of one size.
#[derive(Debug, Default)]
pub(crate) struct Mean {
    sum: Option<Image>,
    count: u32,
}

impl Mean {
    /// Adds a picture.
    pub(crate) fn add(&mut self, image: Image) {
        self.count += 1;
        match &mut self.sum {
            None => self.sum = Some(image),
            Some(sum) => {
                sum.rgba.iter_mut().zip(&image.rgba).for_each(|(s, v)| *s += v);
                sum.depth.iter_mut().zip(&image.depth).for_each(|(s, v)| *s += v);
            }
        }
    }

    /// The mean; an empty picture when nothing was added.
    pub(crate) fn finish(self) -> Image {
        let mut image = self.sum.unwrap_or_default();
        if self.count > 1 {
            let weight = 1.0 / self.count as f32;
            image.rgba.iter_mut().chain(&mut image.depth).for_each(|v| *v *= weight);
        }
        image
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(width: u32, height: u32, value: impl Fn(u32, u32) -> f32) -> Image {
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let rgba = pixels.clone().flat_map(|(x, y)| [value(x, y), 1.0, 0.0, 0.5]).collect();
        Image { width, height, rgba, depth: pixels.map(|(x, y)| value(x, y)).collect() }
    }

    #[test]
    fn a_reduced_pixel_is_the_mean_of_its_own() {
        let image = reduced(picture(6, 4, |x, y| (10 * y + x) as f32), 2);
        assert_eq!([image.width, image.height], [3, 2]);
        let red: Vec<f32> = image.rgba.chunks(4).map(|p| p[0]).collect();
        assert_eq!(red, [5.5, 7.5, 9.5, 25.5, 27.5, 29.5]);
        assert_eq!(image.depth, red);
        assert!(image.rgba.chunks(4).all(|p| p[1..] == [1.0, 0.0, 0.5]));
        let same = picture(3, 3, |x, _| x as f32);
        assert_eq!(reduced(same.clone(), 1), same);
    }

    #[test]
    fn a_mean_of_one_is_the_picture_itself() {
        let image = picture(2, 2, |x, y| 0.1 * (x + 2 * y) as f32);
        let mut mean = Mean::default();
        mean.add(image.clone());
        assert_eq!(mean.finish(), image);
        let mut mean = Mean::default();
        [1.0, 2.0, 6.0].into_iter().for_each(|v| mean.add(picture(2, 2, |_, _| v)));
        assert!(mean.finish().rgba.chunks(4).all(|p| (p[0] - 3.0).abs() < 1e-6 && p[1] == 1.0));
    }
}
