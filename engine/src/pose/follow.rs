//! Photos in order of time: begin with what is known, search, write down.

use std::borrow::Cow;

use glam::{DQuat, DVec3};

use super::bodies::{Bodies, Outline, Stand};
use super::coupling::Coupling;
use super::sight::{Sight, apart_px, halvings, project};
use super::solver::{PhotoFound, Sizes, Solver, State};
use super::uncertainty::{Uncertainty, uncertainties};
use super::verdict::{self, Verdict};
use super::{CameraReport, Following, Moment, Options, PhotoReport, Progress, Solve, Watch, keys};
use crate::data::dataset::View;
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::reference::{Pose, table_poses};
use crate::scene::{Camera, Motion, Scene, SuperpointDeformation, Superpoints};
use crate::train::photo_loss::{PhotoLoss, PhotoLossOptions};

/// Most that a motion is continued by, in key intervals.
const LONGEST_STRIDE: f64 = 2.0;

/// Finds how superpoints, cameras or both stand in `views`. Photos of one time are looked at together, times in their order, each
/// from where the model (with the keys found so far) stands at it; the first one from `start` `[M]`, if that is given. `None` when
/// the watcher wants an end.
///
/// # Errors
/// `Usage` for no photos, for a start of another length, for a model that stands still or whose superpoints have no key-time table
/// where these are searched for, for network G and deformation fields; those of photos and device.
pub fn follow(
    gpu: &Gpu,
    scene: &Scene,
    views: &[View],
    options: &Options,
    start: Option<&[Pose]>,
    watch: &mut Watch<'_>,
) -> Result<Option<Following>> {
    if views.is_empty() {
        return Err(Error::usage("photos", "none", "at least one"));
    }
    if scene.gaussians.is_empty() {
        return Err(Error::usage("model", "no Gaussians", "at least one"));
    }
    let carrier = carrier(scene, options.solve)?;
    let Some(table) = carrier.deformation.table() else {
        return Err(Error::usage("model", "no key-time table", "superpoints with one"));
    };
    let loss_options = PhotoLossOptions {
        background: options.background,
        near: options.near,
        lambda_dssim: options.lambda_dssim,
        deterministic: options.deterministic,
    };
    let bodies = Bodies::new(&carrier);
    let mut follower = Follower {
        loss: PhotoLoss::new(gpu, &carrier, loss_options)?,
        coupling: Coupling::new(&bodies, table),
        outline: Outline::new(&carrier),
        scene: &carrier,
        bodies,
        options,
        table: table.clone(),
        cameras: views.iter().map(|v| v.camera.clone()).collect(),
    };
    if let Some(start) = start.filter(|s| s.len() != table.superpoint_count()) {
        let expected = format!("{}, one per superpoint", table.superpoint_count());
        return Err(Error::usage("poses to start from", start.len().to_string(), expected));
    }
    let mut moments = Vec::new();
    for (index, (time, photos)) in by_time(views).into_iter().enumerate() {
        let start = start.filter(|_| index == 0);
        match follower.moment(index, time, start, &photos, views, watch)? {
            Some(moment) => moments.push(moment),
            None => return Ok(None),
        }
    }
    let Follower { table, cameras, .. } = follower;
    let mut scene = scene.clone();
    if options.solve != Solve::Camera
        && let Some(motion) = scene.deformation.table_mut()
    {
        *motion = table;
    }
    Ok(Some(Following { scene, cameras, moments }))
}

/// Times in their order, with the photos of each.
fn by_time(views: &[View]) -> Vec<(f64, Vec<usize>)> {
    let mut order: Vec<usize> = (0..views.len()).collect();
    order.sort_by(|&a, &b| views[a].time.total_cmp(&views[b].time).then(a.cmp(&b)));
    let mut moments: Vec<(f64, Vec<usize>)> = Vec::new();
    for i in order {
        match moments.last_mut() {
            Some((time, photos)) if *time as f32 == views[i].time as f32 => photos.push(i),
            _ => moments.push((views[i].time, vec![i])),
        }
    }
    moments
}

/// A scene with superpoints and a table: the model, or one that stands still as a single superpoint.
fn carrier(scene: &Scene, solve: Solve) -> Result<Cow<'_, Scene>> {
    let d = &scene.deformation;
    if d.field().is_some() || d.nonrigid().is_some() {
        let found = if d.field().is_some() { "a deformation field" } else { "network G" };
        let expected = "superpoints with a key-time table alone (`spgs distill` makes them of any motion)";
        return Err(Error::usage("motion of the model", found, expected));
    }
    match (d.table(), d.moves(), solve) {
        (Some(_), _, _) => Ok(Cow::Borrowed(scene)),
        (None, true, _) => {
            let expected = "a key-time table (`spgs convert --bake` makes one)";
            Err(Error::usage("motion of the model", "network F alone", expected))
        }
        (None, false, Solve::Camera) => {
            let n = scene.gaussians.len();
            let superpoints = Superpoints { of_gaussian: vec![0; n], position: vec![[0.0; 3]] };
            let rest = Motion { times: vec![0.0], rotation: vec![[0.0; 3]], translation: vec![[0.0; 3]] };
            let deformation = SuperpointDeformation::of_table(superpoints, rest).into();
            Ok(Cow::Owned(Scene { gaussians: scene.gaussians.clone(), deformation, ..Scene::default() }))
        }
        (None, false, _) => Err(Error::usage("model", "one that stands still", "superpoints, or --solve camera")),
    }
}

struct Follower<'a> {
    loss: PhotoLoss<'a>,
    scene: &'a Scene,
    bodies: Bodies,
    outline: Outline,
    coupling: Coupling,
    options: &'a Options,
    /// With the keys found so far.
    table: Motion,
    cameras: Vec<Camera>,
}

impl Follower<'_> {
    fn moment(
        &mut self,
        index: usize,
        time: f64,
        start: Option<&[Pose]>,
        photos: &[usize],
        views: &[View],
        watch: &mut Watch<'_>,
    ) -> Result<Option<Moment>> {
        let known = || table_poses(&self.table, self.options.init.unwrap_or(time));
        let start = start.map_or_else(known, <[Pose]>::to_vec);
        let stands = self.bodies.stands(&start);
        let expected = self.expected(time);
        let outline = self.outline.at(&start);
        let smallest = photos.iter().map(|&i| halvings([views[i].camera.width, views[i].camera.height])).min();
        let sight = |&i: &usize| Sight::new(&self.loss, &views[i], smallest.unwrap_or(0), &outline);
        let sights = photos.iter().map(sight).collect::<Result<Vec<_>>>()?;
        let mut state = State { stands, sights, poses: start.clone(), start };
        let mut progress = Progress { time, moment: index, iteration: 0, round: 0, loss: 0.0 };
        let first: Vec<Camera> = state.sights.iter().map(|s| s.camera.clone()).collect();
        let stood = state.stands.clone();
        let mut solver = Solver {
            loss: &mut self.loss,
            scene: self.scene,
            bodies: &self.bodies,
            coupling: &self.coupling,
            options: self.options,
            expected: expected.as_deref(),
            strength: self.options.coupling,
        };
        let before = solver.measure(&mut state)?;
        if !solver.solve(&mut state, Sizes::All, &mut progress, watch)? {
            return Ok(None);
        }
        let mut after = solver.measure(&mut state)?;
        let mut verdicts = vec![Verdict::NotChecked; photos.len()];
        let is_better = total(&after) <= total(&before);
        if self.options.solve != Solve::Camera && !is_better {
            // Where a model fits already, what a search leaves open can be more than what it finds.
            (state.stands, state.poses) = (stood, state.start.clone());
            state.sights.iter_mut().zip(&first).for_each(|(sight, camera)| sight.camera = camera.clone());
            after.clone_from(&before);
        }
        if self.options.solve == Solve::Camera {
            match verdict::check(&mut solver, &mut state, &first, &outline, &mut after, &mut progress, watch)? {
                Some(found) => verdicts = found,
                None => return Ok(None),
            }
        }
        let poses = self.bodies.poses(&state.stands, &state.poses);
        let is_new_key = self.options.solve != Solve::Camera && keys::put(&mut self.table, time, &poses)?;
        let superpoints = self.uncertainties(&state, &poses, &after)?;
        photos.iter().zip(&state.sights).for_each(|(&i, sight)| self.cameras[i] = sight.camera.clone());
        let reports = photos.iter().enumerate().map(|(k, &i)| {
            let camera = (self.options.solve != Solve::Superpoints)
                .then(|| camera_report(&first[k], &state.sights[k].camera, &outline, verdicts[k]));
            PhotoReport {
                name: views[i].name.clone(),
                psnr_before: psnr(before[k].mse),
                psnr: psnr(after[k].mse),
                camera,
            }
        });
        let photos = reports.collect();
        let moved_px = (self.options.solve != Solve::Camera).then(|| self.way(&state)).flatten();
        let direction = state.sights.first().map_or([0.0; 3], |sight| sight.camera.rotation.row(2).to_array());
        Ok(Some(Moment { time, is_new_key, is_better, photos, direction, superpoints, moved_px }))
    }

    /// Where the superpoints go on to at a time after the last key, as they went between the last two; `None` within the table.
    fn expected(&self, time: f64) -> Option<Vec<Stand>> {
        let times = &self.table.times;
        let [.., before, last] = times[..] else { return None };
        let (before, last) = (f64::from(before), f64::from(last));
        let stride = (time - last) / (last - before);
        if stride <= 0.0 || stride > LONGEST_STRIDE || self.options.smoothness <= 0.0 {
            return None;
        }
        let [from, to] = [before, last].map(|t| self.bodies.stands(&table_poses(&self.table, t)));
        let goes_on =
            |(from, to): (&Stand, &Stand)| to.moved(to.turn_from(from) * stride, (to.place - from.place) * stride);
        Some(from.iter().zip(&to).map(goes_on).collect())
    }

    fn uncertainties(&mut self, state: &State, poses: &[Pose], found: &[PhotoFound]) -> Result<Vec<Uncertainty>> {
        if self.options.solve == Solve::Camera {
            return Ok(Vec::new());
        }
        let errors: Vec<f64> = found.iter().map(|f| f.mse).collect();
        uncertainties(&mut self.loss, &self.bodies, &state.stands, poses, &state.sights, &errors, self.options.probes)
    }

    /// Root mean square way of the superpoints' centres since the search began, pixels of the first photo.
    fn way(&self, state: &State) -> Option<f64> {
        let camera = &state.sights.first()?.camera;
        let began = self.bodies.stands(&state.start);
        let squares = began.iter().zip(&state.stands).filter_map(|(from, to)| {
            let ([a, b], [c, d]) = (project(camera, from.place)?, project(camera, to.place)?);
            Some((a - c).powi(2) + (b - d).powi(2))
        });
        let squares: Vec<f64> = squares.collect();
        (!squares.is_empty()).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
    }
}

/// Loss of all photos of a time.
fn total(found: &[PhotoFound]) -> f64 {
    found.iter().map(|f| f.loss).sum()
}

fn psnr(mse: f64) -> f64 {
    -10.0 * mse.max(1e-30).log10()
}

fn camera_report(from: &Camera, to: &Camera, outline: &[DVec3], verdict: Verdict) -> CameraReport {
    let turn = DQuat::from_mat3(&(to.rotation.transpose() * from.rotation)).normalize();
    CameraReport {
        turned_degrees: turn.to_scaled_axis().length().to_degrees(),
        moved: from.position.distance(to.position),
        moved_px: apart_px(from, to, outline),
        verdict,
    }
}
