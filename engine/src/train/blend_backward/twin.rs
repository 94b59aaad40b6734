//! CPU twin: the replay per pixel, decisions in f32 as on the device, sums in f64.

use super::{
    Accumulation, BlendBackwardBuffers, BlendBackwardConstants, FAR_PRODUCT, FAR_VALUE, ROW_WORDS, SIGNED_SUMS, SUMS,
};
use crate::render::blend::{MAX_ALPHA, MIN_TRANSMITTANCE, splat_at};
use crate::render::ellipse::LOG2_255;
use crate::render::frame::Frame;
use crate::render::limits::{INSTANCE_GAUSSIAN, TILE_SIZE};
use crate::render::segments::Segments;
use crate::render::splat::Splat;
use crate::render::twin::{f32_at, set_f32, struct_at, vec4_at};

/// Sums of a splat over the pixels of a tile.
type Sums = [f64; SUMS];

/// Colour so far and transmittance of a pixel in front of all splats.
const UNTOUCHED: [f32; 4] = [0.0, 0.0, 0.0, 1.0];

/// A pixel's state while its splats are replayed.
struct Pixel {
    transmittance: f32,
    to_come: f64,
    gradient: [f64; 4],
}

impl Pixel {
    /// state: colour so far and transmittance in front of the pixel's splats.
    fn new(color: [f32; 4], gradient: [f32; 4], [r, g, b, transmittance]: [f32; 4]) -> Self {
        let past = [r, g, b, 1.0 - transmittance.abs()];
        let product = |c: [f32; 4]| c.iter().zip(gradient).map(|(c, g)| c * g).sum::<f32>();
        let usable = gradient.iter().all(|g| g.abs() < FAR_VALUE)
            && [color, past].into_iter().all(|c| product(c).abs() < FAR_PRODUCT);
        let gradient = if usable { gradient.map(f64::from) } else { [0.0; 4] };
        let left = color.iter().zip(past).map(|(c, past)| f64::from(*c) - f64::from(past));
        let to_come = if usable { left.zip(gradient).map(|(c, g)| c * g).sum() } else { 0.0 };
        Self { transmittance, to_come, gradient }
    }

    /// Replays one splat at pixel (x, y).
    fn replay(&mut self, splat: Splat, [x, y]: [u32; 2], sums: &mut Sums) {
        // Of a subtile of 8×8 pixels; those of other subgroup sizes lead to other roundings of the last place.
        let corner = [x, y].map(|k| (k & !7) as f32);
        let [across, down] = [(x & 7) as f32 + 0.5, (y & 7) as f32 + 0.5];
        let at_corner = splat_at(&splat, corner);
        let [first, second, third] = splat;
        let u = at_corner[0] + first[2] * across + first[3] * down;
        let v = at_corner[1] + second[0] * down;
        let log2_alpha = second[1] - u * u - v * v;
        if !(log2_alpha >= -LOG2_255 && self.transmittance > 0.0) {
            return;
        }
        let alpha = log2_alpha.exp2().min(MAX_ALPHA);
        let weight = alpha * self.transmittance;
        let after = self.transmittance - weight;
        if after < MIN_TRANSMITTANCE {
            self.transmittance = -self.transmittance;
            return;
        }
        self.transmittance = after;
        let (alpha, weight, u, v) = (f64::from(alpha), f64::from(weight), f64::from(u), f64::from(v));
        let usable = third[..3].iter().all(|c| c.abs() < FAR_VALUE);
        let colour = if usable { third.map(f64::from) } else { [0.0; 4] };
        let g = self.gradient;
        let q = (0..3).map(|c| g[c] * colour[c]).sum::<f64>() + g[3];
        self.to_come -= weight * q;
        let clamped = alpha >= f64::from(MAX_ALPHA);
        let h = if clamped { 0.0 } else { weight * q - self.to_come * (alpha / (1.0 - alpha)) };
        let [l11, l12, l22] = [first[2], first[3], second[0]].map(f64::from);
        let [by_x, by_y] = [h * u * l11, h * (u * l12 + v * l22)].map(f64::abs);
        let [red, green, blue] = [0, 1, 2].map(|c| weight * g[c]);
        let terms = [h, h * u, h * v, h * u * u, h * u * v, h * v * v, red, green, blue, 1.0, by_x, by_y];
        sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
    }
}

pub(super) fn blend_backward_twin(constants: BlendBackwardConstants, b: BlendBackwardBuffers<&mut [u32]>) {
    let frame: Frame = struct_at(b.frame, 0);
    let gaussian_of_slot = b.gaussian_of_slot.filter(|_| constants.accumulate == Accumulation::Instances as u32);
    let instance = |value: u32| gaussian_of_slot.as_ref().map_or(value, |slots| slots[value as usize]);
    let gaussian = |value: u32| (instance(value) & INSTANCE_GAUSSIAN) as usize;
    // Of the slot, or of the Gaussian.
    let row = |value: u32| if gaussian_of_slot.is_some() { value } else { value & INSTANCE_GAUSSIAN };
    let ([width, height], tiles_x) = (frame.size, frame.tiles[0]);
    let segments = Segments { per_list: constants.segments, least: constants.least_segment };
    let states = b.states.filter(|_| segments.per_list > 1);
    let state_of = |segment: usize, at: usize| match &states {
        Some(states) if segment > 0 => vec4_at(states, (segment - 1) * frame.pixels() + at),
        _ => UNTOUCHED,
    };
    let summed = if constants.absolute == 1 { SUMS } else { SIGNED_SUMS };
    let mut target: Vec<f64> = (0..b.gradient_rows.len()).map(|i| f64::from(f32_at(b.gradient_rows, i))).collect();
    for tile in 0..frame.tile_count {
        let [x0, y0] = [tile % tiles_x * TILE_SIZE, tile / tiles_x * TILE_SIZE];
        let range = b.ranges[2 * tile as usize] as usize..b.ranges[2 * tile as usize + 1] as usize;
        let mut sums = vec![[0.0; SUMS]; range.len()];
        for (x, y) in
            (y0..height.min(y0 + TILE_SIZE)).flat_map(|y| (x0..width.min(x0 + TILE_SIZE)).map(move |x| (x, y)))
        {
            let at = (y * width + x) as usize;
            let length = segments.length(range.len());
            for (k, list) in b.values[range.clone()].chunks(length).enumerate() {
                let mut pixel = Pixel::new(vec4_at(b.color, at), vec4_at(b.image_gradient, at), state_of(k, at));
                for (value, sums) in list.iter().zip(&mut sums[k * length..]) {
                    let splat: Splat = std::array::from_fn(|j| vec4_at(b.splats, 3 * gaussian(*value) + j));
                    pixel.replay(splat, [x, y], sums);
                }
            }
        }
        for (value, sums) in b.values[range].iter().zip(&sums) {
            let row = (ROW_WORDS * row(*value)) as usize;
            sums[..summed].iter().enumerate().for_each(|(c, sum)| target[row + c] += sum);
        }
    }
    target.iter().enumerate().for_each(|(i, v)| set_f32(b.gradient_rows, i, *v as f32));
}
