//! Twins of the kernels that blend.

use super::super::ellipse::log2_cut;
use super::super::frame::Frame;
use super::super::limits::{INSTANCE_GAUSSIAN, INSTANCE_QUADRANT_SHIFT, TILE_SIZE};
use super::super::pixel_format::PixelFormat;
use super::super::segments::Segments;
use super::super::splat::{Splat, unpack_splat};
use super::super::twin::{set_f32, set_vec4, struct_at};
use super::{Blend, BlendConstants, MAX_ALPHA, MIN_TRANSMITTANCE, subtile};
use crate::gpu::interface::Call;

/// What every kernel that blends reads.
pub(in super::super) struct Inputs<'a> {
    pub(in super::super) subgroup_size: u32,
    pub(in super::super) constants: BlendConstants,
    pub(in super::super) frame: &'a [u32],
    pub(in super::super) ranges: &'a [u32],
    pub(in super::super) values: &'a [u32],
    pub(in super::super) splats: &'a [u32],
    pub(in super::super) gaussian_of_slot: Option<&'a [u32]>,
}

impl Inputs<'_> {
    /// Instance `at`: its Gaussian and the quadrants that it reaches.
    fn instance(&self, at: usize) -> (usize, u32) {
        let value = self.values[at];
        let instance = match self.gaussian_of_slot {
            Some(gaussian_of_slot) if self.constants.with_slots == 1 => gaussian_of_slot[value as usize],
            _ => value,
        };
        ((instance & INSTANCE_GAUSSIAN) as usize, instance >> INSTANCE_QUADRANT_SHIFT)
    }
}

/// What ends a splat and a pixel.
struct Limits {
    log2_cut: f32,
    min_transmittance: f32,
}

/// A pixel's state.
#[derive(Clone, Copy)]
struct Pixel {
    transmittance: f32,
    colour: [f32; 3],
    depth: f32,
}

/// u and v of a splat at the corner of a subtile (`glsl/lib/blend.glsl`).
pub(crate) fn splat_at([first, second, _]: &Splat, corner: [f32; 2]) -> [f32; 2] {
    let [dx, dy] = [0, 1].map(|i| corner[i] - first[i]);
    [first[2] * dx + first[3] * dy, second[0] * dy]
}

/// x, y: from the corner at which the splat has these u and v.
fn blend_splat(
    pixel: &mut Pixel,
    [first, second, third]: Splat,
    at_corner: [f32; 2],
    limits: &Limits,
    [x, y]: [f32; 2],
) {
    let u = at_corner[0] + first[2] * x + first[3] * y;
    let v = at_corner[1] + second[0] * y;
    let log2_alpha = second[1] - u * u - v * v;
    let live = log2_alpha >= -limits.log2_cut && pixel.transmittance > 0.0;
    let alpha = if live { log2_alpha.exp2().min(MAX_ALPHA) } else { 0.0 };
    let weight = alpha * pixel.transmittance;
    let after = pixel.transmittance - weight;
    let stop = live && after < limits.min_transmittance;
    let weight = if stop { 0.0 } else { weight };
    pixel.transmittance = if stop { -pixel.transmittance } else { after };
    (0..3).for_each(|c| pixel.colour[c] += weight * third[c]);
    pixel.depth += weight * second[2];
}

/// Twin of `blend`.
pub(super) fn blend(call: Call<'_, Blend>) {
    let Call { constants, subgroup_size, buffers: b, .. } = call;
    let input = Inputs {
        subgroup_size,
        constants,
        frame: b.frame,
        ranges: b.ranges,
        values: b.values,
        splats: b.splats,
        gaussian_of_slot: b.gaussian_of_slot.as_deref(),
    };
    blend_tiles(&input, b.depth, None, |at, value| set_vec4(b.color, at, value));
}

/// Where the states at the beginning of a list's segments go.
type StatesOut<'a> = (Segments, &'a mut [u32]);

/// Twin of `blend_states`.
pub(in super::super) fn blend_states_twin(
    input: &Inputs<'_>,
    segments: Segments,
    color: &mut [u32],
    states: &mut [u32],
) {
    blend_tiles(input, None, Some((segments, states)), |at, value| set_vec4(color, at, value));
}

/// Blends into tightly packed pixels of a format.
pub(in super::super) fn blend_into(
    input: &Inputs<'_>,
    format: PixelFormat,
    pixels: &mut [u32],
    depth: Option<&mut [u32]>,
) {
    let words = format.bytes() as usize / 4;
    blend_tiles(input, depth, None, |at, value| {
        pixels[words * at..words * (at + 1)].copy_from_slice(&format.pack(value)[..words]);
    });
}

/// Bits of the quadrants ([`quadrants_of_tile`](super::super::ellipse::quadrants_of_tile)) in which pixels of a subtile lie; its
/// first pixel from the tile's corner, and its size.
fn quadrants_of_subtile([x, y]: [u32; 2], [columns, rows]: [u32; 2]) -> u32 {
    let across = u32::from(x < 8) | u32::from(x + columns > 8) << 1;
    (if y < 8 { across } else { 0 }) | (if y + rows > 8 { across << 2 } else { 0 })
}

fn blend_tiles(
    input: &Inputs<'_>,
    depth: Option<&mut [u32]>,
    mut states: Option<StatesOut<'_>>,
    mut store_pixel: impl FnMut(usize, [f32; 4]),
) {
    let BlendConstants { with_depth, pixels_per_lane, alpha_cut, transmittance_stop, packing, .. } = input.constants;
    let frame: Frame = struct_at(input.frame, 0);
    let mut depth = depth.filter(|_| with_depth == 1);
    let min_transmittance =
        if transmittance_stop == 0 { MIN_TRANSMITTANCE } else { f32::from_bits(transmittance_stop) };
    let limits = Limits { log2_cut: log2_cut(alpha_cut), min_transmittance };
    let [columns, _, rows] = subtile(input.subgroup_size, pixels_per_lane);
    let ([width, height], tiles_x) = (frame.size, frame.tiles[0]);
    for tile in 0..frame.tile_count {
        let (tile_x, tile_y) = (tile % tiles_x * TILE_SIZE, tile / tiles_x * TILE_SIZE);
        let range = input.ranges[2 * tile as usize] as usize..input.ranges[2 * tile as usize + 1] as usize;
        for inside in 0..(TILE_SIZE / columns) * (TILE_SIZE / rows) {
            let x0 = tile_x + columns * (inside % (TILE_SIZE / columns));
            let y0 = tile_y + rows * (inside / (TILE_SIZE / columns));
            let own_quadrants = quadrants_of_subtile([x0 - tile_x, y0 - tile_y], [columns, rows]);
            let mut pixels =
                vec![Pixel { transmittance: 1.0, colour: [0.0; 3], depth: 0.0 }; (columns * rows) as usize];
            for at in range.clone() {
                if let Some((segments, states)) = &mut states {
                    let (done, length) = (at - range.start, segments.length(range.len()));
                    if done > 0 && done.is_multiple_of(length) {
                        store_states(&frame, [x0, y0, columns], done / length, &pixels, states);
                    }
                }
                let (gaussian, quadrants) = input.instance(at);
                if quadrants & own_quadrants != 0 {
                    let splat = unpack_splat(packing, input.splats, gaussian);
                    let at_corner = splat_at(&splat, [x0 as f32, y0 as f32]);
                    for (i, pixel) in (0..).zip(&mut pixels) {
                        let from_corner = [(i % columns) as f32 + 0.5, (i / columns) as f32 + 0.5];
                        blend_splat(pixel, splat, at_corner, &limits, from_corner);
                    }
                }
            }
            for (i, pixel) in (0..).zip(&pixels) {
                let (x, y) = (x0 + i % columns, y0 + i / columns);
                if x < width && y < height {
                    let at = (y * width + x) as usize;
                    let rest = pixel.transmittance.abs();
                    let [r, g, b] = std::array::from_fn(|c| pixel.colour[c] + rest * frame.background[c]);
                    store_pixel(at, [r, g, b, 1.0 - rest]);
                    if let Some(depth) = depth.as_mut() {
                        set_f32(depth, at, pixel.depth);
                    }
                }
            }
        }
    }
}

/// Stores the pixels of a subtile of so many columns, whose first one is (x, y), at the beginning of a segment.
fn store_states(frame: &Frame, [x0, y0, columns]: [u32; 3], segment: usize, pixels: &[Pixel], states: &mut [u32]) {
    let [width, height] = frame.size;
    for (i, pixel) in (0..).zip(pixels) {
        let (x, y) = (x0 + i % columns, y0 + i / columns);
        if x < width && y < height {
            let at = (segment - 1) * frame.pixels() + (y * width + x) as usize;
            let [r, g, b] = pixel.colour;
            set_vec4(states, at, [r, g, b, pixel.transmittance]);
        }
    }
}
