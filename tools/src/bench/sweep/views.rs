//! What a sweep looks at, and what it reduces to come to an end.

use engine::data::dataset::{self, Dataset, DatasetOptions, View};
use engine::error::{Error, Result};
use engine::image::Image;
use engine::scene::{Camera, Scene};

use crate::bench::scene::DEFAULT_SIZE;
use crate::cli::args::SweepArgs;
use crate::cli::{camera, model};

/// Views, where the camera path has more.
const VIEWS: usize = 3;
/// Longest image side of the error measurement, pixels.
const ERROR_SIDE: u32 = 256;
/// (Pixels × Gaussians) of all reference images that the f64 reference draws in a few minutes of two cores.
const REFERENCE_WORK: f64 = 3.0 * 256.0 * 256.0 * 150_000.0;
/// Smallest longest side that is still a picture.
const SMALLEST_SIDE: f64 = 96.0;

/// The views of a sweep.
#[derive(Debug)]
pub(super) struct Views {
    /// Cameras of the error measurement with their times.
    pub(super) cameras: Vec<(Camera, f64)>,
    /// Size at which frames are timed; in proportion for cameras of other shapes.
    pub(super) timed_size: [u32; 2],
    /// Photos of the cameras' size over the background, where the camera path has some.
    pub(super) photos: Option<Vec<Image>>,
    /// What was assumed, reduced or left out.
    pub(super) notes: Vec<String>,
}

impl Views {
    /// From the arguments: the cameras of `--cameras`, else an orbit.
    pub(super) fn choose(args: &SweepArgs, scene: &Scene, is_cpu: bool) -> Result<Self> {
        let mut notes = Vec::new();
        let asked = args.size.asked();
        let (all, photos) = match &args.path.cameras {
            Some(path) => {
                let set = model::load_cameras(path, args.path.split.as_deref(), asked)?;
                let of = dataset::load(path, &DatasetOptions::default()).ok();
                (set.cameras, of)
            }
            None => (orbit(args, scene), None),
        };
        let chosen: Vec<usize> = spread(all.len(), VIEWS);
        if chosen.len() < all.len() {
            notes.push(format!("{} of {} views, evenly spread", chosen.len(), all.len()));
        }
        let full: Vec<Camera> = chosen.iter().map(|i| all[*i].clone()).collect();
        let Some(first) = full.first() else {
            return Err(Error::usage("bench sweep", "no camera", "at least one"));
        };
        let size = [first.width, first.height];
        let side = error_side(size, full.len(), scene.gaussians.len(), asked != [None, None]);
        let scale = (f64::from(side) / f64::from(size[0].max(size[1]))).min(1.0);
        let small = |c: &Camera| {
            let to = |s: u32| ((f64::from(s) * scale).round() as u32).max(1);
            c.resized(to(c.width), to(c.height))
        };
        let cameras: Vec<(Camera, f64)> = full.iter().map(|c| (small(c), args.path.time.unwrap_or(c.time))).collect();
        let reduced = [cameras[0].0.width, cameras[0].0.height];
        if reduced != size {
            let [w, h] = reduced;
            notes.push(format!(
                "errors at {w}×{h} instead of {}×{} pixels: the f64 reference is slow",
                size[0], size[1]
            ));
        }
        // A software device would need an hour for frames that a GPU draws in seconds.
        let timed_size = if is_cpu { reduced } else { size };
        if is_cpu && reduced != size {
            notes.push("times at that size too: the device is a CPU".into());
        }
        let photos = photos_of(photos.as_ref(), &cameras, args.look.background)?;
        if photos.is_none() {
            notes.push("no photos beside the cameras: no error against ground truth".into());
        }
        Ok(Self { cameras, timed_size, photos, notes })
    }

    /// Camera of frame `i` at the size that is timed.
    pub(super) fn timed(&self, i: usize) -> (Camera, f64) {
        let (camera, time) = &self.cameras[i % self.cameras.len()];
        let scale = f64::from(self.timed_size[0]) / f64::from(self.cameras[0].0.width);
        let to = |s: u32| ((f64::from(s) * scale).round() as u32).max(1);
        let same = (scale - 1.0).abs() < 1e-9;
        (if same { camera.clone() } else { camera.resized(to(camera.width), to(camera.height)) }, *time)
    }
}

/// Longest side at which the reference images come to an end; what the user asks for is not reduced by much.
fn error_side(size: [u32; 2], views: usize, gaussians: usize, asked: bool) -> u32 {
    let longest = f64::from(size[0].max(size[1]));
    let limit = if asked { longest } else { longest.min(f64::from(ERROR_SIDE)) };
    let pixels = f64::from(size[0]) * f64::from(size[1]) * (limit / longest).powi(2);
    let work = pixels * views as f64 * gaussians as f64;
    let shrink = (REFERENCE_WORK / work).sqrt().min(1.0);
    (limit * shrink).max(SMALLEST_SIDE.min(limit)).round() as u32
}

/// At most `most` of `count` indices, evenly spread.
fn spread(count: usize, most: usize) -> Vec<usize> {
    let n = count.min(most);
    (0..n).map(|i| (2 * i + 1) * count / (2 * n)).collect()
}

/// Views from all sides at the size of the arguments.
fn orbit(args: &SweepArgs, scene: &Scene) -> Vec<Camera> {
    camera::orbit(scene, args.size.or_square(DEFAULT_SIZE), VIEWS)
}

/// Photos of the cameras (same pose and time), over the background, averaged down to the cameras' size; none unless all are there.
fn photos_of(data: Option<&Dataset>, cameras: &[(Camera, f64)], background: [f32; 3]) -> Result<Option<Vec<Image>>> {
    let Some(data) = data else { return Ok(None) };
    let mut photos = Vec::new();
    for (camera, _) in cameras {
        let all = data.test.iter().chain(&data.train).chain(&data.val);
        let same = |v: &&View| {
            let c = &v.camera;
            c.position.abs_diff_eq(camera.position, 1e-6)
                && c.rotation.abs_diff_eq(camera.rotation, 1e-6)
                && (v.time - camera.time).abs() < 1e-6
        };
        let Some(view) = all.clone().find(same) else { return Ok(None) };
        let mut source = view.image.clone();
        source.size = [camera.width, camera.height];
        let pixels = source.decode()?;
        let over = |p: &u32| {
            let [r, g, b, a] = p.to_le_bytes().map(|c| f32::from(c) / 255.0);
            let rest = 1.0 - a;
            [r + rest * background[0], g + rest * background[1], b + rest * background[2], 1.0]
        };
        let rgba = pixels.rgba.iter().flat_map(over).collect();
        photos.push(Image { width: pixels.width, height: pixels.height, rgba, depth: Vec::new() });
    }
    Ok(Some(photos))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_are_spread_and_sizes_fit_the_reference() {
        assert_eq!(spread(20, 3), [3, 10, 16]);
        assert_eq!(spread(2, 3), [0, 1]);
        assert!(spread(0, 3).is_empty());
        assert_eq!(error_side([800, 800], 3, 100_000, false), 256);
        assert_eq!(error_side([200, 100], 3, 100_000, false), 200);
        assert!(error_side([800, 800], 3, 1_000_000, false) < 110);
        assert_eq!(error_side([64, 48], 3, 10, true), 64);
    }
}
