//! Objects that the static warm-up loses: what goes far beyond its size in the course of the photos stands nowhere long enough
//! to be built up, and a network that moves Gaussians has none of its to move.
//!
//! Cut-out photos show where something is missing: opaque pixels that the model leaves empty. When motion begins, the largest disc
//! of them in each photo is a line of sight; where most of these lie on one smooth path (`track`), there is an object. It
//! gets points where the photos, moved along the path, are all opaque (`seed`), and their superpoints follow the path (`path`);
//! network F learns what is left, as of all others.
//!
//! What is lost in front of something opaque leaves nothing empty. It is looked for again, in what differs, when network F has
//! done its work (`residual`).

pub mod add_path;
mod colours;
pub(crate) mod disc;
pub(super) mod path;
pub(crate) mod residual;
pub(crate) mod seed;
mod track;

use std::sync::Arc;

use glam::{DVec2, DVec3};

use self::disc::Disc;
use self::path::Path;
use self::seed::{Carving, Shown};
use self::track::{Candidate, Rule, Sight, Track};
use super::init::{Point, from_points};
use super::parameters::{ParameterState, Parameters, with_sh_degree};
use super::trainer::Trainer;
use crate::data::dataset::View;
use crate::data::pixels::Pixels;
use crate::error::{Error, Result};
use crate::gpu::kernel::Kernel;
use crate::image::Image;
use crate::render::{RenderOptions, Renderer};
use crate::scene::{Camera, Gaussians, Scene};

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[&add_path::ADD_PATH.kernel];

/// Photos that are looked at; of more, so many at equal distances.
const MOST_PHOTOS: usize = 200;
/// The smallest size of the photos that has this many pixels on its shorter side is looked at.
const SIDE: u32 = 96;
/// Smallest radius of an object, as a share of the photo's shorter side.
const SMALLEST: f64 = 0.02;
/// A pixel is opaque from this alpha on, and empty below that one.
const OPAQUE: f32 = 0.9;
const EMPTY: f32 = 0.5;
/// The object moves by this many of its radii, or the warm-up does not lose it.
const MOVES: f64 = 2.0;
/// When a path counts.
const RULE: Rule = Rule { near: 0.5, share: 0.6, of_all: 0.4 };
/// A point is the object's if so many of the photos are opaque there; its superpoints are within as many of its radii.
const CARVING: Carving = Carving { reach: 1.6, share: 0.9 };
/// Opacity of its first Gaussians: it is known to be there.
const OPACITY: f32 = 0.5;
/// Fewest Gaussians of an object, and most of them as a share of all.
pub(crate) const FEWEST: usize = 100;
const LARGEST_SHARE: f64 = 0.2;

/// By so large shares of all times a path is moved to see what fits it by chance: one that comes round again fits again at few of them.
const OTHER_TIMES: [f64; 5] = [0.309, 0.382, 0.5, 0.618, 0.691];

/// An object that was found.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct LostObject {
    /// Photos that show it.
    pub seen: usize,
    /// Photos that were looked at.
    pub photos: usize,
    /// Its radius, world units.
    pub radius: f64,
    /// The longest side of the box around its path, world units.
    pub path: f64,
    /// Gaussians that it starts with.
    pub gaussians: usize,
    /// The superpoint that it is fixed to, where it is found by that and not by a path of its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub attached_to: Option<usize>,
}

impl std::fmt::Display for LostObject {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { seen, photos, radius, path, gaussians, attached_to } = self;
        write!(
            f,
            "lost object: in {seen} of {photos} photos, radius {radius:.3}, path {path:.3}, {gaussians} Gaussians"
        )?;
        attached_to.map_or(Ok(()), |part| write!(f, ", fixed to superpoint {part}"))
    }
}

/// A photo that is looked at, and what is missing in it.
struct Look {
    camera: Camera,
    photo: Arc<Pixels>,
    time: usize,
    discs: Vec<Disc>,
    opaque: usize,
}

impl Trainer {
    /// Looks for an object that the model has lost, and adds it to the Gaussians; returns its path. `None` too where there was no
    /// room to look, or for it.
    pub(super) fn find_lost_object(&mut self) -> Result<Option<(LostObject, Path)>> {
        let before = self.parameters.count();
        match self.find_and_add() {
            Err(Error::OutOfMemory { .. } | Error::Limit { .. }) if self.parameters.count() == before => Ok(None),
            other => other,
        }
    }

    fn find_and_add(&mut self) -> Result<Option<(LostObject, Path)>> {
        let times = distinct_times(self.looked_at().map(|place| &self.pyramid.views[place]));
        let looks = self.looks(&times)?;
        let sights: Vec<Sight> = looks.iter().map(Look::sight).collect();
        let found = track::track(&sights, times.len(), RULE).map(|track| (extent(&track.places), track));
        let Some((path, track)) = found.filter(|(path, track)| *path >= MOVES * track.radius) else { return Ok(None) };
        let state = self.parameters.download(&self.gpu)?;
        let reference = loneliest(&track, &looks, &state.gaussians);
        let room = self.config.budget.max_gaussians.saturating_sub(self.parameters.count()) as usize;
        let most = most_gaussians(&track, &looks, state.gaussians.len()).min(room);
        let images: Vec<Shown> = track.seen.iter().map(|(i, _)| looks[*i].shown()).collect();
        let found = seed::carve(&track, &images, reference, &CARVING, most, self.config.seed);
        if found.len() < FEWEST {
            return Ok(None);
        }
        let color = seed::mean_colour(&track, &images);
        let points: Vec<Point> = found.iter().map(|at| Point { position: at.as_vec3().to_array(), color }).collect();
        self.add_points(state, &points)?;
        let centre = track.places[reference];
        let (seen, photos, gaussians) = (track.seen.len(), looks.len(), points.len());
        let offsets = track.places.iter().map(|place| (*place - centre).as_vec3().to_array()).collect();
        let object = LostObject { seen, photos, radius: track.radius, path, gaussians, attached_to: None };
        Ok(Some((object, Path { centre, reach: CARVING.reach * track.radius, times, offsets })))
    }

    fn add_points(&mut self, mut state: ParameterState, points: &[Point]) -> Result<()> {
        let mut added = from_points(points, 0);
        added.opacity_logit.fill((OPACITY / (1.0 - OPACITY)).ln());
        append(&mut state, added);
        // Recorded commands hold the old buffers.
        self.targets.clear();
        self.parameters = Parameters::upload(&self.gpu, &state)?;
        self.allocate_gradients()
    }

    /// Places of the photos that are looked at.
    fn looked_at(&self) -> impl Iterator<Item = usize> + use<> {
        let first = self.pyramid.smallest(SIDE);
        let photos = first.len();
        first.step_by(photos.div_ceil(MOST_PHOTOS).max(1))
    }

    fn looks(&self, times: &[f32]) -> Result<Vec<Look>> {
        let mut gaussians = self.parameters.download_gaussians(&self.gpu)?;
        gaussians = with_sh_degree(&gaussians, self.parameters.scene.sh_degree.min(gaussians.sh_degree));
        let scene = Scene { gaussians, ..Scene::default() };
        let options = RenderOptions { near: self.config.near, ..RenderOptions::default() };
        let mut renderer = Renderer::new(&self.gpu, &scene, &options)?;
        let places: Vec<usize> = self.looked_at().collect();
        self.loader.prefetch(&places);
        let mut looks = Vec::with_capacity(places.len());
        for place in places {
            let view = &self.pyramid.views[place];
            let photo = self.loader.get(place)?;
            let rendered = renderer.render(&view.camera, view.time)?;
            let (missing, opaque) = missing(&rendered, &photo);
            let size = [view.camera.width, view.camera.height];
            let discs = disc::largest(&missing, size, SMALLEST * f64::from(size[0].min(size[1])));
            let time = times.partition_point(|t| *t < view.time as f32);
            looks.push(Look { camera: view.camera.clone(), photo, time, discs, opaque });
        }
        Ok(looks)
    }
}

impl Look {
    fn sight(&self) -> Sight {
        let c = &self.camera;
        let candidate = |disc: &Disc| {
            let DVec2 { x, y } = disc.centre;
            let ahead = DVec3::new((x - c.cx) / c.fx, (y - c.cy) / c.fy, 1.0);
            Candidate { direction: c.rotation.transpose() * ahead, radius: disc.radius / c.fx }
        };
        Sight { time: self.time, origin: c.position, candidates: self.discs.iter().map(candidate).collect() }
    }

    fn shown(&self) -> Shown {
        let mask = self.photo.rgba.iter().map(|p| alpha(*p) >= EMPTY).collect();
        Shown { camera: self.camera.clone(), photo: self.photo.clone(), mask, time: self.time }
    }
}

fn alpha(rgba: u32) -> f32 {
    f32::from(rgba.to_le_bytes()[3]) / 255.0
}

/// `[H,W]` pixels of the photo that are opaque and that the model leaves empty, and how many are opaque; none of a photo
/// that is not cut out.
fn missing(rendered: &Image, photo: &Pixels) -> (Vec<bool>, usize) {
    let opaque = photo.rgba.iter().filter(|p| alpha(**p) >= OPAQUE).count();
    let is_cut_out = photo.rgba.iter().any(|p| alpha(*p) < EMPTY);
    let ours = rendered.rgba.as_chunks::<4>().0;
    let missing = photo.rgba.iter().zip(ours).map(|(p, [.., ours])| is_cut_out && alpha(*p) >= OPAQUE && *ours < EMPTY);
    (missing.collect(), opaque)
}

/// Ascending.
fn distinct_times<'a>(views: impl Iterator<Item = &'a View>) -> Vec<f32> {
    let mut times: Vec<f32> = views.map(|v| v.time as f32).collect();
    times.sort_by(f32::total_cmp);
    times.dedup();
    times
}

/// The median of a share of what fits a path of so many times, as it is so many times later.
pub(crate) fn by_chance(times: usize, share: impl Fn(usize) -> f64) -> f64 {
    let mut shares = OTHER_TIMES.map(|of_all| share((of_all * times as f64).round() as usize));
    shares.sort_by(f64::total_cmp);
    shares[OTHER_TIMES.len() / 2]
}

/// Longest side of the box around places.
pub(crate) fn extent(places: &[DVec3]) -> f64 {
    let low = places.iter().copied().reduce(DVec3::min).unwrap_or_default();
    let high = places.iter().copied().reduce(DVec3::max).unwrap_or_default();
    (high - low).max_element()
}

/// The time, of those that a photo shows, at which the object is farthest from the Gaussians there are: its superpoints are its
/// own there.
fn loneliest(track: &Track, looks: &[Look], gaussians: &Gaussians) -> usize {
    let distance = |time: usize| {
        let to = |mean: &[f32; 3]| (DVec3::from_array(mean.map(f64::from)) - track.places[time]).length_squared();
        gaussians.mean.iter().map(to).fold(f64::INFINITY, f64::min)
    };
    let times = track.seen.iter().map(|(i, _)| looks[*i].time);
    times.map(|time| (time, distance(time))).max_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(time, _)| time)
}

/// As many of all as it has of the opaque pixels.
fn most_gaussians(track: &Track, looks: &[Look], all: usize) -> usize {
    let of = |&(i, k): &(usize, usize)| std::f64::consts::PI * looks[i].discs[k].radius.powi(2);
    let opaque: usize = track.seen.iter().map(|(i, _)| looks[*i].opaque).sum();
    let share = track.seen.iter().map(of).sum::<f64>() / opaque.max(1) as f64;
    ((share.min(LARGEST_SHARE) * all as f64) as usize).max(FEWEST)
}

/// Adds Gaussians without a history.
fn append(state: &mut ParameterState, added: Gaussians) {
    let (n, k) = (state.gaussians.len(), added.len());
    let mut added = added;
    added.optional.add(state.gaussians.optional.present(), k);
    state.gaussians.append(&added, 0..k);
    let longer = |planes: &[f32]| -> Vec<f32> {
        let rows = planes.chunks_exact(n.max(1));
        rows.flat_map(|row| row.iter().copied().chain(std::iter::repeat_n(0.0, k))).collect()
    };
    state.moment_1 = longer(&state.moment_1);
    state.moment_2 = longer(&state.moment_2);
    state.density = longer(&state.density);
    state.max_radius = longer(&state.max_radius);
    state.superpoint_of_gaussian.resize(n + k, 0);
}
