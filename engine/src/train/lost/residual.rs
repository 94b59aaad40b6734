//! The same late in a run, when all else is in place: what photos show and the model does not is an object there, also in front of
//! what is opaque.
//!
//! Pixels that differ fall into classes by colour ([`Colours`]); the discs of each class are followed by themselves, because several
//! objects, and what is merely blurred, would be taken for each other. What most photos show is taken out of them, and the rest
//! looked at again. What is found becomes a rigid part: key poses from its path, points where the photos, moved along, differ.

use std::sync::Arc;

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::colours::Colours;
use super::seed::{Carving, Shown, carve, colour_of, mean_colour};
use super::track::{Rule, Sight, Track, track};
use super::{
    FEWEST, LARGEST_SHARE, Look, LostObject, MOST_PHOTOS, MOVES, OPACITY, OPAQUE, SIDE, SMALLEST, by_chance, disc,
    distinct_times, extent,
};
use crate::data::dataset::View;
use crate::data::loader::ImageLoader;
use crate::data::pixels::{LEFT_OUT, Pixels};
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::image::Image;
use crate::render::{RenderOptions, Renderer};
use crate::scene::{Camera, Deformation, Gaussians, Motion, Scene, SuperpointDeformation, Superpoints};
use crate::train::bake::fewest_keys;
use crate::train::config::Config;
use crate::train::init::{Point, from_points};
use crate::train::parameters::with_sh_degree;

/// A pixel differs if a channel does by more than this.
const DIFFERS: f32 = 0.25;
/// Into so many classes of colour pixels fall; each number is tried. With one they are all alike: objects of many colours.
const CLASSES: [usize; 4] = [1, 2, 3, 6];
/// When a path counts at once: most photos show a disc on it.
const BY_DISCS: Rule = Rule { near: 0.75, share: 0.8, of_all: 0.4 };
/// Of an object of several colours not all photos show each. Such a path counts if so many of all photos differ on it, of whatever colour,
/// and so many times as many as with the places of another time.
const BY_ALL: Rule = Rule { near: 0.75, share: 0.65, of_all: 0.0 };
const DIFFER: f64 = 0.8;
const TIMES_CHANCE: f64 = 2.0;
/// When a path is worth looking at, and how many are.
const LIKELY: Rule = Rule { near: 0.75, share: 0.5, of_all: 0.2 };
const MOST_LIKELY: usize = 6;
/// Gaps of so many pixels to each side are a likely object's own, where it has the colour of what the model shows there.
const CLOSED: f32 = 1.5;
/// Most objects.
const MOST: usize = 8;
/// Pixels of one colour are a part of the object: it may be larger. Points differ in most of the photos.
const CARVING: Carving = Carving { reach: 2.0, share: 0.8 };
/// Radii by which key poses may be off the path.
const OFF_PATH: f64 = 0.25;

/// A photo, and where the model's image is another one.
pub(crate) struct Difference {
    pub(crate) camera: Camera,
    pub(crate) photo: Arc<Pixels>,
    /// Index of its time.
    pub(crate) time: usize,
    /// `[H,W]` largest difference of a channel.
    pub(crate) amount: Vec<f32>,
    /// `[H,W]` camera-space depth beyond which the model hides what there is; infinite where it is less than [`OPAQUE`].
    pub(crate) hides: Vec<f32>,
    mask: Arc<[bool]>,
    /// `[H,W]` of that, what no object that was found explains.
    pub(crate) left: Vec<bool>,
    /// `[H,W,3]` over the background.
    rgb: Vec<[f32; 3]>,
}

/// A path, and the photos with the discs that it was found from.
struct Followed {
    track: Track,
    looks: Vec<Look>,
}

/// What photos show and the images of a scene of rigid parts do not.
pub(crate) struct Residual {
    /// Times of the photos, ascending.
    pub(crate) times: Vec<f32>,
    pub(crate) differences: Vec<Difference>,
}

impl Residual {
    /// `None` for a scene of other motion, and where there is no room to look.
    pub(crate) fn new(gpu: &Gpu, scene: &Scene, photos: &[View], config: &Config) -> Result<Option<Self>> {
        let parts = scene.deformation.superpoint_deformation();
        if !parts.is_some_and(|p| p.blend.is_none() && p.network.is_none() && p.table.is_some()) {
            return Ok(None);
        }
        match differences(gpu, scene, photos, config) {
            Err(Error::OutOfMemory { .. } | Error::Limit { .. }) => Ok(None),
            other => other.map(|(times, differences)| Some(Self { times, differences })),
        }
    }

    /// Objects that follow paths of their own, each as a scene of one more part; they are taken out of what is left.
    pub(crate) fn take_objects(&mut self, scene: &Scene, config: &Config) -> Vec<(LostObject, Scene)> {
        let mut objects: Vec<(LostObject, Scene)> = Vec::new();
        for _ in 0..MOST {
            let Some(found) = follow(&self.differences, self.times.len()) else { break };
            self.differences.iter_mut().for_each(|d| d.take_out(&found.track));
            let count = scene.gaussians.len() + objects.iter().map(|(object, _)| object.gaussians).sum::<usize>();
            objects.extend(part(&found, &self.differences, &self.times, (&scene.gaussians, count), config));
        }
        objects
    }

    /// Paths of what may be an object in the photos of some times, what most of them show first. None is sure: that is left to who asks.
    pub(crate) fn likely_paths(&self, takes_part: impl Fn(usize) -> bool) -> Vec<Vec<DVec3>> {
        let some: Vec<&Difference> = self.differences.iter().filter(|d| takes_part(d.time)).collect();
        let path = |colours: &Colours, class: usize| {
            let sights: Vec<Sight> = some.iter().map(|d| d.look(colours, class, CLOSED).sight()).collect();
            let track = track(&sights, self.times.len(), LIKELY)?;
            (extent(&track.places) >= MOVES * track.radius).then_some(track)
        };
        let mut found = of_classes(&some, path);
        found.sort_by_key(|track| std::cmp::Reverse(track.seen.len()));
        found.into_iter().take(MOST_LIKELY).map(|track| track.places).collect()
    }
}

/// Times of the photos, ascending, and what differs in each; of many photos some, of large ones reduced.
fn differences(gpu: &Gpu, scene: &Scene, photos: &[View], config: &Config) -> Result<(Vec<f32>, Vec<Difference>)> {
    let shorter = photos.iter().map(|v| v.camera.width.min(v.camera.height)).min().unwrap_or(0);
    let halvings = (0..u32::BITS).take_while(|k| shorter >> k >= SIDE).last().unwrap_or(0);
    let step = photos.len().div_ceil(MOST_PHOTOS).max(1);
    let views: Arc<[View]> = photos.iter().step_by(step).map(|v| v.reduced(1 << halvings)).collect();
    let times = distinct_times(views.iter());
    let (near, background) = (config.near, config.background);
    let options = RenderOptions { near, background, depth: true, ..RenderOptions::default() };
    let mut renderer = Renderer::new(gpu, scene, &options)?;
    let loader = ImageLoader::for_training(views.clone(), config.budget.image_bytes, 1)?;
    let mut found = Vec::with_capacity(views.len());
    for (place, view) in views.iter().enumerate() {
        loader.prefetch(&[place, place + 1]);
        let photo = loader.get(place)?;
        let rendered = renderer.render(&view.camera, view.time)?;
        let time = times.partition_point(|t| *t < view.time as f32);
        found.push(Difference::new(view.camera.clone(), photo, &rendered, time, config.background));
    }
    Ok((times, found))
}

impl Difference {
    /// `rendered` is over the background.
    pub(crate) fn new(camera: Camera, photo: Arc<Pixels>, rendered: &Image, time: usize, background: [f32; 3]) -> Self {
        let [ours, theirs] = [rendered, &photo.over(background)].map(|image| image.rgba.as_chunks::<4>().0.to_vec());
        let difference = |(a, b): (&[f32; 4], &[f32; 4])| (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, f32::max);
        let takes_part = photo.rgba.iter().map(|p| *p != LEFT_OUT);
        let pairs = ours.iter().zip(&theirs).zip(takes_part);
        let amount: Vec<f32> =
            pairs.map(|(pair, takes_part)| if takes_part { difference(pair) } else { 0.0 }).collect();
        let left: Vec<bool> = amount.iter().map(|a| *a > DIFFERS).collect();
        let rgb = theirs.iter().map(|[r, g, b, _]| [*r, *g, *b]).collect();
        let hides =
            |(pixel, depth): (&[f32; 4], &f32)| if pixel[3] >= OPAQUE { depth / pixel[3] } else { f32::INFINITY };
        let hides = ours.iter().zip(&rendered.depth).map(hides).collect();
        Self { camera, hides, mask: left.as_slice().into(), amount, left, rgb, photo, time }
    }

    /// Colours of what is left.
    fn colours(&self) -> impl Iterator<Item = [f32; 3]> + '_ {
        self.rgb.iter().zip(&self.left).filter_map(|(rgb, left)| left.then_some(*rgb))
    }

    /// The discs of what is left and of a class, and of gaps in it of up to so many pixels to each side.
    fn look(&self, colours: &Colours, class: usize, gaps: f32) -> Look {
        let size = [self.camera.width, self.camera.height];
        let is_it = |(left, rgb): (&bool, &[f32; 3])| *left && colours.of(*rgb) == class;
        let mask: Vec<bool> = self.left.iter().zip(&self.rgb).map(is_it).collect();
        let mask = if gaps > 0.0 { disc::closed(&mask, size, gaps) } else { mask };
        let discs = disc::largest(&mask, size, SMALLEST * f64::from(size[0].min(size[1])));
        let (camera, photo) = (self.camera.clone(), self.photo.clone());
        Look { camera, photo, time: self.time, discs, opaque: 0 }
    }

    /// Leaves no more what is within reach of an object.
    fn take_out(&mut self, track: &Track) {
        let centre = track.places[self.time];
        let Some(at) = self.camera.project(centre) else { return };
        let depth = (self.camera.rotation * (centre - self.camera.position)).z;
        let reach = CARVING.reach * track.radius / depth * self.camera.fx;
        let width = self.camera.width as usize;
        for (i, left) in self.left.iter_mut().enumerate() {
            let pixel = DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
            *left &= (pixel - at).length() > reach;
        }
    }

    fn shown(&self) -> Shown {
        let (camera, photo) = (self.camera.clone(), self.photo.clone());
        Shown { camera, photo, mask: self.mask.clone(), time: self.time }
    }
}

/// What is found of each class of what is left, in their order.
fn of_classes<T: Send>(differences: &[&Difference], find: impl Fn(&Colours, usize) -> Option<T> + Sync) -> Vec<T> {
    let pixels: Vec<[f32; 3]> = differences.iter().flat_map(|d| d.colours()).collect();
    let divisions = CLASSES.map(|count| Colours::new(&pixels, count));
    let classes = divisions.iter().zip(CLASSES);
    let classes: Vec<(&Colours, usize)> = classes.flat_map(|(c, count)| (0..count).map(move |k| (c, k))).collect();
    classes.into_par_iter().filter_map(|(colours, class)| find(colours, class)).collect()
}

/// What moves and is of one class of what is left: of all that do, what most photos show.
fn follow(differences: &[Difference], times: usize) -> Option<Followed> {
    let images: Vec<Shown> = differences.iter().map(Difference::shown).collect();
    let path = |colours: &Colours, class: usize| {
        let looks: Vec<Look> = differences.iter().map(|d| d.look(colours, class, 0.0)).collect();
        let sights: Vec<Sight> = looks.iter().map(Look::sight).collect();
        let track = track(&sights, times, BY_ALL)?;
        let shown = looks.iter().filter(|look| !look.discs.is_empty()).count();
        let counts = BY_DISCS.holds(track.seen.len(), shown, looks.len()) || differ_on(&track.places, &images);
        (counts && extent(&track.places) >= MOVES * track.radius).then_some(Followed { track, looks })
    };
    let found = of_classes(&differences.iter().collect::<Vec<_>>(), path);
    found.into_iter().rev().max_by_key(|f| f.track.seen.len())
}

/// Whether photos differ on a path, whatever their colours there, and because it is there then.
fn differ_on(places: &[DVec3], images: &[Shown]) -> bool {
    let times = places.len();
    let share = |later: usize| {
        let differs = |image: &Shown| image.has(image.camera.project(places[(image.time + later) % times])?);
        let seen: Vec<bool> = images.iter().filter_map(differs).collect();
        seen.iter().filter(|d| **d).count() as f64 / seen.len().max(1) as f64
    };
    share(0) >= DIFFER.max(TIMES_CHANCE * by_chance(times, share))
}

/// The object as a scene of one part, beside so many Gaussians like `others`; `None` where too few points are its own.
fn part(
    Followed { track, looks }: &Followed,
    differences: &[Difference],
    times: &[f32],
    (others, count): (&Gaussians, usize),
    config: &Config,
) -> Option<(LostObject, Scene)> {
    let radius = |(i, disc): &(usize, usize)| looks[*i].discs[*disc].radius;
    let largest = track.seen.iter().max_by(|a, b| radius(a).total_cmp(&radius(b)))?;
    let reference = looks[largest.0].time;
    let images: Vec<Shown> = track.seen.iter().map(|(i, _)| differences[*i].shown()).collect();
    let room = config.budget.max_gaussians.saturating_sub(count as u32) as usize;
    // As many as the pixels of its largest disc: no fewer show its edge.
    let pixels = std::f64::consts::PI * radius(largest).powi(2);
    let most = (pixels.min(LARGEST_SHARE * count as f64) as usize).max(FEWEST).min(room);
    let found = carve(track, &images, reference, &CARVING, most, config.seed);
    if found.len() < FEWEST {
        return None;
    }
    let mean = mean_colour(track, &images);
    let point = |at: &DVec3| {
        let color = colour_of(*at, track, &images, reference).unwrap_or(mean);
        Point { position: at.as_vec3().to_array(), color }
    };
    let points: Vec<Point> = found.iter().map(point).collect();
    let gaussians = like(&points, others);
    let centre = track.places[reference];
    let superpoints = Superpoints { position: vec![centre.as_vec3().to_array()], of_gaussian: vec![0; points.len()] };
    let keys = key_places(&track.places, times, OFF_PATH * track.radius);
    let table = Motion {
        times: keys.iter().map(|&k| times[k]).collect(),
        rotation: vec![[0.0; 3]; keys.len()],
        translation: keys.iter().map(|&k| (track.places[k] - centre).as_vec3().to_array()).collect(),
    };
    let deformation = Deformation::Superpoints(Box::new(SuperpointDeformation::of_table(superpoints, table)));
    let object = LostObject {
        seen: track.seen.len(),
        photos: differences.len(),
        radius: track.radius,
        path: extent(&track.places),
        gaussians: points.len(),
        attached_to: None,
    };
    Some((object, Scene { gaussians, deformation, ..Scene::default() }))
}

/// First Gaussians at these points, like others of a scene.
pub(crate) fn like(points: &[Point], others: &Gaussians) -> Gaussians {
    let mut gaussians = with_sh_degree(&from_points(points, 0), others.sh_degree);
    gaussians.opacity_logit.fill((OPACITY / (1.0 - OPACITY)).ln());
    gaussians.antialiased = others.antialiased;
    gaussians
}

/// Ascending indices of places between which straight lines stay within `off` of the others.
fn key_places(places: &[DVec3], times: &[f32], off: f64) -> Vec<usize> {
    fewest_keys(places.len() - 1, |a, b| {
        let distance = |i: usize| {
            let share = f64::from(times[i] - times[a]) / f64::from(times[b] - times[a]);
            (places[i] - places[a].lerp(places[b], share)).length()
        };
        (a + 1..b).all(|i| distance(i) <= off)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_lie_where_a_path_bends() {
        let times: Vec<f32> = (0..11).map(|i| i as f32 / 10.0).collect();
        let bent = |i: usize| DVec3::new(i as f64, (i as f64 - 4.0).abs(), 0.0);
        let places: Vec<DVec3> = (0..11).map(bent).collect();
        assert_eq!(key_places(&places, &times, 0.01), [0, 4, 10]);
        assert_eq!(key_places(&places, &times, 10.0), [0, 10]);
        assert_eq!(key_places(&places[..1], &times, 0.01), [0]);
        let round: Vec<DVec3> = (0..11).map(|i| DVec3::new((i as f64).cos(), (i as f64).sin(), 0.0)).collect();
        assert_eq!(key_places(&round, &times, 1e-9), (0..11).collect::<Vec<_>>());
    }

    /// Photos that differ in a square around a place.
    fn images(shown: impl Fn(usize) -> DVec3) -> Vec<Shown> {
        let image = |time: usize| {
            let angle = 2.3 * time as f64;
            let eye = DVec3::new(4.0 * angle.cos(), 1.0, 4.0 * angle.sin());
            let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Y, 0.8, [64, 64]);
            let at = camera.project(shown(time)).unwrap_or_default();
            let near =
                |i: usize| (at - DVec2::new((i % 64) as f64 + 0.5, (i / 64) as f64 + 0.5)).abs().max_element() < 3.0;
            let photo = Arc::new(Pixels { width: 64, height: 64, rgba: vec![0; 64 * 64] });
            Shown { camera, photo, mask: (0..64 * 64).map(near).collect(), time }
        };
        (0..20).map(image).collect()
    }

    #[test]
    fn all_photos_judge_a_path() {
        let circle = |time: usize| {
            let angle = std::f64::consts::TAU * time as f64 / 20.0;
            DVec3::new(angle.cos(), 0.3, angle.sin())
        };
        let places: Vec<DVec3> = (0..20).map(circle).collect();
        assert!(differ_on(&places, &images(circle)));
        // Also what goes round twice, and is at the same place half of all times later.
        let twice = |time: usize| circle(2 * time);
        assert!(differ_on(&(0..20).map(twice).collect::<Vec<_>>(), &images(twice)));
        // Not where every fourth photo shows something else, nor where they differ at all times.
        assert!(!differ_on(&places, &images(|time| circle(if time % 4 == 1 { time + 10 } else { time }))));
        assert!(!differ_on(&[DVec3::ZERO; 20], &images(|_| DVec3::ZERO)));
    }
}
