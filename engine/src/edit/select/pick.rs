//! What is seen at a pixel, or in a rectangle of them.

use glam::DVec2;
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::reference::{ALPHA_MIN, Parameters, ReferenceOptions, Splat, TRANSMITTANCE_MIN, place_scene, project};
use crate::scene::{Camera, MotionSource, Rejected, Scene};

/// Most pixels of a rectangle: an image of 16,384 a side.
const MOST_PIXELS: f64 = (1_u64 << 28) as f64;

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
pub fn click(scene: &Scene, camera: &Camera, time: f64, point: [f64; 2], depth: Depth) -> Result<Vec<bool>> {
    let [x, y] = point;
    let size = [camera.width, camera.height].map(f64::from);
    if !((0.0..size[0]).contains(&x) && (0.0..size[1]).contains(&y)) {
        let expected = format!("a pixel of the {}x{} image", camera.width, camera.height);
        return Err(Error::usage("click", format!("{x},{y}"), expected));
    }
    let splats = splats(scene, camera, time)?;
    let seen: Vec<&Splat> = splats.iter().collect();
    // A point belongs to its pixel, which is drawn at its centre.
    let centre = DVec2::new(x.floor() + 0.5, y.floor() + 0.5);
    let mut mask = vec![false; scene.gaussians.len()];
    let Some(surface) = surface(&seen, centre) else {
        return Err(Error::usage("click", format!("nothing at {x},{y}"), "a pixel where something is seen"));
    };
    match depth {
        Depth::Surface => mask[surface.index] = true,
        Depth::Behind(most) => {
            let touched = seen.iter().filter(|s| s.alpha(centre) >= ALPHA_MIN && s.depth <= surface.depth + most);
            touched.for_each(|s| mask[s.index] = true);
        }
    }
    Ok(mask)
}

/// Gaussians in a rectangle `[x0, y0, x1, y1]` of pixels: those on the surface of one of its pixels, or those whose centre is
/// seen in it and lies no deeper than asked for behind the surface of that pixel.
///
/// # Errors
/// [`Error::Usage`] for a rectangle without pixels in the image, [`Error::Limit`] for too many; those of placing Gaussians.
pub fn rectangle(scene: &Scene, camera: &Camera, time: f64, corners: [f64; 4], depth: Depth) -> Result<Vec<bool>> {
    let side = |a: f64, b: f64, most: u32| [a.min(b).floor().max(0.0), a.max(b).ceil().min(f64::from(most))];
    let (x, y) = (side(corners[0], corners[2], camera.width), side(corners[1], corners[3], camera.height));
    if !(x[0] < x[1] && y[0] < y[1]) {
        let expected = format!("corners in the {}x{} image", camera.width, camera.height);
        return Err(Error::usage("rect", format!("{corners:?}"), expected));
    }
    let pixels = (x[1] - x[0]) * (y[1] - y[0]);
    if pixels > MOST_PIXELS {
        return Err(Error::Limit { what: "pixels of a rect".into(), need: pixels as u128, have: MOST_PIXELS as u128 });
    }
    let splats = splats(scene, camera, time)?;
    let columns = (x[1] - x[0]) as usize;
    let rows: Vec<Vec<Option<&Splat>>> = (y[0] as usize..y[1] as usize)
        .into_par_iter()
        .map(|row| {
            let y = row as f64 + 0.5;
            let on_row: Vec<&Splat> = splats.iter().filter(|s| reaches(s, y)).collect();
            (0..columns).map(|column| surface(&on_row, DVec2::new(x[0] + column as f64 + 0.5, y))).collect()
        })
        .collect();
    let mut mask = vec![false; scene.gaussians.len()];
    match depth {
        Depth::Surface => rows.iter().flatten().flatten().for_each(|s| mask[s.index] = true),
        Depth::Behind(most) => {
            for s in splats.iter().filter(|s| (x[0]..x[1]).contains(&s.mean.x) && (y[0]..y[1]).contains(&s.mean.y)) {
                let front = rows[(s.mean.y - y[0]) as usize][(s.mean.x - x[0]) as usize];
                mask[s.index] = front.is_none_or(|front| s.depth <= front.depth + most);
            }
        }
    }
    Ok(mask)
}

/// The Gaussian that contributes most at a point, the nearest of equals.
fn surface<'a>(splats: &[&'a Splat], point: DVec2) -> Option<&'a Splat> {
    let (mut left, mut best) = (1.0, (0.0, None));
    for splat in splats {
        let alpha = splat.alpha(point);
        if alpha < ALPHA_MIN {
            continue;
        }
        let next = left * (1.0 - alpha);
        if next < TRANSMITTANCE_MIN {
            break;
        }
        if alpha * left > best.0 {
            best = (alpha * left, Some(*splat));
        }
        left = next;
    }
    best.1
}

/// Whether a splat may show on a row: the height of the ellipse where α is 1/255, a little more.
fn reaches(splat: &Splat, y: f64) -> bool {
    let reach = 2.0 * (splat.opacity / ALPHA_MIN).ln().max(0.0) * splat.covariance[2];
    (y - splat.mean.y).abs() <= reach.sqrt() + 1e-6
}

/// Everything that may be seen, front to back, as the f64 reference draws it.
fn splats(scene: &Scene, camera: &Camera, time: f64) -> Result<Vec<Splat>> {
    let parameters = Parameters::from(&scene.gaussians);
    parameters.check()?;
    let placed = place_scene(scene, time, MotionSource::Auto)?;
    let near = ReferenceOptions::default().near;
    let mut splats: Vec<Splat> = (0..scene.gaussians.len())
        .into_par_iter()
        .filter(|&i| scene.gaussians.is_valid(i, &mut Rejected::default()))
        .filter_map(|i| {
            let place = (placed.mean[i], placed.rotation[i], placed.scale[i]);
            project(&parameters, i, place, placed.opacity[i], camera, near)
        })
        .collect();
    splats.par_sort_by(|a, b| a.depth.total_cmp(&b.depth).then(a.index.cmp(&b.index)));
    Ok(splats)
}
