//! The Gaussians that a run starts from.

use super::config::Config;
use super::init::{Point, from_points, random_points};
use crate::data::dataset::Points;
use crate::scene::Gaussians;

/// From the data set's points, evenly thinned to `gaussians.max_points`; from random ones where it has none. Also says so
/// in words.
pub fn first(config: &Config, points: Option<&Points>) -> (Gaussians, String) {
    let g = &config.gaussians;
    let (chosen, line) = match points.filter(|p| !p.position.is_empty()) {
        Some(p) => {
            let (n, most) = (p.position.len(), (g.max_points as usize).max(1));
            let kept = n.min(most);
            let at = |i: usize| Point { position: p.position[i * n / kept], color: p.colour[i * n / kept] };
            ((0..kept).map(at).collect(), format!("{kept} of the data set's {n} points"))
        }
        None => {
            let half = f64::from(g.random_extent);
            let line = format!("{} random points in a cube of edge {}", g.random_points, 2.0 * g.random_extent);
            (random_points(g.random_points as usize, half, config.seed), line)
        }
    };
    let mut gaussians = from_points(&chosen, g.sh_degree);
    let logit = (g.initial_opacity / (1.0 - g.initial_opacity)).ln();
    gaussians.opacity_logit.fill(logit);
    (gaussians, line)
}
