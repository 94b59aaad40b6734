//! Where a mask is thick: the largest discs inside it.

use glam::DVec2;

/// Discs looked for in a mask.
const MOST: usize = 3;
/// Steps of the distance to a side's and to a corner's neighbour: √2 to 0.2 %.
const STEPS: [u32; 2] = [12, 17];

/// Farther than any pixel, in steps.
const FAR: u32 = u32::MAX / 2;

/// Times that a disc moves to the middle of what it covers.
const CENTRINGS: usize = 4;

/// A disc inside a mask.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Disc {
    /// Mean of the mask's pixels in it, px.
    pub(super) centre: DVec2,
    /// Px.
    pub(super) radius: f64,
}

/// The largest discs inside a mask `[H,W]` of this size, none nearer to a larger one than twice its radius, from this radius
/// on. What is beyond the image's edge is outside.
pub(super) fn largest(mask: &[bool], size: [u32; 2], smallest: f64) -> Vec<Disc> {
    let [width, height] = size.map(|s| s as usize);
    let mut depth = distance_inside(mask, width, height, 0);
    let mut found = Vec::new();
    while found.len() < MOST {
        let deepest = depth.iter().enumerate().max_by(|a, b| a.1.cmp(b.1).then(b.0.cmp(&a.0)));
        let Some((at, &steps)) = deepest else { break };
        // Half a pixel lies between the centre of the last pixel inside and the mask's edge.
        let radius = f64::from(steps) / f64::from(STEPS[0]) - 0.5;
        if steps == 0 || radius < smallest {
            break;
        }
        let middle = pixel(at, width);
        let centre = (0..CENTRINGS).fold(middle, |centre, _| centre_around(mask, width, centre, radius + 1.0));
        found.push(Disc { centre, radius });
        for (i, depth) in depth.iter_mut().enumerate() {
            if (pixel(i, width) - middle).length() <= 2.0 * radius {
                *depth = 0;
            }
        }
    }
    found
}

/// Centre of pixel `i`.
fn pixel(i: usize, width: usize) -> DVec2 {
    DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5)
}

/// Mean place of the mask's pixels around `middle`.
fn centre_around(mask: &[bool], width: usize, middle: DVec2, radius: f64) -> DVec2 {
    let near = |i: &usize| mask[*i] && (pixel(*i, width) - middle).length() <= radius;
    let (sum, count) =
        (0..mask.len()).filter(near).fold((DVec2::ZERO, 0.0), |(s, n), i| (s + pixel(i, width), n + 1.0));
    if count > 0.0 { sum / count } else { middle }
}

/// A mask with what lies within so many pixels of it to both sides (morphological closing).
pub(super) fn closed(mask: &[bool], size: [u32; 2], by: f32) -> Vec<bool> {
    let outside: Vec<bool> = distance_to(mask, size).iter().map(|d| *d > by).collect();
    distance_to(&outside, size).iter().map(|d| *d > by).collect()
}

/// `[H,W]` distance of each pixel of an image of this size to the next one of a mask, px; infinite where there is none.
pub(crate) fn distance_to(mask: &[bool], size: [u32; 2]) -> Vec<f32> {
    let [width, height] = size.map(|s| s as usize);
    let outside: Vec<bool> = mask.iter().map(|m| !m).collect();
    let steps = distance_inside(&outside, width, height, FAR);
    steps.iter().map(|&s| if s < FAR { s as f32 / STEPS[0] as f32 } else { f32::INFINITY }).collect()
}

/// Of each pixel of the mask its distance to what is not mask, in [`STEPS`]; 0 elsewhere. Beyond the image's edge that of the mask's
/// pixels there is `beyond`. (Borgefors 1986: two passes.)
fn distance_inside(mask: &[bool], width: usize, height: usize, beyond: u32) -> Vec<u32> {
    let mut distance: Vec<u32> = mask.iter().map(|m| if *m { FAR } else { 0 }).collect();
    let order = |i: usize, back: bool| if back { width * height - 1 - i } else { i };
    for back in [false, true] {
        for i in 0..width * height {
            let at = order(i, back);
            let (x, y) = ((at % width) as i64, (at / width) as i64);
            let sign = if back { 1 } else { -1 };
            let neighbours = [(sign, 0, 0), (0, sign, 0), (sign, sign, 1), (-sign, sign, 1)];
            for (dx, dy, corner) in neighbours {
                let (nx, ny) = (x + dx, y + dy);
                let inside = nx >= 0 && ny >= 0 && nx < width as i64 && ny < height as i64;
                let from = if inside { distance[ny as usize * width + nx as usize] } else { beyond };
                distance[at] = distance[at].min(from + STEPS[corner]);
            }
        }
    }
    distance
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `[H,W]` of a disc.
    fn mask(size: [u32; 2], discs: &[(f64, f64, f64)]) -> Vec<bool> {
        let inside = |p: DVec2| discs.iter().any(|(x, y, r)| (p - DVec2::new(*x, *y)).length() <= *r);
        (0..(size[0] * size[1]) as usize).map(|i| inside(pixel(i, size[0] as usize))).collect()
    }

    #[test]
    fn discs_are_found_the_largest_first() {
        let size = [90, 60];
        let found = largest(&mask(size, &[(20.0, 30.0, 6.0), (60.0, 25.0, 12.0), (80.5, 50.0, 2.0)]), size, 3.0);
        assert_eq!(found.len(), 2, "{found:?}");
        for (disc, (x, y, r)) in found.iter().zip([(60.0, 25.0, 12.0), (20.0, 30.0, 6.0)]) {
            assert!((disc.centre - DVec2::new(x, y)).length() < 0.5, "{disc:?}");
            assert!((disc.radius / r - 1.0).abs() < 0.15, "{disc:?}");
        }
    }

    #[test]
    fn distances_are_those_to_the_next_pixel() {
        let size = [30_u32, 20];
        let one: Vec<bool> = (0..600).map(|i| i == 10 * 30 + 12).collect();
        let found = distance_to(&one, size);
        for (i, distance) in found.iter().enumerate() {
            let exact = (pixel(i, 30) - pixel(10 * 30 + 12, 30)).length();
            assert!((f64::from(*distance) - exact).abs() <= 0.09 * exact, "{i}: {distance} {exact}");
        }
        assert!(distance_to(&[false; 600], size).iter().all(|d| d.is_infinite()));
    }

    #[test]
    fn slivers_and_empty_masks_have_none() {
        let size = [40, 40];
        let line: Vec<bool> = (0..1600).map(|i| i / 40 % 20 < 3).collect();
        assert_eq!([largest(&line, size, 3.0).len(), largest(&[false; 1600], size, 1.0).len()], [0, 0]);
        // An image that is all mask: its edge bounds the disc.
        let all = largest(&[true; 1600], size, 3.0);
        assert!((19.0..=20.5).contains(&all[0].radius), "{all:?}");
    }
}
