//! Front-to-back blending. Bands of rows run in parallel; within a band every splat in depth order visits only the pixels
//! of its rows' ellipse intervals. The intervals are slightly too wide and the test on α itself decides, so the result is
//! exactly that of testing every Gaussian at every pixel.

use glam::DVec2;
use rayon::prelude::*;

use super::project::Splat;
use super::{ALPHA_MIN, ReferenceImage, TRANSMITTANCE_MIN};
use crate::scene::{Camera, Rejected};

/// Rows of a band.
pub(super) const BAND: usize = 8;

/// Blends `splats`, given front to back, over `background`.
pub(super) fn blend(splats: &[Splat], camera: &Camera, background: [f64; 3]) -> ReferenceImage {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let lists = band_lists(splats, height);
    let bands: Vec<Band> = lists
        .par_iter()
        .enumerate()
        .map(|(b, list)| {
            let first = b * BAND;
            let mut band = Band::new(first, BAND.min(height - first), width);
            band.blend(splats, list);
            band
        })
        .collect();
    let mut image = ReferenceImage {
        width: camera.width,
        height: camera.height,
        visible: splats.len(),
        rejected: Rejected::default(),
        ..ReferenceImage::default()
    };
    for pixel in bands.iter().flat_map(|band| &band.pixels) {
        image.rgb.extend((0..3).map(|c| pixel.color[c] + pixel.transmittance * background[c]));
        image.alpha.push(1.0 - pixel.transmittance);
        image.depth.push(pixel.depth);
    }
    image
}

/// For each band the splats that may touch it, in the order given.
pub(super) fn band_lists(splats: &[Splat], height: usize) -> Vec<Vec<u32>> {
    let mut lists = vec![Vec::new(); height.div_ceil(BAND)];
    for (i, splat) in splats.iter().enumerate() {
        let half = widened(Reach::of(splat).squared * splat.covariance[2], splat.mean.y);
        if let Some((first, last)) = pixels(splat.mean.y, half, height) {
            for list in &mut lists[first / BAND..=last / BAND] {
                list.push(i as u32);
            }
        }
    }
    lists
}

/// How far out α ≥ 1/255 reaches.
struct Reach {
    /// Upper bound of dᵀΣ₂⁻¹d there: 2·ln(255·opacity), a little more for rounding.
    squared: f64,
}

impl Reach {
    fn of(splat: &Splat) -> Self {
        Self { squared: 2.0 * (splat.opacity / ALPHA_MIN).ln().max(0.0) * (1.0 + 1.0e-9) + 1.0e-9 }
    }
}

/// √`squared`, widened by far more than the rounding errors of the interval's own arithmetic around `center`.
fn widened(squared: f64, center: f64) -> f64 {
    squared.max(0.0).sqrt() * (1.0 + 1.0e-9) + 1.0e-9 * center.abs() + 1.0e-6
}

/// First and last index in `0..count` whose pixel centre lies within `half` of `center`.
fn pixels(center: f64, half: f64, count: usize) -> Option<(usize, usize)> {
    let first = (center - half - 0.5).ceil().max(0.0);
    let last = (center + half - 0.5).floor().min(count as f64 - 1.0);
    (first <= last).then_some((first as usize, last as usize))
}

#[derive(Clone)]
struct Pixel {
    transmittance: f64,
    color: [f64; 3],
    depth: f64,
    stopped: bool,
}

struct Band {
    first_row: usize,
    rows: usize,
    width: usize,
    pixels: Vec<Pixel>,
    open: usize,
}

impl Band {
    fn new(first_row: usize, rows: usize, width: usize) -> Self {
        let pixel = Pixel { transmittance: 1.0, color: [0.0; 3], depth: 0.0, stopped: false };
        Self { first_row, rows, width, pixels: vec![pixel; rows * width], open: rows * width }
    }

    fn blend(&mut self, splats: &[Splat], list: &[u32]) {
        for &i in list {
            let splat = &splats[i as usize];
            let reach = Reach::of(splat);
            for row in 0..self.rows {
                self.blend_row(splat, &reach, row);
            }
            if self.open == 0 {
                return;
            }
        }
    }

    /// Along a row, dᵀΣ₂⁻¹d = c/det·(dx − b/c·dy)² + dy²/c: an interval around b/c·dy.
    fn blend_row(&mut self, splat: &Splat, reach: &Reach, row: usize) {
        let [_, b, c] = splat.covariance;
        let y = (self.first_row + row) as f64 + 0.5;
        let dy = y - splat.mean.y;
        let rest = reach.squared - dy * dy / c * (1.0 - 1.0e-9);
        let shift = b / c * dy;
        let half = widened(rest * (splat.determinant / c), splat.mean.x.abs() + shift.abs());
        let Some((first, last)) = pixels(splat.mean.x + shift, half, self.width) else { return };
        for x in first..=last {
            let pixel = &mut self.pixels[row * self.width + x];
            if !pixel.stopped && pixel.add(splat, DVec2::new(x as f64 + 0.5, y)) {
                self.open -= 1;
            }
        }
    }
}

impl Pixel {
    /// Blends `splat` at `point`; true when the pixel stops there instead.
    fn add(&mut self, splat: &Splat, point: DVec2) -> bool {
        let alpha = splat.alpha(point);
        if alpha < ALPHA_MIN {
            return false;
        }
        let next = self.transmittance * (1.0 - alpha);
        if next < TRANSMITTANCE_MIN {
            self.stopped = true;
            return true;
        }
        let weight = alpha * self.transmittance;
        for channel in 0..3 {
            self.color[channel] += weight * splat.color[channel];
        }
        self.depth += weight * splat.depth;
        self.transmittance = next;
        false
    }
}
