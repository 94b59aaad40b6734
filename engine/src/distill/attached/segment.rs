//! Straight, thin pieces of a mask: what a rod looks like.

use glam::DVec2;

/// Pieces looked for in a mask, the longest first.
const MOST: usize = 3;
/// Fewest pixels of their length.
pub(super) const SHORTEST: f64 = 8.0;
/// Directions that are tried.
const DIRECTIONS: u32 = 90;
/// A piece goes on over gaps of so many pixels.
const GAP: f64 = 2.5;
/// Pixels from its line within which the mask is the piece, and within which no other one is looked for.
const HALF_WIDTH: f64 = 1.6;
const TAKEN: f64 = 3.0;
/// An end so near to the image's edge is cut off, px.
const EDGE: f64 = 2.5;

/// A straight piece.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Segment {
    /// Px.
    pub(super) ends: [DVec2; 2],
    /// Which of them lie at the image's edge: it goes on beyond.
    pub(super) cut: [bool; 2],
}

impl Segment {
    /// Px.
    pub(super) fn length(&self) -> f64 {
        self.ends[0].distance(self.ends[1])
    }
}

/// The longest straight pieces of a mask `[H,W]` of this size.
pub(super) fn segments(mask: &[bool], size: [u32; 2]) -> Vec<Segment> {
    let width = size[0] as usize;
    let pixel = |i: usize| DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
    let mut left: Vec<DVec2> = mask.iter().enumerate().filter(|(_, m)| **m).map(|(i, _)| pixel(i)).collect();
    let mut found = Vec::new();
    while found.len() < MOST {
        let Some(run) = longest(&left).filter(|run| run.length() >= SHORTEST) else { break };
        let own: Vec<DVec2> = left.iter().copied().filter(|p| run.is_near(*p, HALF_WIDTH)).collect();
        let line = Run::along(&own);
        let ends = [line.from, line.to].map(|s| line.at(s));
        let far = size.map(|s| f64::from(s) - EDGE);
        let is_cut = |p: DVec2| p.min_element() < EDGE || p.x > far[0] || p.y > far[1];
        found.push(Segment { ends, cut: ends.map(is_cut) });
        left.retain(|p| !line.is_near(*p, TAKEN) && !run.is_near(*p, HALF_WIDTH));
    }
    found
}

/// A stretch of a line.
#[derive(Debug, Clone, Copy)]
struct Run {
    way: DVec2,
    /// Along the normal, and along the way, px.
    offset: f64,
    from: f64,
    to: f64,
}

impl Run {
    /// The line of these points with the least squares.
    fn along(points: &[DVec2]) -> Self {
        let n = points.len().max(1) as f64;
        let middle = points.iter().sum::<DVec2>() / n;
        let [xx, xy, yy] = points.iter().fold([0.0; 3], |[xx, xy, yy], p| {
            let d = *p - middle;
            [xx + d.x * d.x, xy + d.x * d.y, yy + d.y * d.y]
        });
        let way = DVec2::from_angle(0.5 * (2.0 * xy).atan2(xx - yy));
        let (from, to) = points
            .iter()
            .map(|p| p.dot(way))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), s| (a.min(s), b.max(s)));
        Self { way, offset: middle.dot(way.perp()), from, to }
    }

    fn length(&self) -> f64 {
        self.to - self.from
    }

    fn at(&self, along: f64) -> DVec2 {
        self.offset * self.way.perp() + along * self.way
    }

    fn is_near(&self, p: DVec2, within: f64) -> bool {
        let along = p.dot(self.way);
        (p.dot(self.way.perp()) - self.offset).abs() <= within
            && along >= self.from - within
            && along <= self.to + within
    }
}

/// The longest run of pixels along a line.
fn longest(pixels: &[DVec2]) -> Option<Run> {
    let directions =
        (0..DIRECTIONS).map(|k| DVec2::from_angle(std::f64::consts::PI * f64::from(k) / f64::from(DIRECTIONS)));
    let runs = directions.filter_map(|way| longest_along(pixels, way));
    runs.reduce(|a, b| if b.length() > a.length() { b } else { a })
}

fn longest_along(pixels: &[DVec2], way: DVec2) -> Option<Run> {
    let mut places: Vec<(i64, f64)> = pixels.iter().map(|p| (p.dot(way.perp()).floor() as i64, p.dot(way))).collect();
    places.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let runs = places.chunk_by(|a, b| a.0 == b.0 && b.1 - a.1 <= GAP);
    let of = |run: &[(i64, f64)]| Some(Run { way, offset: run[0].0 as f64 + 0.5, from: run[0].1, to: run.last()?.1 });
    runs.filter_map(of).reduce(|a, b| if b.length() > a.length() { b } else { a })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(size: [u32; 2], is_in: impl Fn(DVec2) -> bool) -> Vec<bool> {
        let [w, h] = size.map(|s| s as usize);
        (0..w * h).map(|i| is_in(DVec2::new((i % w) as f64 + 0.5, (i / w) as f64 + 0.5))).collect()
    }

    #[test]
    fn rods_are_found_with_their_ends() {
        let size = [120, 90];
        let [a, b] = [DVec2::new(20.0, 70.0), DVec2::new(80.0, 30.0)];
        let way = (b - a).normalize();
        let on = |p: DVec2| (p - a).perp_dot(way).abs() < 1.0 && (0.0..=a.distance(b)).contains(&(p - a).dot(way));
        let beside = |p: DVec2| p.x > 100.0 && (p.y - 10.0).abs() < 1.5;
        let found = segments(&mask(size, |p| on(p) || beside(p) || p.distance(DVec2::splat(12.0)) < 3.0), size);
        assert_eq!(found.len(), 2, "{found:?}");
        let near = |end: DVec2| found[0].ends.iter().any(|e| e.distance(end) < 2.0);
        assert!(near(a) && near(b) && found[0].cut == [false; 2], "{found:?}");
        assert!(found[1].cut[0] != found[1].cut[1], "{found:?}");
        assert!(segments(&mask(size, |_| false), size).is_empty());
    }
}
