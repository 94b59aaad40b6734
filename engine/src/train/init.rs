//! The Gaussians that training starts from, made on the host.

use rayon::prelude::*;

use super::rng;
use crate::scene::Gaussians;

/// SH basis function of degree 0: 1 / (2√π).
const SH_0: f64 = 0.282_094_791_773_878_14;
/// Opacity of a new Gaussian.
const INITIAL_OPACITY: f64 = 0.1;
/// Smallest mean squared distance to the neighbours.
const MIN_SQUARED_DISTANCE: f64 = 1.0e-7;
/// Stream of random numbers used here.
const STREAM_POSITION: u32 = 0x1717_0001;
/// Colour of points that come from no picture. Random colours would leave near-black points on a black background: nothing
/// sees them, so nothing prunes them, and superpoints are spent on them (1.9 to 3.7 dB at 2,000 to 3,000 iterations).
pub(crate) const MID_GREY: [u8; 3] = [128; 3];

/// A coloured point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// World units.
    pub position: [f32; 3],
    /// RGB, 8 bits each.
    pub color: [u8; 3],
}

/// One Gaussian per point as 3D Gaussian splatting starts (Kerbl et al. 2023, section 5.1): isotropic with the root mean
/// square distance to the three nearest other points as its scale, opacity 0.1, no rotation, the point's colour.
pub fn from_points(points: &[Point], sh_degree: u32) -> Gaussians {
    let positions: Vec<[f32; 3]> = points.iter().map(|p| p.position).collect();
    let log_scale = |d: f64| [(0.5 * d.max(MIN_SQUARED_DISTANCE).ln()) as f32; 3];
    let coefficients = ((sh_degree + 1) * (sh_degree + 1)) as usize;
    let mut sh = vec![0.0; points.len() * coefficients * 3];
    for (row, point) in sh.chunks_exact_mut(coefficients * 3).zip(points) {
        for (to, color) in row.iter_mut().zip(point.color) {
            *to = ((f64::from(color) / 255.0 - 0.5) / SH_0) as f32;
        }
    }
    let opacity_logit = (INITIAL_OPACITY / (1.0 - INITIAL_OPACITY)).ln() as f32;
    Gaussians {
        log_scale: nearest_squared(&positions).into_iter().map(log_scale).collect(),
        rotation: vec![[1.0, 0.0, 0.0, 0.0]; points.len()],
        opacity_logit: vec![opacity_logit; points.len()],
        sh_degree,
        sh,
        mean: positions,
        ..Gaussians::default()
    }
}

/// Mid-grey points uniform in [−half, half]³; point i depends on (seed, i) only. The released code starts D-NeRF scenes from
/// 100,000 of them with half = 1.3.
pub fn random_points(count: usize, half: f64, seed: u64) -> Vec<Point> {
    let unit = |i: usize, axis: usize| rng::uniform(seed, STREAM_POSITION, (3 * i + axis) as u64);
    let point = |i: usize| Point {
        position: std::array::from_fn(|axis| (half * (2.0 * unit(i, axis) - 1.0)) as f32),
        color: MID_GREY,
    };
    (0..count).map(point).collect()
}

/// Mean squared distance of each point to its three nearest others (all others when there are fewer; 0 for a single point).
pub fn nearest_squared(points: &[[f32; 3]]) -> Vec<f64> {
    let tree = Tree::new(points);
    (0..points.len())
        .into_par_iter()
        .map(|i| {
            let nearest = tree.nearest(i);
            let found = nearest.iter().filter(|d| d.is_finite());
            found.clone().sum::<f64>() / found.count().max(1) as f64
        })
        .collect()
}

/// A k-d tree without nodes: `order` is arranged so that the middle of every range splits it along the range's axis, and
/// ranges take the axes in turn.
struct Tree<'a> {
    points: &'a [[f32; 3]],
    order: Vec<u32>,
}

/// Ranges of at most this many points are searched one by one.
const LEAF: usize = 8;

impl<'a> Tree<'a> {
    fn new(points: &'a [[f32; 3]]) -> Self {
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        Self::arrange(points, &mut order, 0);
        Self { points, order }
    }

    fn arrange(points: &[[f32; 3]], order: &mut [u32], axis: usize) {
        if order.len() <= LEAF {
            return;
        }
        let middle = order.len() / 2;
        let place = |i: &u32| points[*i as usize][axis];
        order.select_nth_unstable_by(middle, |a, b| place(a).total_cmp(&place(b)).then(a.cmp(b)));
        let (low, high) = order.split_at_mut(middle);
        let next = (axis + 1) % 3;
        rayon::join(|| Self::arrange(points, low, next), || Self::arrange(points, &mut high[1..], next));
    }

    /// Squared distances to the three nearest other points, ascending; infinite where there are fewer.
    fn nearest(&self, of: usize) -> [f64; 3] {
        let mut best = [f64::INFINITY; 3];
        self.search(&self.order, 0, of, &mut best);
        best
    }

    fn search(&self, order: &[u32], axis: usize, of: usize, best: &mut [f64; 3]) {
        if order.len() <= LEAF {
            order.iter().for_each(|&i| self.visit(i as usize, of, best));
            return;
        }
        let middle = order.len() / 2;
        let split = order[middle] as usize;
        self.visit(split, of, best);
        let offset = f64::from(self.points[of][axis]) - f64::from(self.points[split][axis]);
        let (low, high) = (&order[..middle], &order[middle + 1..]);
        let (near, far) = if offset < 0.0 { (low, high) } else { (high, low) };
        let next = (axis + 1) % 3;
        self.search(near, next, of, best);
        if offset * offset <= best[2] {
            self.search(far, next, of, best);
        }
    }

    fn visit(&self, i: usize, of: usize, best: &mut [f64; 3]) {
        if i == of {
            return;
        }
        let (a, b) = (self.points[i], self.points[of]);
        let distance: f64 = (0..3).map(|k| (f64::from(a[k]) - f64::from(b[k])).powi(2)).sum();
        let place = best.iter().position(|d| distance < *d);
        if let Some(place) = place {
            best[place..].rotate_right(1);
            best[place] = distance;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn brute_force(points: &[[f32; 3]], of: usize) -> f64 {
        let distance = |p: &[f32; 3]| (0..3).map(|k| (f64::from(p[k]) - f64::from(points[of][k])).powi(2)).sum::<f64>();
        let mut all: Vec<f64> = points.iter().enumerate().filter(|(i, _)| *i != of).map(|(_, p)| distance(p)).collect();
        all.sort_by(f64::total_cmp);
        all.truncate(3);
        all.iter().sum::<f64>() / all.len().max(1) as f64
    }

    #[test]
    fn neighbours_equal_brute_force() {
        for n in [0, 1, 2, 3, 4, 9, 100, 700] {
            let mut points: Vec<[f32; 3]> = random_points(n, 1.3, 3).iter().map(|p| p.position).collect();
            // Duplicates, a line, and a far point.
            for i in 0..n / 4 {
                points[i] = if i % 2 == 0 { [0.5, 0.25, 0.125] } else { [i as f32 * 0.01, 0.0, 0.0] };
            }
            if n > 9 {
                points[n - 1] = [1e4, -2e4, 5.0];
            }
            let found = nearest_squared(&points);
            for (i, value) in found.iter().enumerate() {
                assert!((value - brute_force(&points, i)).abs() <= 1e-12 * value.max(1.0), "{n} [{i}]");
            }
        }
    }

    #[test]
    fn gaussians_of_points() {
        let points = random_points(50, 1.3, 9);
        assert_eq!(points, random_points(50, 1.3, 9));
        assert_eq!(points[..20], random_points(20, 1.3, 9));
        assert_ne!(points, random_points(50, 1.3, 10));
        assert!(points.iter().all(|p| p.position.iter().all(|c| c.abs() <= 1.3)));
        // Visible on black as on white.
        assert!(points.iter().all(|p| p.color.iter().all(|c| (100..156).contains(c))));
        for degree in 0..=3 {
            let g = from_points(&points, degree);
            assert_eq!((g.len(), g.sh.len()), (50, 50 * 3 * ((degree + 1) * (degree + 1)) as usize));
            let row = g.sh_coefficients() * 3;
            for (i, p) in points.iter().enumerate() {
                for c in 0..3 {
                    let color = 0.5 + SH_0 * f64::from(g.sh[i * row + c]);
                    assert!((color - f64::from(p.color[c]) / 255.0).abs() < 1e-6);
                }
                assert!(g.sh[i * row + 3..(i + 1) * row].iter().all(|s| *s == 0.0));
            }
            let opacity = 1.0 / (1.0 + f64::from(-g.opacity_logit[7]).exp());
            assert!((opacity - 0.1).abs() < 1e-7);
        }
        let twins = [points[0], points[0], points[0], points[0]];
        assert!((f64::from(from_points(&twins, 0).log_scale[2][1]) - 0.5 * 1e-7_f64.ln()).abs() < 1e-5);
    }
}
