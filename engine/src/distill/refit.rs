//! The end of a training run: its motion made of few rigid parts, and these trained on the photos in place of network F.
//!
//! Parts follow network F within a bound ([`distill`](super::distill)); neighbours that move alike become one. Then key poses and Gaussians
//! are trained ([`tune`]): a step does not run the network, and a part's pose is learnt from all that shows it.

use std::borrow::Cow;

use super::attached::take_attached;
use super::tune::{Lessons, TuneOptions, Tuned, tune};
use super::{Distilled, Options, Tick, distill};
use crate::data::dataset::View;
use crate::edit::{Placement, merge};
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::reference::freeze;
use crate::scene::{Camera, Deformation, Motion, MotionSource, Scene, SuperpointDeformation, Superpoints};
use crate::train::bake::Views;
use crate::train::config::Config;
use crate::train::lost::LostObject;
use crate::train::lost::residual::Residual;
use crate::train::trainer::StepReport;

/// Cameras of a data set in which a bound is measured, at most.
pub const CAMERAS: usize = 12;

/// Most objects that are found one after the other.
const MOST_ATTACHED: usize = 8;

/// What became of a run's motion.
#[derive(Debug, Clone)]
pub struct Refitted {
    /// The model.
    pub scene: Scene,
    /// Superpoints before and after, lost objects apart.
    pub superpoints: [usize; 2],
    /// How far the parts were allowed to be off, pixels, and were off before they were trained; `None`: superpoints were kept, or there
    /// are none.
    pub error_px: Option<[f64; 2]>,
    /// Objects that the photos showed and the parts did not: each is one more part.
    pub lost_objects: Vec<LostObject>,
    /// Mean loss of the first and of the last tenth of the steps.
    pub loss: [f64; 2],
    /// `[photos][40]`, where there were some.
    pub exposures: Option<Vec<f32>>,
}

/// What a run found of each of its photos.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct OfPhotos {
    /// `[photos][40]` exposures ([`exposure`](crate::train::exposure)), where there are some.
    pub exposures: Option<Vec<f32>>,
    /// Pixels that are left out ([`transients`](crate::train::transients)), where some may be.
    pub transients: Option<Vec<u32>>,
}

/// So many of all, in equal steps; all where there are fewer.
pub fn spread<T>(all: &[T], count: usize) -> impl Iterator<Item = &T> {
    let count = count.min(all.len());
    (0..count).map(move |k| &all[k * all.len() / count])
}

/// The bound in pixels of these photos: `refit.error` of their shorter side.
fn bound_px(photos: &[View], config: &Config) -> f64 {
    let side = photos.iter().map(|v| v.camera.width.min(v.camera.height)).max().unwrap_or(1);
    config.refit.error * f64::from(side)
}

fn views(photos: &[View], config: &Config) -> Views<Camera> {
    let camera = |v: &View| Camera { time: v.time, ..v.camera.clone() };
    let cameras = spread(photos, CAMERAS).map(camera).collect();
    Views { cameras, near: f64::from(config.near), everywhere: true }
}

/// Fits and trains a run's exported model for the steps that `config`, scaled, leaves to this; `None` where it moves by other than a
/// key-time table. Where nothing moves, the Gaussians learn, and what is lost is looked for. Exposures are learnt on from the run's; its
/// transients stay left out. `tick` hears of the fit, `watch` of every step.
///
/// # Errors
/// Those of [`distill`](super::distill) and [`tune`].
pub fn refit(
    gpu: &Gpu,
    scene: &Scene,
    photos: &[View],
    config: &Config,
    OfPhotos { exposures, transients }: OfPhotos,
    tick: &mut Tick<'_>,
    watch: &mut dyn FnMut(&StepReport),
) -> Result<Option<Refitted>> {
    let iterations = config.refit_iterations();
    let alone = scene.deformation.nonrigid().is_none() && scene.deformation.field().is_none();
    let moves = scene.deformation.moves();
    if iterations == 0 || !alone || (moves && scene.deformation.table().is_none()) {
        return Ok(None);
    }
    let resting = (!moves).then(|| at_rest(scene, photos));
    let scene = resting.as_ref().unwrap_or(scene);
    let views = views(photos, config);
    let most = config.refit.most_divided as usize;
    let fitted = if moves { parts(scene, &views, bound_px(photos, config), most, tick)? } else { None };
    let mut student = Cow::Borrowed(fitted.as_ref().map_or(scene, |f| &f.scene));
    let superpoints = [scene, &*student].map(|s| s.deformation.superpoint_count());
    let mut lost_objects = Vec::new();
    if config.motion.lost_objects && exposures.is_none() {
        tick("lost objects", 0, None);
        lost_objects = add_lost_objects(gpu, &mut student, photos, config)?;
    }
    let mut none = |_: &Camera| Err(Error::usage("refit", "an image of the teacher", "photos alone"));
    let (photos, cameras, times) = (photos.to_vec(), Vec::new(), scene.time_range());
    let lessons = Lessons { photos, cameras, times, draw: &mut none, exposures, transients };
    let (seed, background, near) = (config.seed, config.background, config.near);
    let how = TuneOptions { iterations, seed, background, near, rate_px: None, deterministic: config.deterministic };
    let tuned = tune(gpu, &student, &views, lessons, &how, watch)?;
    let off = |f: &Distilled| -> Result<[f64; 2]> {
        let displacement = f.yardstick.measure(&f.scene, &views)?;
        Ok([displacement.bound_px, displacement.error_px.largest])
    };
    let error_px = fitted.as_ref().map(off).transpose()?;
    let Tuned { mut scene, loss, exposures, .. } = tuned;
    if !moves && lost_objects.is_empty() {
        scene.deformation = Deformation::None;
    }
    Ok(Some(Refitted { scene, superpoints, error_px, lost_objects, loss, exposures }))
}

/// A scene that stands still, as one superpoint that rests at all times of the photos.
fn at_rest(scene: &Scene, photos: &[View]) -> Scene {
    let all = photos.iter().map(|v| v.time as f32);
    let mut times = vec![all.clone().fold(f32::INFINITY, f32::min), all.fold(f32::NEG_INFINITY, f32::max)];
    times.dedup();
    let zeros = vec![[0.0; 3]; times.len()];
    let table = Motion { times, rotation: zeros.clone(), translation: zeros };
    let superpoints = Superpoints { of_gaussian: vec![0; scene.gaussians.len()], position: vec![[0.0; 3]] };
    let moved = SuperpointDeformation { superpoints, table: Some(table), ..SuperpointDeformation::default() };
    Scene { deformation: moved.into(), ..scene.clone() }
}

/// Adds what the photos show and the student does not; returns it.
fn add_lost_objects(
    gpu: &Gpu,
    student: &mut Cow<'_, Scene>,
    photos: &[View],
    config: &Config,
) -> Result<Vec<LostObject>> {
    let mut added = Vec::new();
    let Some(mut residual) = Residual::new(gpu, student, photos, config)? else { return Ok(added) };
    let found = residual.take_objects(student, config);
    join(student, found, &mut added)?;
    for _ in 0..MOST_ATTACHED {
        let Some(found) = take_attached(&mut residual, student, config) else { break };
        join(student, vec![found], &mut added)?;
    }
    Ok(added)
}

/// Merges objects into the student, as far as there is room for their key times.
fn join(student: &mut Cow<'_, Scene>, found: Vec<(LostObject, Scene)>, added: &mut Vec<LostObject>) -> Result<()> {
    for (object, part) in found {
        match merge(student.to_mut(), part, &Placement::default()) {
            // No more key times.
            Err(Error::Limit { .. }) => break,
            other => other?,
        };
        added.push(object);
    }
    Ok(())
}

/// Rigid parts in place of the superpoints of a scene with a table; `None` where it has more than `most` Gaussians.
fn parts(
    scene: &Scene,
    views: &Views<Camera>,
    error_px: f64,
    most: usize,
    tick: &mut Tick<'_>,
) -> Result<Option<Distilled>> {
    if scene.gaussians.len() > most {
        return Ok(None);
    }
    let mut place = |time: f64| freeze(scene, time, MotionSource::Table);
    let options = Options { error_px, ..Options::default() };
    distill(scene, &mut place, views, &options, tick).map(Some)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use glam::DVec3;

    use super::*;
    use crate::scene::synthetic::moving_scene;

    #[test]
    fn superpoints_that_move_alike_become_one_or_stay() {
        let mut scene = moving_scene(300, 12, 5, 7, false);
        let moved = scene.deformation.superpoint_deformation_mut().unwrap();
        let table = moved.table.as_mut().unwrap();
        for rows in [&mut table.rotation, &mut table.translation] {
            rows.chunks_exact_mut(12)
                .for_each(|row| row.copy_from_slice(&std::array::from_fn::<_, 12, _>(|j| row[j % 2])));
        }
        let camera = Camera::look_at(DVec3::new(0.0, 0.0, -5.0), DVec3::ZERO, DVec3::Y, 0.8, [100, 100]);
        let views = Views { cameras: vec![camera], near: 0.2, everywhere: true };
        let n = scene.gaussians.len();
        let found = |most: usize| parts(&scene, &views, 0.5, most, &mut |_, _, _| {}).unwrap();
        assert!(found(n - 1).is_none());
        let fitted = found(n).unwrap();
        assert_eq!(fitted.scene.deformation.superpoint_count(), 2);
        assert!(fitted.yardstick.measure(&fitted.scene, &views).unwrap().is_within());
    }
}
