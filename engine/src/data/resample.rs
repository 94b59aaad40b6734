//! Resampling of premultiplied pictures: area averages and undistortion.

use super::lens::Lens;

/// The whole number of source pixels per target pixel, the same along both axes, if it is one.
pub(super) fn whole_factor(from: [u32; 2], to: [u32; 2]) -> Option<u32> {
    let factor = from[0] / to[0].max(1);
    (factor >= 1 && to.map(|side| side.checked_mul(factor)) == from.map(Some)).then_some(factor)
}

/// Straight RGBA bytes → packed premultiplied means of `factor`×`factor` blocks, in integers: rounded once, halves up.
pub(super) fn average_blocks(rgba: &[u8], size: [u32; 2], factor: u32) -> Vec<u32> {
    let [width, height] = size.map(|side| (side / factor) as usize);
    let factor = factor as usize;
    let divisor = 255 * (factor * factor) as u64;
    let mut sums = vec![[0u64; 4]; width];
    let mut out = Vec::with_capacity(width * height);
    for rows in rgba.chunks_exact(4 * width * factor * factor) {
        sums.fill([0; 4]);
        for row in rows.chunks_exact(4 * width * factor) {
            for (sum, block) in sums.iter_mut().zip(row.chunks_exact(4 * factor)) {
                for pixel in block.chunks_exact(4) {
                    let alpha = u64::from(pixel[3]);
                    (0..3).for_each(|c| sum[c] += u64::from(pixel[c]) * alpha);
                    sum[3] += 255 * alpha;
                }
            }
        }
        out.extend(sums.iter().map(|sum| u32::from_le_bytes(sum.map(|s| ((s + divisor / 2) / divisor) as u8))));
    }
    out
}

/// Premultiplied R, G, B, A, each 0 to 255.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Plane {
    size: [u32; 2],
    values: Vec<[f32; 4]>,
}

impl Plane {
    /// From straight RGBA bytes.
    pub(super) fn premultiplied(rgba: &[u8], size: [u32; 2]) -> Self {
        let premultiply = |p: &[u8]| {
            let alpha = f32::from(p[3]);
            [0, 1, 2].map(|c| f32::from(p[c]) * alpha / 255.0).into_iter().chain([alpha])
        };
        let values = rgba.chunks_exact(4).map(|p| {
            let mut value = [0.0; 4];
            value.iter_mut().zip(premultiply(p)).for_each(|(v, c)| *v = c);
            value
        });
        Self { size, values: values.collect() }
    }

    /// Packed bytes, rounded.
    pub(super) fn packed(&self) -> Vec<u32> {
        // Not above alpha: sums of floats may be, by an ulp.
        self.values.iter().map(|v| u32::from_le_bytes(v.map(|c| (c.min(v[3]) + 0.5) as u8))).collect()
    }

    /// Each target pixel is the mean over the area it covers.
    pub(super) fn averaged(&self, to: [u32; 2]) -> Self {
        let columns = spans(self.size[0], to[0]);
        let rows = spans(self.size[1], to[1]);
        let width = self.size[0] as usize;
        let mut line = vec![[0.0f32; 4]; width];
        let mut values = Vec::with_capacity(to[0] as usize * to[1] as usize);
        for row in &rows {
            line.fill([0.0; 4]);
            for (y, weight) in row.weights() {
                let source = &self.values[y * width..(y + 1) * width];
                for (sum, value) in line.iter_mut().zip(source) {
                    (0..4).for_each(|c| sum[c] += weight * value[c]);
                }
            }
            values.extend(columns.iter().map(|column| {
                column.weights().fold([0.0f32; 4], |mut sum, (x, weight)| {
                    (0..4).for_each(|c| sum[c] += weight * line[x][c]);
                    sum
                })
            }));
        }
        Self { size: to, values }
    }

    /// The picture that a pinhole camera of the same focal lengths and principal point takes: bilinear samples of the
    /// photo, whose edge is repeated beyond it.
    pub(super) fn undistorted(&self, lens: &Lens) -> Self {
        let valid = lens.distortion.valid_radius(lens.picture_radius(self.size));
        let [width, height] = self.size;
        let mut values = Vec::with_capacity(self.values.len());
        for y in 0..height {
            for x in 0..width {
                let [u, v] = source_pixel(lens, valid, f64::from(x) + 0.5, f64::from(y) + 0.5);
                values.push(self.sample(u, v));
            }
        }
        Self { size: self.size, values }
    }

    /// Bilinear value at (u, v), pixel centres at +0.5.
    fn sample(&self, u: f64, v: f64) -> [f32; 4] {
        let place = |t: f64, side: u32| {
            // NaN becomes 0 by the cast below; coefficients were checked to be finite.
            let t = (t - 0.5).clamp(0.0, f64::from(side - 1));
            let low = (t as usize).min(side as usize - 1);
            (low, (low + 1).min(side as usize - 1), (t - low as f64) as f32)
        };
        let (x0, x1, fx) = place(u, self.size[0]);
        let (y0, y1, fy) = place(v, self.size[1]);
        let at = |x: usize, y: usize| self.values[y * self.size[0] as usize + x];
        let [a, b, c, d] = [at(x0, y0), at(x1, y0), at(x0, y1), at(x1, y1)];
        [0, 1, 2, 3].map(|i| {
            let (top, bottom) = (a[i] + fx * (b[i] - a[i]), c[i] + fx * (d[i] - c[i]));
            top + fy * (bottom - top)
        })
    }
}

/// Where the undistorted picture's pixel (u, v) lies in the photo. Directions beyond the `valid` radius of the lens are
/// pulled back to it.
pub(super) fn source_pixel(lens: &Lens, valid: f64, u: f64, v: f64) -> [f64; 2] {
    let [x, y] = lens.pinhole_direction(u, v);
    let radius = x.hypot(y);
    let pull = if radius > valid { valid / radius } else { 1.0 };
    lens.project(x * pull, y * pull)
}

/// Source pixels under one target pixel: full ones between two that count partly.
#[derive(Debug, Clone, Copy)]
struct Span {
    begin: f64,
    end: f64,
    last: usize,
}

impl Span {
    /// (index, weight), the weights adding up to 1.
    fn weights(&self) -> impl Iterator<Item = (usize, f32)> + '_ {
        let first = (self.begin as usize).min(self.last);
        let until = (self.end.ceil() as usize).clamp(first + 1, self.last + 1);
        (first..until).map(|i| {
            let covered = self.end.min(i as f64 + 1.0) - self.begin.max(i as f64);
            (i, (covered.max(0.0) / (self.end - self.begin)) as f32)
        })
    }
}

fn spans(from: u32, to: u32) -> Vec<Span> {
    let ratio = f64::from(from) / f64::from(to);
    let last = from as usize - 1;
    (0..to).map(|i| Span { begin: f64::from(i) * ratio, end: f64::from(i + 1) * ratio, last }).collect()
}

#[cfg(test)]
mod tests;
