//! Derivatives of an image by one superpoint's six numbers, from images of the part that it reaches.

use glam::DVec3;

use crate::error::Result;
use crate::pose::information::Block;
use crate::pose::sight::Residual;
use crate::reference::{Pose, exp};
use crate::scene::{Camera, Scene};
use crate::train::photo_loss::PhotoLoss;

/// A splat reaches so many of its deviations at most: α = 1/255 where its opacity is 1, √(2 ln 255).
const REACH: f64 = 3.33;
/// Variance that each splat gets, pixels².
const DILATION: f64 = 0.3;
/// Added on every side, pixels.
const MARGIN: f64 = 2.0;
/// Sides of windows, pixels: few, because each has buffers of its own.
const SIDES: [u32; 3] = [64, 256, 1024];

/// A part of an image, pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Window {
    x: u32,
    y: u32,
    width: u32,
    height: u32,
}

/// Derivatives of the pixels of a window by a superpoint's six numbers.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Columns {
    pub(super) superpoint: usize,
    window: Window,
    /// `[H,W,3]` of r, g, b.
    values: Vec<[f32; 6]>,
}

/// The part of an image that each superpoint's Gaussians reach `[M]`; `None` where they reach nothing of it.
pub(super) fn windows(scene: &Scene, camera: &Camera, poses: &[Pose], near: f32) -> Vec<Option<Window>> {
    let mut boxes = vec![[f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY]; poses.len()];
    let Some(s) = scene.deformation.superpoint_deformation() else { return vec![None; poses.len()] };
    let placed: Vec<_> = poses.iter().map(|p| (exp(p.rotation), p.translation)).collect();
    let g = &scene.gaussians;
    for (i, (mean, scale)) in g.mean.iter().zip(&g.log_scale).enumerate() {
        let x = DVec3::from_array(mean.map(f64::from));
        let x: DVec3 = s.slots(i).map(|(j, w)| w * (placed[j].0 * x + placed[j].1)).sum();
        let p = camera.rotation * (x - camera.position);
        let scale = scale.iter().fold(f64::NEG_INFINITY, |a, &b| a.max(f64::from(b))).exp();
        if !(p.is_finite() && scale.is_finite() && p.z > f64::from(near)) {
            continue;
        }
        let [u, v] = [camera.fx * p.x / p.z + camera.cx, camera.fy * p.y / p.z + camera.cy];
        let spread = scale * camera.fx.max(camera.fy) / p.z * (p.length() / p.z);
        let radius = REACH * (spread * spread + DILATION).sqrt() + MARGIN;
        for (j, _) in s.slots(i) {
            let [left, top, right, bottom] = &mut boxes[j];
            (*left, *top) = (left.min(u - radius), top.min(v - radius));
            (*right, *bottom) = (right.max(u + radius), bottom.max(v + radius));
        }
    }
    boxes.iter().map(|b| window(b, camera)).collect()
}

/// A window of one of few sizes around a box.
fn window(&[left, top, right, bottom]: &[f64; 4], camera: &Camera) -> Option<Window> {
    let range = |low: f64, high: f64, all: u32| {
        let (low, high) = (low.max(0.0).floor(), high.min(f64::from(all)).ceil());
        (low < high).then_some((low as u32, high as u32))
    };
    let (across, down) = (range(left, right, camera.width)?, range(top, bottom, camera.height)?);
    let longest = (across.1 - across.0).max(down.1 - down.0);
    let side = SIDES.into_iter().find(|side| *side >= longest).unwrap_or(u32::MAX);
    let [width, height] = [camera.width, camera.height].map(|all| side.min(all));
    let [x, y] = [(across.0, camera.width - width), (down.0, camera.height - height)].map(|(low, most)| low.min(most));
    Some(Window { x, y, width, height })
}

/// Of superpoint `j`, with its pose from its six numbers by `at` and each number changed by its own of `steps` either way;
/// `None` where the image does not change. A Gaussian beside the window is as wide in it as one beside the whole image: these are differences of one
/// window.
pub(super) fn columns(
    loss: &mut PhotoLoss<'_>,
    camera: &Camera,
    poses: &[Pose],
    j: usize,
    window: Window,
    steps: [f64; 6],
    at: impl Fn([f64; 6]) -> Pose,
) -> Result<Option<Columns>> {
    let camera = camera.cropped([window.x, window.y], [window.width, window.height]);
    let mut poses = poses.to_vec();
    let mut values = vec![[0.0_f32; 6]; 3 * window.width as usize * window.height as usize];
    for (k, step) in steps.into_iter().enumerate() {
        let mut image = |by: f64| {
            let mut change = [0.0; 6];
            change[k] = by;
            poses[j] = at(change);
            loss.image(&camera, &poses)
        };
        let (above, below) = (image(step)?, image(-step)?);
        let scale = (0.5 / step) as f32;
        values.iter_mut().zip(above.iter().zip(&below)).for_each(|(value, (a, b))| value[k] = (a - b) * scale);
    }
    Ok(trimmed(Columns { superpoint: j, window, values }))
}

/// Without the rows and columns around it where nothing changes.
fn trimmed(all: Columns) -> Option<Columns> {
    let (width, height) = (all.window.width as usize, all.window.height as usize);
    let is_used = |i: usize| all.values[3 * i..3 * i + 3].iter().flatten().any(|v| *v != 0.0);
    let used: Vec<[usize; 2]> = (0..width * height).filter(|&i| is_used(i)).map(|i| [i % width, i / width]).collect();
    let [low, high] = used.iter().fold([[usize::MAX; 2], [0; 2]], |[low, high], at| {
        [[low[0].min(at[0]), low[1].min(at[1])], [high[0].max(at[0] + 1), high[1].max(at[1] + 1)]]
    });
    if used.is_empty() {
        return None;
    }
    let row = |y: usize| all.values[3 * (y * width + low[0])..3 * (y * width + high[0])].iter().copied();
    let values = (low[1]..high[1]).flat_map(row).collect();
    let window = Window {
        x: all.window.x + low[0] as u32,
        y: all.window.y + low[1] as u32,
        width: (high[0] - low[0]) as u32,
        height: (high[1] - low[1]) as u32,
    };
    Some(Columns { window, values, ..all })
}

impl Columns {
    /// Values of the columns x in `across` of a row.
    fn row(&self, y: u32, across: [u32; 2]) -> &[[f32; 6]] {
        let first = (y - self.window.y) as usize * self.window.width as usize;
        let [from, to] = across.map(|x| 3 * (first + (x - self.window.x) as usize));
        &self.values[from..to]
    }

    /// JᵀWK with the derivatives by another superpoint; `None` where the two share no pixel.
    pub(super) fn product(&self, other: &Self, weight: &[f32], width: u32) -> Option<Block> {
        let (a, b) = (&self.window, &other.window);
        let across = [a.x.max(b.x), (a.x + a.width).min(b.x + b.width)];
        let down = [a.y.max(b.y), (a.y + a.height).min(b.y + b.height)];
        if across[0] >= across[1] || down[0] >= down[1] {
            return None;
        }
        let mut sum = Block::default();
        for y in down[0]..down[1] {
            let [from, to] = across.map(|x| 3 * (y as usize * width as usize + x as usize));
            let mut of_row = [[0.0_f32; 6]; 6];
            let rows = self.row(y, across).iter().zip(other.row(y, across)).zip(&weight[from..to]);
            for ((a, b), w) in rows {
                for (row, a) in of_row.iter_mut().zip(a) {
                    row.iter_mut().zip(b).for_each(|(value, b)| *value += w * a * b);
                }
            }
            sum.iter_mut().flatten().zip(of_row.iter().flatten()).for_each(|(sum, v)| *sum += f64::from(*v));
        }
        Some(sum)
    }

    /// JᵀWr.
    pub(super) fn against(&self, residual: &Residual, width: u32) -> [f64; 6] {
        let w = &self.window;
        let across = [w.x, w.x + w.width];
        let mut sum = [0.0_f64; 6];
        for y in w.y..w.y + w.height {
            let [from, to] = across.map(|x| 3 * (y as usize * width as usize + x as usize));
            let rows = self.row(y, across).iter().zip(&residual.weight[from..to]).zip(&residual.difference[from..to]);
            for ((values, weight), difference) in rows {
                let by = f64::from(weight * difference);
                sum.iter_mut().zip(values).for_each(|(sum, v)| *sum += by * f64::from(*v));
            }
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    fn columns(superpoint: usize, window: Window, value: impl Fn(u32, u32) -> f32) -> Columns {
        let at = |i: u32| value(window.x + i % window.width, window.y + i / window.width);
        let values = (0..window.width * window.height).flat_map(|i| [[at(i); 6]; 3]).collect();
        Columns { superpoint, window, values }
    }

    #[test]
    fn windows_share_the_pixels_that_both_hold() {
        let a = columns(0, Window { x: 2, y: 1, width: 4, height: 3 }, |x, y| (x + 10 * y) as f32);
        let b = columns(1, Window { x: 4, y: 2, width: 5, height: 5 }, |_, _| 2.0);
        let weight = vec![0.5_f32; 3 * 12 * 12];
        // Pixels (4, 2), (5, 2), (4, 3), (5, 3), three channels, weight 0.5.
        let expected = 3.0 * 0.5 * 2.0 * (24.0 + 25.0 + 34.0 + 35.0);
        assert_eq!(a.product(&b, &weight, 12).unwrap()[3][2], expected);
        assert_eq!(b.product(&a, &weight, 12).unwrap()[0][5], expected);
        let far = columns(2, Window { x: 6, y: 0, width: 2, height: 9 }, |_, _| 1.0);
        assert!(a.product(&far, &weight, 12).is_none());
        let mut difference = vec![0.0; weight.len()];
        difference[3 * (2 * 12 + 4)] = 3.0;
        let residual = Residual { weight, difference };
        assert_eq!(a.against(&residual, 12), [0.5 * 3.0 * 24.0; 6]);
    }

    #[test]
    fn what_does_not_change_is_left_out() {
        let window = Window { x: 5, y: 7, width: 6, height: 6 };
        let inside = |x: u32, y: u32| (7..9).contains(&x) && (8..11).contains(&y);
        let found = trimmed(columns(3, window, |x, y| if inside(x, y) { (x * y) as f32 } else { 0.0 })).unwrap();
        assert_eq!(found.window, Window { x: 7, y: 8, width: 2, height: 3 });
        assert_eq!(found.row(10, [8, 9]), [[80.0; 6]; 3]);
        assert!(trimmed(columns(3, window, |_, _| 0.0)).is_none());
    }

    #[test]
    fn windows_are_of_few_sizes_and_inside() {
        let camera = Camera::look_at(DVec3::X, DVec3::ZERO, DVec3::Z, 1.0, [300, 100]);
        let of = |x: [f64; 4]| window(&x, &camera);
        assert_eq!(of([10.0, 20.0, 40.0, 60.0]).unwrap(), Window { x: 10, y: 20, width: 64, height: 64 });
        assert_eq!(of([290.0, 80.0, 500.0, 90.0]).unwrap(), Window { x: 236, y: 36, width: 64, height: 64 });
        assert_eq!(of([-50.0, -9.0, 100.0, 60.0]).unwrap(), Window { x: 0, y: 0, width: 256, height: 100 });
        assert!(of([310.0, 0.0, 320.0, 50.0]).is_none() && of([0.0, -9.0, 50.0, -1.0]).is_none());
    }
}
