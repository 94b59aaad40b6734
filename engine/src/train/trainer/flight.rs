//! Steps in flight: the host submits steps ahead and reads their reports later, so that the device never waits for it.
//!
//! # The rule
//!
//! The sequence of applied steps is the same whatever the number of steps in flight, so a deterministic run has the same bits.
//!
//! - A step in flight depends on its iteration and on what is on the device, never on an earlier report: the host changes
//!   nothing that a step reads (density control, the start of motion) before all submitted steps have finished.
//! - A step that needs more tile instances than there is room for applies nothing, and neither does any step behind it: each
//!   step leaves its failure in `failed`, where the counters of the next one begin.
//! - When the host reads the report of a failed step, it waits for those behind it, clears the failure, makes room, and submits
//!   the failed step and those behind it again, one by one and in order.
//!
//! A report of numbers that are not finite names the first such step. Steps behind it may have been applied by then, as much
//! of them as was finite; a run does not go on from there, its last checkpoint is before.

use super::{READBACK, READBACK_BYTES, StepReport, Trainer};
use crate::data::pixels::Pixels;
use crate::error::{Error, Result};
use crate::gpu::{Commands, Submission, Timing};
use crate::render::frame::Frame;
use crate::render::limits::{COUNT_FAILED, COUNT_INSTANCES_HIGH, COUNT_INSTANCES_LOW, COUNT_REJECTED, COUNT_VISIBLE};
use crate::train::density::DensityChange;
use crate::train::status;
use crate::train::target::RecordingKey;
use std::sync::Arc;

/// Steps in flight unless said otherwise: one that the device works on, one that is ready when it has ended, and one that the
/// host is at.
pub const FLIGHT: usize = 3;
/// Photos announced ahead of their use.
const PREFETCH: u64 = 8;

/// A step that was submitted.
#[derive(Debug, Clone, Copy)]
pub(in crate::train) struct Job {
    iteration: u64,
    view: usize,
    /// Which of the buffers and recordings of steps in flight it uses.
    slot: usize,
    /// First word of its photo.
    photo: u32,
    submission: Submission,
}

/// A step that has finished.
#[derive(Debug, Clone, PartialEq)]
pub struct Finished {
    /// What it found.
    pub report: StepReport,
    /// Device time of each of its operations, in order; empty where none were taken.
    pub timings: Vec<Timing>,
    /// What density control did after it.
    pub density: Option<DensityChange>,
}

/// What a step left.
enum Outcome {
    Applied(StepReport),
    /// Nothing was changed: the view needs this many tile instances.
    NoRoom(u64),
}

impl Trainer {
    /// Submits one iteration: pick a photo, move, render, compare, go back, update; waits only when as many steps are in
    /// flight as may be, and then for the oldest. Where the schedule says so, all of them are finished and the density is
    /// adapted. Reports come later, by [`Trainer::take_finished`].
    ///
    /// # Errors
    /// As [`Trainer::step`], of this step or of one in flight; [`Trainer::iteration`] is then the last good one.
    pub fn advance(&mut self) -> Result<()> {
        let iteration = self.iteration + 1;
        self.widen_window(iteration)?;
        if !self.photos.are_there(self.pyramid.places(iteration)) {
            let mut ahead: Vec<usize> = (0..PREFETCH).map(|k| self.view_at(iteration + k)).collect();
            ahead.retain(|view| self.photos.find(*view).is_none());
            self.loader.prefetch(&ahead);
        }
        let view = self.view_at(iteration);
        self.advance_on(view, None)
    }

    /// What is drawn at an iteration, as the window is now: a photo at the size of that iteration.
    fn view_at(&mut self, iteration: u64) -> usize {
        let window = self.window.as_ref().filter(|w| !w.is_open());
        let photo = window.map_or_else(|| self.sampler.view(iteration), |w| w.draw(self.config.seed, iteration));
        self.pyramid.at(self.aside.in_place_of(photo, iteration), iteration)
    }

    /// Opens the window of times further where it is time to look, which is settled by the iteration alone.
    fn widen_window(&mut self, iteration: u64) -> Result<()> {
        if self.window.as_ref().is_none_or(|w| !w.looks_at(iteration)) {
            return Ok(());
        }
        self.drain()?;
        self.window.iter_mut().for_each(|w| w.widen(iteration));
        Ok(())
    }

    /// [`Trainer::advance`] on this view, with a photo that is not the loader's.
    pub(crate) fn advance_on(&mut self, view: usize, photo: Option<&Pixels>) -> Result<()> {
        let iteration = self.iteration + 1;
        if self.schedule.superpoints_begin(iteration) {
            self.drain()?;
            self.begin_motion()?;
        }
        while self.flying.len() >= self.flight() {
            self.finish_oldest()?;
        }
        let busy = |slot: &usize| self.flying.iter().any(|job| job.slot == *slot);
        let slot = (0..self.flight()).find(|slot| !busy(slot)).unwrap_or(0);
        let photo = self.photo(slot, view, photo)?;
        let mut job = Job { iteration, view, slot, photo, submission: Submission::default() };
        self.launch(&mut job)?;
        self.flying.push_back(job);
        self.iteration = iteration;
        let checks = self.config.log.finite_interval;
        let checks = checks > 0 && iteration.is_multiple_of(checks);
        let marks = self.schedule.marks_transients(iteration);
        if checks || marks || self.adapts_density(iteration) {
            self.drain()?;
            if marks {
                self.mark_transients(iteration)?;
            }
            self.adapt_density(iteration)?;
            if let Some(last) = self.finished.back_mut() {
                last.density = self.density_change.take();
            }
        }
        if checks { self.check_numbers() } else { Ok(()) }
    }

    /// Waits for all submitted steps.
    ///
    /// # Errors
    /// As [`Trainer::step`].
    pub fn drain(&mut self) -> Result<()> {
        while !self.flying.is_empty() {
            self.finish_oldest()?;
        }
        Ok(())
    }

    /// The next finished step, in order.
    pub fn take_finished(&mut self) -> Option<Finished> {
        self.finished.pop_front()
    }

    /// Steps that may be in flight: as many as were asked for, fewer where photos have no room.
    pub fn flight(&self) -> usize {
        self.slots.len().min(self.photos.lanes())
    }

    /// Steps that were submitted again, because they or one before them had no room.
    pub fn repeated(&self) -> u64 {
        self.repeated
    }

    /// Test seam: from here on there is room for this many tile instances, until a step needs more.
    ///
    /// # Errors
    /// `Usage` while steps are in flight.
    pub fn inject_capacity(&mut self, instances: u64) -> Result<()> {
        self.settled()?;
        self.capacity = instances;
        self.targets.clear();
        Ok(())
    }

    /// What wants the state between two steps wants no steps in flight.
    pub(in crate::train) fn settled(&self) -> Result<()> {
        if self.flying.is_empty() {
            return Ok(());
        }
        let found = format!("{} steps in flight", self.flying.len());
        Err(Error::usage("state of the training", found, "a trainer that was drained"))
    }

    /// Whether the photo of a view is on the device to stay, so that it need not be given again.
    pub(crate) fn has_photo(&self, view: usize) -> bool {
        self.photos.find(view).is_some()
    }

    /// Where the photo of `view` begins on the device, uploaded if need be.
    fn photo(&mut self, slot: usize, view: usize, given: Option<&Pixels>) -> Result<u32> {
        if let (None, Some(first)) = (given, self.photos.find(view)) {
            return Ok(first);
        }
        let mut loaded = if given.is_none() { Some(self.loader.get(view)?) } else { None };
        if let (Some(photo), Some(transients)) = (&mut loaded, &self.transients) {
            transients.apply(self.pyramid.photo(view), Arc::make_mut(photo));
        }
        let Some(photo) = given.or(loaded.as_deref()) else { return Ok(0) };
        let camera = &self.pyramid.views[view].camera;
        if [photo.width, photo.height] != [camera.width, camera.height] {
            let found = format!("{}×{} pixels", photo.width, photo.height);
            let what = format!("photo of {}", self.pyramid.views[view].name);
            return Err(Error::usage(what, found, "the camera's size"));
        }
        let first = self.photos.upload(&self.gpu, slot, view, photo)?;
        if self.photos.stays(view) {
            self.loader.forget(view);
        }
        Ok(first)
    }

    /// Writes what the step is and submits it.
    fn launch(&mut self, job: &mut Job) -> Result<()> {
        let Job { iteration, view, slot, photo, .. } = *job;
        self.parameters.scene.sh_degree = self.schedule.sh_degree(iteration).min(self.parameters.sh_degree);
        let camera = &self.pyramid.views[view].camera;
        let at = self.target([camera.width, camera.height])?;
        let camera = &self.pyramid.views[view].camera;
        let frame = Frame::new(camera, self.parameters.scene.origin, &self.frame_options(view, at))?;
        let mut step = self.step_of(iteration, view, photo);
        let (time, pixels) = (self.pyramid.views[view].time, f64::from(camera.width) * f64::from(camera.height));
        self.deformation.iter().for_each(|model| model.prepare(&mut step, time, pixels));
        self.slots[slot].step.write(0, bytemuck::bytes_of(&step))?;
        let key = RecordingKey { sh_degree: self.parameters.scene.sh_degree, moves: self.deformation.is_some() };
        let target = &self.targets[at];
        target.frames[slot].frame.write(0, bytemuck::bytes_of(&frame))?;
        if target.commands[slot].as_ref().is_none_or(|(k, _)| *k != key) {
            let commands = self.record(at, slot)?;
            self.targets[at].commands[slot] = Some((key, commands));
        }
        let timed = self.is_timed(iteration);
        if let Some((_, commands)) = &mut self.targets[at].commands[slot] {
            job.submission = if timed { self.gpu.submit_timed(commands) } else { self.gpu.submit(commands) }?;
        }
        Ok(())
    }

    /// The recording that a step was submitted with.
    fn commands_of(&self, job: &Job) -> Option<&Commands> {
        let camera = &self.pyramid.views[job.view].camera;
        let target = self.targets.iter().find(|t| t.size == [camera.width, camera.height])?;
        target.commands[job.slot].as_ref().map(|(_, commands)| commands)
    }

    fn wait_for(&self, job: &Job) -> Result<()> {
        // The recording names the kernel that a lost device was at.
        let commands = self.commands_of(job).filter(|c| c.submission() == job.submission);
        commands.map_or_else(|| self.gpu.wait(job.submission), |commands| self.gpu.wait_for(commands))
    }

    /// Waits for the oldest step in flight and takes its report; repeats it and those behind it where it had no room.
    fn finish_oldest(&mut self) -> Result<()> {
        let Some(job) = self.flying.front().copied() else { return Ok(()) };
        match self.wait_for(&job).and_then(|()| self.read_back(&job)) {
            Ok(Outcome::Applied(report)) => {
                self.flying.pop_front();
                self.finish(&job, report)
            }
            Ok(Outcome::NoRoom(instances)) => self.repeat(instances),
            Err(error) => {
                self.give_up(job.iteration);
                Err(error)
            }
        }
    }

    fn finish(&mut self, job: &Job, report: StepReport) -> Result<()> {
        if let Some(window) = &mut self.window {
            window.note(report.view, report.l1);
        }
        let timed = self.is_timed(job.iteration);
        let commands = self.commands_of(job).filter(|_| timed);
        let timings = commands.map_or(Ok(Vec::new()), Commands::timings)?;
        self.finished.push_back(Finished { report, timings, density: None });
        Ok(())
    }

    /// Repeats the steps in flight, of which the first had no room and which therefore applied nothing.
    fn repeat(&mut self, instances: u64) -> Result<()> {
        let mut jobs: Vec<Job> = self.flying.drain(..).collect();
        if let (Some(first), Some(last)) = (jobs.first(), jobs.last()) {
            let settled = self.wait_for(last);
            settled.inspect_err(|_| self.give_up(first.iteration))?;
        }
        self.repeated += jobs.len() as u64;
        let mut needed = Some(instances);
        for job in &mut jobs {
            if let Err(error) = self.repeat_one(job, &mut needed) {
                self.give_up(job.iteration);
                return Err(error);
            }
        }
        Ok(())
    }

    /// Runs one step until it has room; `needed`: tile instances to make room for before it.
    fn repeat_one(&mut self, job: &mut Job, needed: &mut Option<u64>) -> Result<()> {
        loop {
            if let Some(instances) = needed.take() {
                self.grow(instances)?;
            }
            self.launch(job)?;
            self.wait_for(job)?;
            match self.read_back(job)? {
                Outcome::Applied(report) => return self.finish(job, report),
                Outcome::NoRoom(instances) => *needed = Some(instances),
            }
        }
    }

    /// After an error at `iteration`: the run stands where it was before it.
    fn give_up(&mut self, iteration: u64) {
        if let Some(last) = self.flying.back() {
            // The error that is reported came first.
            let _ = self.gpu.wait(last.submission);
        }
        self.flying.clear();
        self.iteration = iteration - 1;
        // Nor is there a failure before the next step, if there is one.
        let _ = self.clear_failure();
    }

    /// What a finished step left.
    fn read_back(&self, job: &Job) -> Result<Outcome> {
        let mut bytes = vec![0; READBACK_BYTES as usize];
        self.slots[job.slot].readback.read(0, &mut bytes)?;
        let words: Vec<u32> = bytemuck::pod_collect_to_vec(&bytes);
        let word = |part: usize, i: u32| words[(READBACK[part] / 4) as usize + i as usize];
        let float = |part: usize, i: u32| f64::from(f32::from_bits(word(part, i)));
        let instances = u64::from(word(0, COUNT_INSTANCES_HIGH)) << 32 | u64::from(word(0, COUNT_INSTANCES_LOW));
        if word(0, COUNT_FAILED) != 0 {
            return Ok(Outcome::NoRoom(instances));
        }
        let reports = |part: usize| &words[(READBACK[part] / 4) as usize..][..status::STATUS_WORDS];
        if let Some((group, count, index)) = status::first(&status::joined(reports(3), reports(4))) {
            let what = format!("{group} at iteration {} ({count} not finite), first", job.iteration);
            return Err(Error::NonFinite { what, index: index as usize, value: "not finite".into() });
        }
        let c = &self.config.loss;
        let has_property = self.deformation.as_ref().is_some_and(|m| m.property_loss().is_some());
        let property = if has_property { [0, 1, 2].map(|i| float(2, i)) } else { [0.0; 3] };
        // A mean over all pixels; those that a mask leaves out have no error.
        let mse = float(1, 3) / self.photos.share(job.view).max(1e-9);
        let weights = [c.lambda_position, c.lambda_rotation, c.lambda_translation].map(f64::from);
        Ok(Outcome::Applied(StepReport {
            iteration: job.iteration,
            view: self.pyramid.photo(job.view),
            loss: float(1, 0) + property.iter().zip(weights).map(|(p, w)| p * w).sum::<f64>(),
            l1: float(1, 1),
            ssim: float(1, 2),
            psnr: -10.0 * mse.max(1e-30).log10(),
            property,
            gaussians: self.parameters.count(),
            superpoints: self.superpoints(),
            visible: word(0, COUNT_VISIBLE),
            instances,
            rejected: word(0, COUNT_REJECTED),
        }))
    }
}
