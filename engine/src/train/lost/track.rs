//! The path of one object, from the directions in which images show it: the smooth path that passes nearest to the lines of
//! sight, where most of them pass through it.
//!
//! Of c(t), one place per time, Σ w |(I − d dᵀ)(c − o)|² + λ Σ |c₋ − 2c + c₊|² is least; w falls with the distance of a line of
//! sight (iteratively reweighted least squares), and of several candidates of an image the nearest one counts.

use glam::DVec3;

/// Weight of the path's second differences beside a line of sight.
const SMOOTHNESS: f64 = 0.02;
/// Weight of the first differences: holds an end that nothing shows.
const STIFFNESS: f64 = 1e-5;
/// Rounds of weighing anew.
const ROUNDS: usize = 15;
/// Steps of conjugate gradients, at most.
const STEPS: usize = 3000;
/// Radii beyond which two lines of sight of neighbours show different things, however far apart they pass.
const APART: f64 = 2.0;
/// Images that must show it.
const FEWEST: usize = 12;
/// Share of them in which it must be about as large as in the middle one, and how much that is.
const SHARE_OF_SIZES: f64 = 0.6;
const ABOUT: f64 = 0.35;

/// When a path counts.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rule {
    /// A line of sight belongs to it if it passes within so many of the object's radii.
    pub(super) near: f64,
    /// Share of the sights with candidates of which one must belong to it.
    pub(super) share: f64,
    /// Share of all sights that must.
    pub(super) of_all: f64,
}

impl Rule {
    /// Of a path with so many sights, of so many with candidates, and of all.
    pub(super) fn holds(&self, seen: usize, shown: usize, all: usize) -> bool {
        let is_share = |share: f64, of: usize| seen as f64 >= share * of as f64;
        seen >= FEWEST && is_share(self.share, shown) && is_share(self.of_all, all)
    }
}

/// A direction in which an image shows something.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate {
    /// From the camera, of length 1 along its axis.
    pub(super) direction: DVec3,
    /// Of what is there, per unit of depth.
    pub(super) radius: f64,
}

/// What an image shows.
#[derive(Debug, Clone)]
pub(super) struct Sight {
    /// Index of its time.
    pub(super) time: usize,
    /// Camera centre, world units.
    pub(super) origin: DVec3,
    /// The likeliest first.
    pub(super) candidates: Vec<Candidate>,
}

/// A path.
#[derive(Debug, Clone)]
pub(super) struct Track {
    /// One per time, world units.
    pub(super) places: Vec<DVec3>,
    /// Of the object, world units.
    pub(super) radius: f64,
    /// The sights that it passes through, and which candidate of each.
    pub(super) seen: Vec<(usize, usize)>,
}

impl Candidate {
    /// Distance of `place` from the line of sight, and depth along it.
    fn distance(&self, origin: DVec3, place: DVec3) -> (f64, f64) {
        let unit = self.direction.normalize();
        let along = (place - origin).dot(unit);
        ((place - origin - along * unit).length(), along / self.direction.length())
    }
}

/// The path through `times` times of what most sights show; `None` where they show no one thing.
pub(super) fn track(sights: &[Sight], times: usize, rule: Rule) -> Option<Track> {
    let shown = sights.iter().filter(|s| !s.candidates.is_empty()).count();
    if shown < FEWEST || times < 3 {
        return None;
    }
    let mut lines = likeliest(sights);
    let mut places = vec![DVec3::ZERO; times];
    for _ in 0..ROUNDS {
        places = smoothest(sights, &lines, places);
        reweigh(sights, &places, &mut lines);
    }
    let found = judge(sights, &places, rule.near)?;
    rule.holds(found.seen.len(), shown, sights.len()).then_some(Track { places, ..found })
}

/// The candidate of each image with which lines of sight pass nearest to those of the images before and after (Viterbi's
/// shortest path).
fn likeliest(sights: &[Sight]) -> Vec<Option<(usize, f64)>> {
    let mut order: Vec<usize> = (0..sights.len()).filter(|&i| !sights[i].candidates.is_empty()).collect();
    order.sort_by_key(|&i| (sights[i].time, i));
    // By place in the order and candidate: the cost of the best chain that ends there, and the candidate before.
    let mut chains: Vec<Vec<(f64, usize)>> = Vec::with_capacity(order.len());
    for (k, &i) in order.iter().enumerate() {
        let best = |candidate: &Candidate| {
            let Some(before) = k.checked_sub(1) else { return (0.0, 0) };
            let last = &sights[order[before]];
            let costs = chains[before]
                .iter()
                .zip(&last.candidates)
                .map(|((cost, _), other)| cost + gap((last.origin, other), (sights[i].origin, candidate)).min(APART));
            costs.enumerate().min_by(|a, b| a.1.total_cmp(&b.1)).map_or((0.0, 0), |(at, cost)| (cost, at))
        };
        chains.push(sights[i].candidates.iter().map(best).collect());
    }
    let mut chosen = vec![None; sights.len()];
    let mut end = chains.last().and_then(|c| (0..c.len()).min_by(|a, b| c[*a].0.total_cmp(&c[*b].0))).unwrap_or(0);
    for (&i, chain) in order.iter().zip(&chains).rev() {
        chosen[i] = Some((end, 1.0));
        end = chain[end].1;
    }
    chosen
}

/// How far apart two lines of sight pass, in radii of what they show there.
fn gap(first: (DVec3, &Candidate), second: (DVec3, &Candidate)) -> f64 {
    let [(p, a), (q, b)] = [first, second];
    let (u, v, w) = (a.direction, b.direction, p - q);
    let (uu, uv, vv, uw, vw) = (u.dot(u), u.dot(v), v.dot(v), u.dot(w), v.dot(w));
    let determinant = (uu * vv - uv * uv).max(1e-12);
    // Depths of the nearest points.
    let [s, t] = [(uv * vw - vv * uw) / determinant, (uu * vw - uv * uw) / determinant];
    let radius = 0.5 * (a.radius * s + b.radius * t);
    if s > 0.0 && t > 0.0 { (p + s * u - q - t * v).length() / radius } else { APART }
}

/// Takes each image's nearest candidate, weighed by its distance beside the median one.
fn reweigh(sights: &[Sight], places: &[DVec3], lines: &mut [Option<(usize, f64)>]) {
    let nearest = |s: &Sight| {
        let distances = s.candidates.iter().map(|c| c.distance(s.origin, places[s.time]).0);
        distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1))
    };
    let found: Vec<_> = sights.iter().map(nearest).collect();
    let scale = median(found.iter().flatten().map(|(_, distance)| *distance)).max(1e-12);
    for (line, found) in lines.iter_mut().zip(found) {
        *line = found.map(|(candidate, distance)| (candidate, 1.0 / (1.0 + (distance / scale).powi(2))));
    }
}

/// The sights that the path passes through; `None` where what they show has no one size.
fn judge(sights: &[Sight], places: &[DVec3], near_radii: f64) -> Option<Track> {
    let mut near = Vec::new();
    for (i, sight) in sights.iter().enumerate() {
        let of = |(k, c): (usize, &Candidate)| {
            let (distance, depth) = c.distance(sight.origin, places[sight.time]);
            (depth > 0.0).then_some((k, distance, c.radius * depth))
        };
        let candidates = sight.candidates.iter().enumerate().filter_map(of);
        near.extend(
            candidates.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(k, distance, radius)| (i, k, distance, radius)),
        );
    }
    let radius = median(near.iter().map(|n| n.3));
    near.retain(|n| n.2 <= near_radii * radius);
    // What is half hidden looks smaller: of those that belong, the size of the larger half.
    let radius = median(near.iter().map(|n| n.3).filter(|r| *r >= radius));
    let alike = near.iter().filter(|n| (n.3 / radius - 1.0).abs() <= ABOUT).count();
    let seen = near.iter().map(|n| (n.0, n.1)).collect();
    (alike as f64 >= SHARE_OF_SIZES * near.len() as f64 && radius > 0.0).then_some(Track {
        places: Vec::new(),
        radius,
        seen,
    })
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

/// The least of the sum above, by conjugate gradients from `start`.
fn smoothest(sights: &[Sight], lines: &[Option<(usize, f64)>], start: Vec<DVec3>) -> Vec<DVec3> {
    let lines: Vec<(usize, DVec3, DVec3, f64)> = sights
        .iter()
        .zip(lines)
        .filter_map(|(s, line)| {
            let (candidate, weight) = (*line)?;
            Some((s.time, s.origin, s.candidates[candidate].direction.normalize(), weight))
        })
        .collect();
    let across = |unit: DVec3, v: DVec3| v - v.dot(unit) * unit;
    let mut right = vec![DVec3::ZERO; start.len()];
    for (time, origin, unit, weight) in &lines {
        right[*time] += *weight * across(*unit, *origin);
    }
    let product = |x: &[DVec3]| {
        let mut y = vec![DVec3::ZERO; x.len()];
        for (time, _, unit, weight) in &lines {
            y[*time] += *weight * across(*unit, x[*time]);
        }
        for i in 1..x.len().saturating_sub(1) {
            let bend = SMOOTHNESS * (x[i - 1] - 2.0 * x[i] + x[i + 1]);
            y[i - 1] += bend;
            y[i] -= 2.0 * bend;
            y[i + 1] += bend;
        }
        for i in 1..x.len() {
            let step = STIFFNESS * (x[i] - x[i - 1]);
            y[i] += step;
            y[i - 1] -= step;
        }
        y
    };
    conjugate_gradients(product, &right, start)
}

fn dot(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum()
}

/// x with A x = `right`, A symmetric and positive.
fn conjugate_gradients(product: impl Fn(&[DVec3]) -> Vec<DVec3>, right: &[DVec3], start: Vec<DVec3>) -> Vec<DVec3> {
    let mut x = start;
    let mut rest: Vec<DVec3> = right.iter().zip(product(&x)).map(|(b, ax)| *b - ax).collect();
    let mut search = rest.clone();
    let mut now = dot(&rest, &rest);
    let goal = 1e-16 * dot(right, right).max(1e-300);
    for _ in 0..STEPS {
        if now <= goal {
            break;
        }
        let image = product(&search);
        let length = now / dot(&search, &image).max(1e-300);
        for i in 0..x.len() {
            x[i] += length * search[i];
            rest[i] -= length * image[i];
        }
        let next = dot(&rest, &rest);
        let share = next / now;
        for (search, rest) in search.iter_mut().zip(&rest) {
            *search = *rest + share * *search;
        }
        now = next;
    }
    x
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::train::rng;

    const TIMES: usize = 80;
    const RADIUS: f64 = 0.25;
    const RULE: Rule = Rule { near: 0.5, share: 0.6, of_all: 0.4 };

    /// A ball that circles and bounces.
    fn place(time: usize) -> DVec3 {
        let t = time as f64 / (TIMES - 1) as f64;
        DVec3::new((2.5 * t).cos(), (2.5 * t).sin(), 0.6 * (9.0 * t).sin().abs()) * 1.2
    }

    /// What a camera per time, anywhere on a sphere, shows: the ball in `shown` of 100 images, something else in all.
    fn sights(shown: u64) -> Vec<Sight> {
        let random = |time: usize, k: u64| 2.0 * rng::uniform(5, 77, 16 * time as u64 + k) - 1.0;
        let vector = |time: usize, k: u64| DVec3::new(random(time, k), random(time, k + 1), random(time, k + 2));
        let sight = |time: usize| {
            let origin = 4.6 * vector(time, 0).normalize();
            let axis = -origin.normalize();
            let towards = |p: DVec3, radius: f64| {
                let depth = (p - origin).dot(axis);
                Candidate { direction: (p - origin) / depth, radius: radius / depth }
            };
            let other = towards(0.8 * vector(time, 3), 0.3 * (1.0 + random(time, 6)).max(0.1));
            let ball = towards(place(time) + 0.03 * vector(time, 7), RADIUS * (0.9 + 0.1 * random(time, 10)));
            let is_shown = rng::bits(9, 78, time as u64) % 100 < shown;
            Sight { time, origin, candidates: if is_shown { vec![other, ball] } else { vec![other] } }
        };
        (0..TIMES).map(sight).collect()
    }

    #[test]
    fn a_bouncing_ball_is_followed_past_what_else_is_shown() {
        let found = track(&sights(90), TIMES, RULE).unwrap();
        let far: Vec<f64> = (0..TIMES).map(|t| (found.places[t] - place(t)).length()).collect();
        assert!(median(far.iter().copied()) < 0.3 * RADIUS, "{far:?}");
        assert!(far.iter().filter(|d| **d > RADIUS).count() < TIMES / 20, "{far:?}");
        assert!((found.radius / RADIUS - 1.0).abs() < 0.15 && found.seen.len() > 60, "{found:?}");
        assert!(found.seen.iter().filter(|(_, candidate)| *candidate == 1).count() > found.seen.len() * 9 / 10);
    }

    #[test]
    fn images_that_show_no_one_thing_give_no_path() {
        assert!(track(&sights(0), TIMES, RULE).is_none());
        assert!(track(&sights(90)[..8], TIMES, RULE).is_none());
        assert!(track(&[], TIMES, RULE).is_none());
    }
}
