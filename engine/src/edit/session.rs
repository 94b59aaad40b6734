//! A scene that commands change one after another.

use std::path::Path;

use glam::DVec3;
use serde::Serialize;

use super::masks::{Mask, Masks};
use super::script::{Action, Change, Command, Frame, Mark, Mode, Pivot, Retime, Term};
use super::select::{self, Depth, Likeness};
use super::split::{tidy, used};
use super::{
    Bound, Placement, Similarity, TimeMap, Touched, duplicate, keep, merge, recolor, retime, stretch, transform,
    transform_during, transform_in_part,
};
use crate::error::{Error, Result};
use crate::file;
use crate::scene::{Camera, Scene};

/// A scene, its selections, and the cameras that picks look through.
#[derive(Debug, Clone)]
pub struct Session {
    /// The scene as it is now.
    pub scene: Scene,
    /// Cameras of the data set, by number.
    pub cameras: Vec<Camera>,
    /// Largest displacement that re-made poses may cause, pixels.
    pub bound_px: f64,
    pub(super) masks: Masks,
    pub(super) seen: Seen,
    /// `[M]` superpoints that had no Gaussians from the start.
    empty: Vec<bool>,
}

/// Through which cameras, and when, commands look at the scene.
#[derive(Debug, Clone, Default)]
pub(super) struct Seen {
    camera: Option<Camera>,
    time: Option<f64>,
    /// Whether the result depends on [`Session::cameras`].
    uses_cameras: bool,
}

/// What a command came to.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Step {
    /// Line of the script.
    pub line: usize,
    /// The command.
    pub command: String,
    /// Gaussians selected after it.
    pub selected: usize,
    /// What it touched.
    #[serde(flatten)]
    pub touched: Touched,
}

impl Session {
    /// A session in which nothing is selected yet.
    pub fn new(scene: Scene, cameras: Vec<Camera>, bound_px: f64) -> Self {
        Self {
            empty: used(&scene).into_iter().map(|used| !used).collect(),
            scene,
            cameras,
            bound_px,
            masks: Masks::default(),
            seen: Seen::default(),
        }
    }

    /// The mask `[N]` of the selection; `None` before the first one.
    pub fn selected(&self) -> Option<&[bool]> {
        self.masks.get(&Mask::Selected)
    }

    /// The mask `[N]` of what is hidden; `None` when nothing is.
    pub fn hidden(&self) -> Option<&[bool]> {
        self.masks.get(&Mask::Hidden)
    }

    /// The mask `[N]` of what is locked; `None` when nothing is.
    pub fn locked(&self) -> Option<&[bool]> {
        self.masks.get(&Mask::Locked)
    }

    /// Selections that have names, in the order of these.
    pub fn named(&self) -> impl Iterator<Item = (&str, &[bool])> {
        self.masks.names()
    }

    /// The scene as it is written: without superpoints that have lost all their Gaussians.
    pub fn finished(&self) -> Scene {
        let mut scene = self.scene.clone();
        tidy(&mut scene, &self.empty);
        scene
    }

    /// The cameras, if the result so far depends on them.
    pub fn cameras_used(&self) -> &[Camera] {
        if self.seen.uses_cameras { &self.cameras } else { &[] }
    }

    /// Ends it: superpoints that have lost all their Gaussians go. Returns their number; numbers of later ones change.
    pub fn finish(&mut self) -> usize {
        tidy(&mut self.scene, &self.empty)
    }

    /// Carries out a command.
    ///
    /// # Errors
    /// Those of its operation; the scene may then be changed in part.
    pub fn apply(&mut self, command: &Command) -> Result<Step> {
        let touched = self.act(&command.action)?;
        let selected = self.selected().unwrap_or_default().iter().filter(|m| **m).count();
        Ok(Step { line: command.place.line, command: command.text.clone(), selected, touched })
    }

    fn act(&mut self, action: &Action) -> Result<Touched> {
        match action {
            Action::Select { mode, term, depth, view, time, similar } => {
                let found = self.find(term, *depth, *view, *time, *similar)?;
                self.combine(*mode, found)?;
            }
            Action::Invert => {
                let mask = self.mask()?.iter().map(|m| !m).collect();
                self.masks.select(mask);
            }
            Action::Grow(distance, time) => {
                let time = self.time_or(*time);
                let grown = select::grow(&self.scene, self.mask()?, *distance, time)?;
                self.masks.select(grown);
            }
            Action::Name(name) => {
                let mask = self.mask()?.to_vec();
                self.masks.set(Mask::Named(name.clone()), Some(mask));
            }
            Action::Mark(mark) => self.mark(mark)?,
            Action::Camera(camera) => self.seen.camera = Some((**camera).clone()),
            Action::Change { change, pivot, frame, time, during } => {
                let time = self.time_or(*time);
                let mask = self.mask()?.to_vec();
                let pivot = match pivot {
                    Pivot::Point(point) => *point,
                    Pivot::Center => select::center(&self.scene, &mask, time)?.unwrap_or_default(),
                };
                return match (similarity(*change, pivot), during) {
                    (Err(factors), None) if *frame == Frame::World => stretch(&mut self.scene, &mask, factors, pivot),
                    (Err(factors), _) => {
                        let expected = "one factor: a part turns, and a moment's scale bends poses";
                        Err(Error::usage("scale", format!("factors {factors} that differ"), expected))
                    }
                    (Ok(s), Some(window)) => {
                        let bound = self.bound()?;
                        transform_during(&mut self.scene, &mask, &s, pivot, *window, &bound)
                    }
                    (Ok(s), None) => self.change_in(*frame, &mask, &s, time),
                };
            }
            Action::Delete => {
                let rest: Vec<bool> = self.mask()?.iter().map(|m| !m).collect();
                return Ok(self.keep(&rest));
            }
            Action::Keep => {
                let kept = self.kept()?;
                return Ok(self.keep(&kept));
            }
            Action::Duplicate => {
                let mask = self.mask()?.to_vec();
                let touched = duplicate(&mut self.scene, &mask)?;
                self.select_last(touched.gaussians);
                return Ok(touched);
            }
            Action::Recolor(change) => {
                let mask = self.mask()?.to_vec();
                return Ok(recolor(&mut self.scene, &mask, change));
            }
            Action::Retime(how) => {
                let map = self.time_map(*how);
                let mask = self.mask()?.to_vec();
                return retime(&mut self.scene, &mask, map);
            }
            Action::Merge { file, at, rotate: (axis, angle), scale, time: [offset, rate] } => {
                let loaded = file::load(Path::new(file))?;
                let turn = Similarity::of_turn(*axis, *angle, DVec3::ZERO);
                let place = Similarity { scale: *scale, turn: turn.turn, shift: *at };
                let placement = Placement { place, time: [*rate, *offset] };
                let mut touched = merge(&mut self.scene, loaded.scene, &placement)?;
                self.select_last(touched.gaussians);
                touched.notes.extend(loaded.warnings);
                return Ok(touched);
            }
        }
        Ok(Touched::default())
    }

    /// What `keep` leaves: the selection, and what cannot be changed.
    pub(super) fn kept(&self) -> Result<Vec<bool>> {
        let mask = self.mask()?;
        Ok((0..mask.len()).map(|i| mask[i] || !self.masks.is_free(i)).collect())
    }

    fn mask(&self) -> Result<&[bool]> {
        self.masks.selected()
    }

    fn time_or(&self, time: Option<f64>) -> f64 {
        time.or(self.seen.time).unwrap_or_else(|| self.scene.time_range()[0])
    }

    fn bound(&mut self) -> Result<Bound> {
        self.seen.uses_cameras = true;
        Bound::new(&self.scene, &self.cameras, self.bound_px)
    }

    fn find(
        &mut self,
        term: &Term,
        depth: Depth,
        view: Option<usize>,
        time: Option<f64>,
        similar: Option<Likeness>,
    ) -> Result<Vec<bool>> {
        let camera = if term.is_pick() { Some(self.camera_of(view)?) } else { None };
        let of_camera = camera.as_ref().map(|c| c.time).filter(|t| t.is_finite());
        let time = time.or(of_camera).unwrap_or_else(|| self.time_or(None));
        self.seen.time = Some(time);
        let scene = &self.scene;
        let mut mask = match (term, &camera) {
            (Term::Criterion(criterion), _) => {
                self.seen.uses_cameras |= matches!(criterion, select::Criterion::Floaters(_));
                select::select(scene, criterion, time, &self.cameras)?
            }
            (Term::Named(name), _) => self.masks.named(name)?.to_vec(),
            (Term::Click(point), Some(camera)) => {
                let point = [point[0].pixels(camera.width), point[1].pixels(camera.height)];
                let mask = select::click(&self.view(camera, time), point, depth)?;
                select::whole_superpoints(scene, &mask)
            }
            (Term::Rectangle(corners), Some(camera)) => select::rectangle(&self.view(camera, time), *corners, depth)?,
            (Term::Lasso(points), Some(camera)) => select::lasso(&self.view(camera, time), points, depth)?,
            _ => vec![false; scene.gaussians.len()],
        };
        if let Some(most) = similar {
            let bound = self.bound()?;
            mask = select::similar(&self.scene, &mask, most, &bound)?;
        }
        Ok(mask)
    }

    /// What picks look at: hidden Gaussians are not seen.
    fn view<'a>(&'a self, camera: &'a Camera, time: f64) -> select::View<'a> {
        select::View { scene: &self.scene, camera, time, hidden: self.hidden() }
    }

    fn camera_of(&mut self, view: Option<usize>) -> Result<Camera> {
        let Some(view) = view else {
            let expected = "`view N` with --data, or a `camera` before this";
            return self.seen.camera.clone().ok_or_else(|| Error::usage("camera", "none", expected));
        };
        self.seen.uses_cameras = true;
        self.cameras.get(view).cloned().ok_or_else(|| match self.cameras.len() {
            0 => Error::usage("view", format!("{view}, without cameras"), "the cameras of a data set (--data)"),
            count => Error::usage("view", view.to_string(), format!("0 to {}", count - 1)),
        })
    }

    fn combine(&mut self, mode: Mode, found: Vec<bool>) -> Result<()> {
        let with = |by: fn(bool, bool) -> bool, old: &[bool]| old.iter().zip(&found).map(|(a, b)| by(*a, *b)).collect();
        let mask = match mode {
            Mode::Replace => found,
            Mode::Add if self.selected().is_none() => found,
            Mode::Add => with(|a, b| a || b, self.mask()?),
            Mode::Subtract => with(|a, b| a && !b, self.mask()?),
            Mode::Intersect => with(|a, b| a && b, self.mask()?),
        };
        self.masks.select(mask);
        Ok(())
    }

    fn mark(&mut self, mark: &Mark) -> Result<()> {
        let all = || vec![true; self.scene.gaussians.len()];
        let of = |name: &Option<String>| match name {
            Some(name) => self.masks.named(name).map(<[bool]>::to_vec),
            None => self.mask().map(<[bool]>::to_vec),
        };
        let of_all = |name: &Option<String>| if name.is_some() { of(name) } else { Ok(all()) };
        let (mask, of, on) = match mark {
            Mark::Hide(name) => (Mask::Hidden, of(name)?, true),
            Mark::Isolate => (Mask::Hidden, self.mask()?.iter().map(|m| !m).collect(), true),
            Mark::Show(name) => (Mask::Hidden, of_all(name)?, false),
            Mark::Lock(name) => (Mask::Locked, of(name)?, true),
            Mark::Unlock(name) => (Mask::Locked, of_all(name)?, false),
        };
        self.masks.mark(mask, &of, on);
        Ok(())
    }

    fn change_in(&mut self, frame: Frame, mask: &[bool], s: &Similarity, time: f64) -> Result<Touched> {
        let part = match frame {
            Frame::World => None,
            Frame::Part => select::main_superpoint(&self.scene, mask),
            Frame::Superpoint(j) => Some(j),
        };
        match part {
            Some(part) => {
                let bound = self.bound()?;
                transform_in_part(&mut self.scene, mask, part, s, time, &bound)
            }
            None => transform(&mut self.scene, mask, s),
        }
    }

    fn time_map(&self, how: Retime) -> TimeMap {
        let [start, end] = self.scene.time_range();
        match how {
            Retime::Freeze(time) => TimeMap::Freeze(time),
            Retime::Shift(by) => TimeMap::Linear { rate: 1.0, offset: -by },
            Retime::Stretch(by) => TimeMap::Linear { rate: by.recip(), offset: start - start / by },
            Retime::Reverse => TimeMap::Linear { rate: -1.0, offset: start + end },
            Retime::Loop(from, to) => TimeMap::Loop { from, to },
        }
    }

    /// Keeps Gaussians, and what selections say of them.
    fn keep(&mut self, mask: &[bool]) -> Touched {
        let touched = keep(&mut self.scene, mask);
        self.masks.keep(mask);
        touched
    }

    fn select_last(&mut self, count: usize) {
        self.masks.select_last(self.scene.gaussians.len(), count);
    }
}

/// A change that keeps shapes; `Err` with the factors of a scale that does not.
fn similarity(change: Change, pivot: DVec3) -> Result<Similarity, DVec3> {
    match change {
        Change::Move(by) => Ok(Similarity::of_shift(by)),
        Change::Rotate(axis, angle) => Ok(Similarity::of_turn(axis, angle, pivot)),
        Change::Scale(f) if f == DVec3::splat(f.x) => Ok(Similarity::of_scale(f.x, pivot)),
        Change::Scale(factors) => Err(factors),
    }
}
