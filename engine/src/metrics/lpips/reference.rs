//! LPIPS in f64 on the CPU, by its definition: the truth for the kernels.

use rayon::prelude::*;

use super::network::{Conv, POOL_STRIDE, pooled_side};
use super::{EPSILON, Range, Weights, check_size, input};
use crate::error::Result;
use crate::metrics::planes::{Planes, same_size};
use crate::scene::network::{larger, relu};

/// A feature map, `[channels, height, width]`.
#[derive(Debug, Clone, PartialEq)]
struct Map {
    channels: usize,
    width: usize,
    height: usize,
    values: Vec<f64>,
}

/// LPIPS of two pictures.
///
/// # Errors
/// [`crate::Error::Usage`] for pictures of different sizes or too small for the network.
pub fn lpips(weights: &Weights, reference: &Planes, test: &Planes, range: Range) -> Result<f64> {
    same_size(reference, test)?;
    check_size(weights.network, reference)?;
    let start = |p: &Planes| Map { channels: 3, width: p.width, height: p.height, values: input(p, range) };
    let mut maps = [start(reference), start(test)];
    let mut convs = weights.convs.iter();
    let mut total = 0.0;
    for (slice, head) in weights.network.slices().iter().zip(&weights.heads) {
        if let Some(kernel) = slice.pool {
            maps = maps.map(|m| pool(&m, kernel));
        }
        for (conv, parameter) in slice.convs.iter().zip(&mut convs) {
            maps = maps.map(|m| convolve(&m, conv, parameter));
        }
        total += difference(&maps, head);
    }
    Ok(total)
}

fn convolve(input: &Map, conv: &Conv, parameter: &[f32]) -> Map {
    let (width, height) = (conv.output_side(input.width), conv.output_side(input.height));
    let (depth, side) = (conv.depth(), conv.kernel);
    let mut values = vec![0.0; conv.outputs * width * height];
    values.par_chunks_exact_mut(width * height).enumerate().for_each(|(o, plane)| {
        plane.fill(f64::from(parameter[conv.outputs * depth + o]));
        for (k, &weight) in parameter[o * depth..(o + 1) * depth].iter().enumerate() {
            let (channel, ky, kx) = (k / (side * side), k / side % side, k % side);
            let source = &input.values[channel * input.width * input.height..];
            for (y, row) in plane.chunks_exact_mut(width).enumerate() {
                let Some(sy) = (y * conv.stride + ky).checked_sub(conv.pad).filter(|s| *s < input.height) else {
                    continue;
                };
                let line = &source[sy * input.width..(sy + 1) * input.width];
                for (x, value) in row.iter_mut().enumerate() {
                    let sx = (x * conv.stride + kx).wrapping_sub(conv.pad);
                    *value += f64::from(weight) * line.get(sx).copied().unwrap_or(0.0);
                }
            }
        }
        plane.iter_mut().for_each(|v| *v = relu(*v));
    });
    Map { channels: conv.outputs, width, height, values }
}

fn pool(input: &Map, kernel: usize) -> Map {
    let (width, height) = (pooled_side(input.width, kernel), pooled_side(input.height, kernel));
    let value = |i: usize| {
        let (c, y, x) = (i / (width * height), i / width % height, i % width);
        let at = |j: usize| {
            let (sy, sx) = (y * POOL_STRIDE + j / kernel, x * POOL_STRIDE + j % kernel);
            input.values[(c * input.height + sy) * input.width + sx]
        };
        (0..kernel * kernel).map(at).fold(f64::NEG_INFINITY, larger)
    };
    let values = (0..input.channels * width * height).map(value).collect();
    Map { channels: input.channels, width, height, values }
}

/// Mean over the pixels of Σ_c w_c (a_c/|a| − b_c/|b|)².
fn difference([a, b]: &[Map; 2], head: &[f32]) -> f64 {
    let pixels = a.width * a.height;
    let of = |i: usize| {
        let length = |m: &Map| (0..m.channels).map(|c| m.values[c * pixels + i].powi(2)).sum::<f64>().sqrt() + EPSILON;
        let (la, lb) = (length(a), length(b));
        let term = |(c, w): (usize, &f32)| {
            f64::from(*w) * (a.values[c * pixels + i] / la - b.values[c * pixels + i] / lb).powi(2)
        };
        head.iter().enumerate().map(term).sum::<f64>()
    };
    (0..pixels).map(of).sum::<f64>() / pixels as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_convolution_by_hand() {
        let conv = Conv { layer: 0, inputs: 1, outputs: 1, kernel: 3, stride: 2, pad: 1 };
        let map = Map { channels: 1, width: 3, height: 3, values: (1..=9).map(f64::from).collect() };
        let mut parameter = vec![1.0; 9];
        parameter.push(0.5);
        let out = convolve(&map, &conv, &parameter);
        assert_eq!((out.width, out.height), (2, 2));
        assert_eq!(out.values, [12.5, 16.5, 24.5, 28.5]);
        parameter[9] = -20.0;
        assert_eq!(convolve(&map, &conv, &parameter).values, [0.0, 0.0, 4.0, 8.0]);
        assert_eq!(pool(&map, 2).values, [5.0]);
        assert_eq!(pool(&map, 3).values, [9.0]);
    }

    #[test]
    fn only_the_direction_of_features_counts() {
        let map = |values: Vec<f64>| Map { channels: 2, width: 1, height: 1, values };
        let head = [1.0, 2.0];
        assert!(difference(&[map(vec![1.0, 0.0]), map(vec![7.0, 0.0])], &head) < 1e-15);
        assert!((difference(&[map(vec![1.0, 0.0]), map(vec![0.0, 3.0])], &head) - 3.0).abs() < 1e-9);
        assert_eq!(difference(&[map(vec![0.0, 0.0]), map(vec![0.0, 0.0])], &head), 0.0);
    }
}
