//! What is seen at a pixel, or in a rectangle of them.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::blocks::{Blocks, Reaching, SIDE};
use crate::edit::centers::center_at;
use crate::edit::rows;
use crate::error::{Error, Result};
use crate::reference::{ALPHA_MIN, Parameters, ReferenceOptions, Splat, TRANSMITTANCE_MIN, place_scene, project};
use crate::scene::{Camera, Deformation, MotionSource, Rejected, Scene};

/// Most pixels of a rectangle: an image of 16,384 a side.
const MOST_PIXELS: f64 = (1_u64 << 28) as f64;

/// What a pick looks at.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Through this camera.
    pub camera: &'a Camera,
    /// At this time.
    pub time: f64,
    /// `[N]` what is as if it were not there.
    pub hidden: Option<&'a [bool]>,
}

/// How deep a pick goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Depth {
    /// At each pixel the Gaussian that contributes most.
    Surface,
    /// All Gaussians, down to this many world units behind the surface; infinity: all.
    Behind(f64),
}

/// Gaussians at a point of the image, pixels from its top left corner.
///
/// # Errors
/// [`Error::Usage`] for a point outside of the image, and where nothing is seen; those of placing Gaussians.
pub fn click(view: &View<'_>, point: [f64; 2], depth: Depth) -> Result<Vec<bool>> {
    let ([x, y], camera) = (point, view.camera);
    let size = [camera.width, camera.height].map(f64::from);
    if !((0.0..size[0]).contains(&x) && (0.0..size[1]).contains(&y)) {
        let expected = format!("a pixel of the {}x{} image", camera.width, camera.height);
        return Err(Error::usage("click", format!("{x},{y}"), expected));
    }
    // A point belongs to its pixel, which is drawn at its centre.
    let centre = DVec2::new(x.floor() + 0.5, y.floor() + 0.5);
    let splats = splats(view, [centre, centre])?;
    let seen: Vec<Reaching<'_>> = splats.iter().map(Reaching::new).collect();
    let mut mask = vec![false; view.scene.gaussians.len()];
    let Some(surface) = surface(&seen, centre) else {
        return Err(Error::usage("click", format!("nothing at {x},{y}"), "a pixel where something is seen"));
    };
    match depth {
        Depth::Surface => mask[surface.index] = true,
        Depth::Behind(most) => {
            let touched = seen.iter().filter(|s| s.alpha(centre).is_some() && s.splat.depth <= surface.depth + most);
            touched.for_each(|s| mask[s.splat.index] = true);
        }
    }
    Ok(mask)
}

/// Gaussians in a rectangle `[x0, y0, x1, y1]` of pixels: those on the surface of one of its pixels, or those whose centre is
/// seen in it and lies no deeper than asked for behind the surface of that pixel.
///
/// # Errors
/// [`Error::Usage`] for a rectangle without pixels in the image, [`Error::Limit`] for too many; those of placing Gaussians.
pub fn rectangle(view: &View<'_>, corners: [f64; 4], depth: Depth) -> Result<Vec<bool>> {
    let area = Area::new(view.camera, corners)
        .ok_or_else(|| outside(view.camera, "rect", format!("{corners:?}"), "corners"))?;
    region(view, &area, &|_| true, depth)
}

/// The same within a closed line through `points`, pixels; where it goes around twice is outside. A pixel belongs to it if its
/// centre does.
///
/// # Errors
/// As [`rectangle`].
pub fn lasso(view: &View<'_>, points: &[[f64; 2]], depth: Depth) -> Result<Vec<bool>> {
    let points: Vec<DVec2> = points.iter().map(|p| DVec2::from_array(*p)).collect();
    let low = points.iter().fold(DVec2::INFINITY, |a, b| a.min(*b));
    let high = points.iter().fold(DVec2::NEG_INFINITY, |a, b| a.max(*b));
    let area = Area::new(view.camera, [low.x, low.y, high.x, high.y])
        .ok_or_else(|| outside(view.camera, "lasso", format!("{} points", points.len()), "points"))?;
    region(view, &area, &|at| is_within(&points, at), depth)
}

fn outside(camera: &Camera, what: &str, found: String, points: &str) -> Error {
    Error::usage(what, found, format!("{points} in the {}x{} image", camera.width, camera.height))
}

/// Whether a ray from a point to the right crosses the line through `points` an odd number of times.
fn is_within(points: &[DVec2], at: DVec2) -> bool {
    let next = points.iter().cycle().skip(1);
    let crosses = |(a, b): (&DVec2, &DVec2)| {
        (a.y > at.y) != (b.y > at.y) && at.x < a.x + (b.x - a.x) * (at.y - a.y) / (b.y - a.y)
    };
    points.iter().zip(next).filter(|pair| crosses(*pair)).count() % 2 == 1
}

/// Whole pixels of an image, ends excluded.
pub(super) struct Area {
    pub(super) x: [f64; 2],
    pub(super) y: [f64; 2],
}

impl Area {
    /// The pixels that a rectangle touches; `None` of one beside the image.
    fn new(camera: &Camera, [x0, y0, x1, y1]: [f64; 4]) -> Option<Self> {
        let side = |a: f64, b: f64, most: u32| [a.min(b).floor().max(0.0), a.max(b).ceil().min(f64::from(most))];
        let (x, y) = (side(x0, x1, camera.width), side(y0, y1, camera.height));
        (x[0] < x[1] && y[0] < y[1]).then_some(Self { x, y })
    }

    fn has(&self, at: DVec2) -> bool {
        (self.x[0]..self.x[1]).contains(&at.x) && (self.y[0]..self.y[1]).contains(&at.y)
    }
}

/// Gaussians that are seen in those pixels of an area that are `inside`, asked for their centres.
fn region(view: &View<'_>, area: &Area, inside: &(dyn Fn(DVec2) -> bool + Sync), depth: Depth) -> Result<Vec<bool>> {
    let (x, y) = (area.x, area.y);
    let pixels = (x[1] - x[0]) * (y[1] - y[0]);
    if pixels > MOST_PIXELS {
        return Err(Error::Limit { what: "pixels of a pick".into(), need: pixels as u128, have: MOST_PIXELS as u128 });
    }
    let splats = splats(view, [DVec2::new(x[0], y[0]), DVec2::new(x[1], y[1])])?;
    let columns = (x[1] - x[0]) as usize;
    let blocks = Blocks::new(&splats, x, y);
    let rows: Vec<Vec<Option<&Splat>>> = (y[0] as usize..y[1] as usize)
        .into_par_iter()
        .map(|row| {
            let at = |column: usize| DVec2::new(x[0] + column as f64 + 0.5, row as f64 + 0.5);
            let (mut near, mut seen) = (Vec::new(), Vec::with_capacity(columns));
            for first in (0..columns).step_by(SIDE) {
                near.clear();
                near.extend(blocks.in_row(at(first)));
                let block = (first..columns.min(first + SIDE)).map(at);
                seen.extend(block.map(|at| if inside(at) { surface(&near, at) } else { None }));
            }
            seen
        })
        .collect();
    let mut mask = vec![false; view.scene.gaussians.len()];
    match depth {
        Depth::Surface => rows.iter().flatten().flatten().for_each(|s| mask[s.index] = true),
        Depth::Behind(most) => {
            for s in splats.iter().filter(|s| area.has(s.mean) && inside(s.mean.floor() + 0.5)) {
                let front = rows[(s.mean.y - y[0]) as usize][(s.mean.x - x[0]) as usize];
                mask[s.index] = front.is_none_or(|front| s.depth <= front.depth + most);
            }
        }
    }
    Ok(mask)
}

/// The Gaussian that contributes most at a point, the nearest of equals.
fn surface<'a>(splats: &[Reaching<'a>], point: DVec2) -> Option<&'a Splat> {
    let (mut left, mut best) = (1.0, (0.0, None));
    for reaching in splats {
        let Some(alpha) = reaching.alpha(point) else { continue };
        let next = left * (1.0 - alpha);
        if next < TRANSMITTANCE_MIN {
            break;
        }
        if alpha * left > best.0 {
            best = (alpha * left, Some(reaching.splat));
        }
        left = next;
    }
    best.1
}

/// What may be seen between two pixels, front to back, as the f64 reference draws it.
fn splats(view: &View<'_>, corners: [DVec2; 2]) -> Result<Vec<Splat>> {
    splats_of(view, corners, candidates(view, corners, ReferenceOptions::default().near)?)
}

/// The same of these Gaussians, in order; `None`: of all.
fn splats_of(view: &View<'_>, [low, high]: [DVec2; 2], found: Option<Vec<usize>>) -> Result<Vec<Splat>> {
    let View { scene, camera, time, hidden } = *view;
    let near = ReferenceOptions::default().near;
    let part = found.as_ref().map(|indices| rows::part(scene, indices));
    let drawn = part.as_ref().unwrap_or(scene);
    let number = |k: usize| found.as_ref().map_or(k, |indices| indices[k]);
    let parameters = Parameters::from(&drawn.gaussians);
    let placed = place_scene(drawn, time, MotionSource::Auto)?;
    let splats: Vec<Splat> = (0..drawn.gaussians.len())
        .into_par_iter()
        .filter(|&k| !hidden.is_some_and(|hidden| hidden[number(k)]))
        .filter_map(|k| {
            let place = (placed.mean[k], placed.rotation[k], placed.scale[k]);
            let splat = project(&parameters, k, place, placed.opacity[k], camera, near)?;
            let [from, to] = Reaching::new(&splat).bounds();
            let reaches = !(from.cmpgt(high).any() || to.cmplt(low).any());
            // Last, because it looks at all its coefficients.
            (reaches && scene.gaussians.is_valid(number(k), &mut Rejected::default()))
                .then_some(Splat { index: number(k), ..splat })
        })
        .collect();
    // Splats are long: they are moved once.
    let mut order: Vec<(f64, usize)> = splats.iter().map(|s| s.depth).zip(0..).collect();
    order.par_sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    Ok(order.into_par_iter().map(|(_, k)| splats[k]).collect())
}

/// Gaussians that may show between two pixels: most are far from them. `None`: all, where a network says how large they are.
/// The ellipse of one is never longer than its largest deviation seen at its depth, aside by at most the clamped tangents.
fn candidates(view: &View<'_>, [low, high]: [DVec2; 2], near: f64) -> Result<Option<Vec<usize>>> {
    let View { scene, camera: c, time, .. } = *view;
    let g = &scene.gaussians;
    Parameters::from(g).check()?;
    let is_plain = matches!(scene.deformation, Deformation::None | Deformation::Superpoints(_));
    if !is_plain || scene.deformation.changes_scales() || scene.deformation.nonrigid().is_some() {
        return Ok(None);
    }
    let aside = 1.3 * 0.5 * DVec2::new(f64::from(c.width) / c.fx, f64::from(c.height) / c.fy);
    let focal = c.fx.abs().max(c.fy.abs());
    // Centres away from the middle of the image only make it wider.
    let aside = aside + DVec2::new(c.cx / c.fx, c.cy / c.fy).abs() * 1.3;
    let stretch = focal * (1.0 + aside.length_squared()).sqrt();
    let most = (2.0 * ALPHA_MIN.recip().ln()).sqrt();
    let may_show = |i: usize, x: DVec3| {
        let x = c.rotation * (x - c.position);
        if x.z <= 0.99 * near {
            return false;
        }
        let size = f64::from(g.log_scale[i].into_iter().fold(f32::NEG_INFINITY, f32::max)).exp();
        let reach = most * (size * stretch / x.z + 1.0) + 1.0;
        let at = DVec2::new(c.fx * x.x / x.z + c.cx, c.fy * x.y / x.z + c.cy);
        // What has no place is left to the reference.
        !(at.cmplt(low - reach).any() || at.cmpgt(high + reach).any())
    };
    let center = center_at(scene, time)?;
    Ok(Some((0..g.len()).into_par_iter().filter(|&i| may_show(i, center(i))).collect()))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]
    use super::*;
    use crate::scene::synthetic::{moving_scene, random_scene};

    /// Everything that reaches an area when all are projected is among what is projected for it.
    #[test]
    fn what_is_left_out_of_a_pick_does_not_reach_it() {
        let mut giants = random_scene(2000, 9, 0);
        giants.gaussians.log_scale.iter_mut().flatten().enumerate().for_each(|(k, s)| *s += (k % 5) as f32 - 2.5);
        let (mut compared, mut left_out) = (0, 0);
        for (seed, scene) in [giants, moving_scene(2000, 9, 5, 4, false)].iter().enumerate() {
            for eye in [DVec3::new(0.3, -0.2, -4.0), DVec3::new(0.1, 0.2, 0.3), DVec3::new(1.5, 0.5, 0.9)] {
                let mut camera = Camera::look_at(eye, DVec3::new(0.2, 0.1, 0.5), DVec3::NEG_Y, 1.1, [200, 120]);
                (camera.cx, camera.fy) = (camera.cx + 60.0 * seed as f64, 0.7 * camera.fy);
                let view = View { scene, camera: &camera, time: 0.3, hidden: None };
                let everywhere = [DVec2::NEG_INFINITY, DVec2::INFINITY];
                let all = splats_of(&view, everywhere, None).unwrap();
                for [low, high] in
                    [[[0.0, 0.0], [9.0, 8.0]], [[100.5, 60.5], [100.5, 60.5]], [[150.0, 20.0], [200.0, 90.0]]]
                {
                    let [low, high] = [low, high].map(DVec2::from_array);
                    let kept = splats(&view, [low, high]).unwrap();
                    let reaches = |s: &&Splat| {
                        let level = 2.0 * (s.opacity / ALPHA_MIN).ln().max(0.0);
                        let reach = DVec2::new((level * s.covariance[0]).sqrt(), (level * s.covariance[2]).sqrt());
                        !(s.mean.cmplt(low - reach).any() || s.mean.cmpgt(high + reach).any())
                    };
                    for splat in all.iter().filter(reaches) {
                        let found = kept
                            .iter()
                            .find(|s| s.index == splat.index)
                            .unwrap_or_else(|| panic!("{splat:?} reaches {low}..{high} from {eye} and is left out"));
                        assert_eq!((found.mean, found.depth), (splat.mean, splat.depth));
                        compared += 1;
                    }
                    left_out += all.len() - kept.len();
                }
            }
        }
        assert!(compared > 500 && left_out > 5000, "{compared} compared, {left_out} left out");
    }
}
