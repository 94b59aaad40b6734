//! Which pictures `spgs render` makes: a camera and a time for each, and the sub-frames of a shutter.

use engine::data::CameraSet;
use engine::error::{Error, Result};
use engine::scene::path::mean_up;
use engine::scene::{Camera, CameraPath, Scene};
use glam::DVec3;

use crate::cli::args::{PathArg, RenderArgs};
use crate::cli::{camera, model};

/// Frames of a path without `--frames` and `--seconds`: this many seconds.
const DEFAULT_SECONDS: f64 = 4.0;
/// Most frames of a path.
const MAX_FRAMES: f64 = 1.0e6;
/// Size of the pictures when neither cameras nor arguments give one.
const DEFAULT_SIZE: [u32; 2] = [800, 600];

/// A picture to be made.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Picture {
    /// Number in the file name.
    pub(super) index: usize,
    /// Name of the frame in the camera file.
    pub(super) name: String,
    /// What is averaged: one view, or those of the sub-frames.
    pub(super) views: Vec<(Camera, f64)>,
}

/// The pictures of `--cameras`, one for each view that was asked for.
pub(super) fn of_views(args: &RenderArgs, set: &CameraSet) -> Result<Vec<Picture>> {
    let all: Vec<usize> = (0..set.cameras.len()).collect();
    let wanted = if args.frames.is_empty() { &all } else { &args.frames };
    let picture = |&index: &usize| {
        let camera = model::camera(set, index)?;
        let time = args.time.unwrap_or(camera.time);
        Ok(Picture { index, name: camera.name.clone(), views: vec![(camera.clone(), time)] })
    };
    wanted.iter().map(picture).collect()
}

/// The pictures along `--path`.
pub(super) fn of_path(
    args: &RenderArgs,
    kind: &PathArg,
    set: Option<&CameraSet>,
    scene: &Scene,
) -> Result<Vec<Picture>> {
    let route = Route::new(args, kind, set, scene)?;
    let count = frame_count(args)?;
    (0..count)
        .map(|index| {
            let views = route.views(index, count, args.motion_blur, args.shutter)?;
            Ok(Picture { index, name: format!("{index:05}"), views })
        })
        .collect()
}

fn frame_count(args: &RenderArgs) -> Result<usize> {
    let frames = match args.count {
        Some(count) => f64::from(count),
        None => (args.seconds.unwrap_or(DEFAULT_SECONDS) * args.fps).round(),
    };
    if !(1.0..=MAX_FRAMES).contains(&frames) {
        let found = format!("{frames} frames");
        return Err(Error::usage("--seconds times --fps", found, format!("1 to {MAX_FRAMES} frames")));
    }
    Ok(frames as usize)
}

/// A path with the times along it.
struct Route {
    path: CameraPath,
    /// Start and end; `None`: the views' own.
    times: Option<[f64; 2]>,
}

impl Route {
    fn new(args: &RenderArgs, kind: &PathArg, set: Option<&CameraSet>, scene: &Scene) -> Result<Self> {
        let swept = args.time.map(|t| [t, t]).or(args.times);
        let range = swept.or(Some(scene.time_range()));
        let start = || start(args, set, scene);
        Ok(match kind {
            PathArg::Time => Self { path: CameraPath::Still(start()?), times: range },
            PathArg::Turntable => {
                let (centre, _) = camera::whole(scene);
                let up = args.up.map(DVec3::from).or_else(|| mean_up(&set?.cameras)).unwrap_or(DVec3::NEG_Y);
                Self { path: CameraPath::Turntable { first: start()?, centre, up }, times: range }
            }
            PathArg::Cameras | PathArg::File(_) => {
                let Some(set) = set else {
                    return Err(Error::usage("--path cameras", "no --cameras", "--cameras FILE|DATA"));
                };
                Self { path: CameraPath::Through(set.cameras.clone()), times: swept }
            }
        })
    }

    /// Where share `s` of the way leads; a turntable goes on beyond its end.
    fn at(&self, s: f64) -> Result<(Camera, f64)> {
        let along = if matches!(self.path, CameraPath::Turntable { .. }) { s.rem_euclid(1.0) } else { s };
        let camera = self.path.at(along).ok_or_else(|| Error::usage("--path", "no views", "at least one"))?;
        let time = self.times.map_or(camera.time, |[a, b]| a + (b - a) * s.clamp(0.0, 1.0));
        Ok((camera, time))
    }

    /// The sub-frames of frame `index` of `count`: spread evenly over `shutter` frame lengths about its moment.
    fn views(&self, index: usize, count: usize, sub_frames: u32, shutter: f64) -> Result<Vec<(Camera, f64)>> {
        // A turntable's last frame is one step before its first.
        let steps = if matches!(self.path, CameraPath::Turntable { .. }) { count } else { count.max(2) - 1 } as f64;
        let moment = |k: u32| {
            let offset = (f64::from(k) + 0.5) / f64::from(sub_frames) - 0.5;
            (index as f64 + shutter * offset) / steps
        };
        (0..sub_frames).map(|k| self.at(moment(k))).collect()
    }
}

/// The view that a turntable or time sweep starts from: `--frame` of the cameras, or one of the whole scene.
fn start(args: &RenderArgs, set: Option<&CameraSet>, scene: &Scene) -> Result<Camera> {
    match (set, args.frames.as_slice()) {
        (Some(set), []) => model::camera(set, 0).cloned(),
        (Some(set), [index]) => model::camera(set, *index).cloned(),
        (Some(_), many) => Err(Error::usage("--frame with --path", format!("{} frames", many.len()), "one")),
        (None, []) => {
            let size = match args.size.asked() {
                [Some(width), Some(height)] => [width, height],
                [Some(width), None] => [width, (width * 3).div_ceil(4)],
                [None, Some(height)] => [(height * 4).div_ceil(3).min(engine::data::MAX_IMAGE_SIDE), height],
                [None, None] => DEFAULT_SIZE,
            };
            Ok(camera::overview(scene, size))
        }
        (None, _) => Err(Error::usage("--frame", "no --cameras", "--cameras FILE|DATA")),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    fn route(path: CameraPath) -> Route {
        Route { path, times: Some([2.0, 4.0]) }
    }

    fn camera() -> Camera {
        Camera::look_at(DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, DVec3::NEG_Y, 0.8, [32, 24])
    }

    #[test]
    fn a_time_sweep_reaches_both_ends_and_a_turntable_does_not_repeat_its_start() {
        let still = route(CameraPath::Still(camera()));
        let times: Vec<f64> = (0..5).map(|i| still.views(i, 5, 1, 0.5).unwrap()[0].1).collect();
        assert_eq!(times, [2.0, 2.5, 3.0, 3.5, 4.0]);
        assert_eq!(still.views(0, 1, 1, 0.5).unwrap()[0].1, 2.0);
        let turn = route(CameraPath::Turntable { first: camera(), centre: DVec3::ZERO, up: DVec3::Y });
        let places: Vec<DVec3> = (0..4).map(|i| turn.views(i, 4, 1, 0.5).unwrap()[0].0.position).collect();
        for (i, p) in places.iter().enumerate() {
            assert!(places[..i].iter().all(|q| p.distance(*q) > 1.0), "{places:?}");
        }
    }

    #[test]
    fn sub_frames_lie_within_the_shutter_about_the_frames_moment() {
        let still = route(CameraPath::Still(camera()));
        let times: Vec<f64> = still.views(2, 5, 4, 0.5).unwrap().iter().map(|v| v.1).collect();
        assert_eq!(times.len(), 4);
        let mean = times.iter().sum::<f64>() / 4.0;
        assert!((mean - 3.0).abs() < 1e-12);
        // Frames are 0.5 apart in time: half of that, less a quarter of it at the ends.
        assert!((times[3] - times[0] - 0.25 * 0.75).abs() < 1e-12, "{times:?}");
        // At the ends of the path time is held.
        assert!(still.views(0, 5, 4, 1.0).unwrap().iter().all(|v| v.1 >= 2.0));
    }
}
