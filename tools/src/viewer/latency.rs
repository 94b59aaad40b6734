//! From input to photon: how many frames, and how long, until a picture shows what was done. Fixed memory.

use std::time::Instant;

use engine::gpu::Submission;
use winit::event::{ElementState, WindowEvent};

use super::navigator::{Pose, Thrust};
use super::state::{Request, Selection, Settings, State};

/// Measured events that are remembered.
const MEASURED: usize = 1000;
/// Events that may wait for their picture.
const WAITING: usize = 256;

/// What input changes, before time passes; and what a picture shows of it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Visible {
    pose: Pose,
    goal: Pose,
    thrust: Thrust,
    /// Time that stands still; of a playing scene every picture is another.
    time: Option<f64>,
    settings: Settings,
    selection: Option<Selection>,
    picks: bool,
}

impl Visible {
    pub(super) fn of(state: &State, thrust: Thrust) -> Self {
        let moves = thrust.direction != glam::DVec3::ZERO;
        Self {
            pose: state.navigator.pose,
            goal: state.navigator.goal(),
            thrust: Thrust { fast: thrust.fast && moves, ..thrust },
            time: (!state.timeline.playing).then_some(state.timeline.time),
            settings: state.settings.clone(),
            selection: state.selection,
            picks: state.requests.iter().any(|r| matches!(r, Request::Pick(..))),
        }
    }

    /// Whether two pictures look the same.
    fn looks_like(&self, other: &Self) -> bool {
        let shown = |v: &Self| (v.pose, v.time, v.selection);
        shown(self) == shown(other) && self.settings == other.settings
    }
}

#[derive(Debug, Clone, Copy)]
struct Event {
    at: Instant,
    /// Frames that the device had finished then.
    finished: u64,
    /// It has changed something that can be seen.
    has_effect: bool,
    /// Frames from the event to the one that shows it, that one included, and its submission.
    shown: Option<(u32, Submission)>,
}

/// Events on their way to a picture, and how long others took.
#[derive(Debug)]
pub(super) struct Latency {
    waiting: Vec<Event>,
    presented: u64,
    buttons: u32,
    before: Option<Visible>,
    frames: [u32; MEASURED],
    ms: [f32; MEASURED],
    count: usize,
    most: (u32, f32),
}

/// The middle and the largest of what was measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Measured {
    pub(super) events: usize,
    /// Frames that were finished from the event to the one that shows it, that one included.
    pub(super) frames: [u32; 2],
    pub(super) ms: [f32; 2],
}

impl Default for Latency {
    fn default() -> Self {
        Self {
            waiting: Vec::with_capacity(WAITING),
            presented: 0,
            buttons: 0,
            before: None,
            frames: [0; MEASURED],
            ms: [0.0; MEASURED],
            count: 0,
            most: (0, 0.0),
        }
    }
}

impl Latency {
    /// What was measured, without what waits for frames of a device that is gone.
    pub(super) fn with_nothing_waiting(mut self) -> Self {
        self.waiting.clear();
        Self { presented: 0, before: None, ..self }
    }

    /// Whether an event may change the picture.
    pub(super) fn is_input(&mut self, event: &WindowEvent) -> bool {
        match event {
            WindowEvent::MouseInput { state: ElementState::Pressed, .. } => {
                self.buttons += 1;
                false
            }
            WindowEvent::MouseInput { state: ElementState::Released, .. } => {
                self.buttons = self.buttons.saturating_sub(1);
                true
            }
            WindowEvent::CursorMoved { .. } => self.buttons > 0,
            WindowEvent::KeyboardInput { event, .. } => event.state == ElementState::Pressed,
            WindowEvent::MouseWheel { .. } | WindowEvent::PinchGesture { .. } => true,
            _ => false,
        }
    }

    /// Takes an event at its handling, with `in_flight` frames not finished on the device.
    pub(super) fn take(&mut self, at: Instant, in_flight: u64) {
        if self.waiting.len() < WAITING {
            let finished = self.presented.saturating_sub(in_flight);
            self.waiting.push(Event { at, finished, has_effect: false, shown: None });
        }
    }

    /// The interface has taken all events until now and time has not passed yet: those that changed nothing are let go.
    pub(super) fn applied(&mut self, now: &Visible) {
        let changed = self.before.as_ref().is_some_and(|before| before != now);
        self.waiting.retain_mut(|e| {
            e.has_effect |= changed;
            e.has_effect
        });
    }

    /// A frame was presented that shows this.
    pub(super) fn presented(&mut self, now: Visible, submission: Submission) {
        self.presented += 1;
        if self.before.as_ref().is_some_and(|before| !before.looks_like(&now)) {
            for event in self.waiting.iter_mut().filter(|e| e.has_effect && e.shown.is_none()) {
                event.shown = Some(((self.presented - event.finished) as u32, submission));
            }
        }
        self.before = Some(now);
    }

    /// The device has finished these frames by now.
    pub(super) fn finished(&mut self, is_finished: impl Fn(Submission) -> bool) {
        let now = Instant::now();
        let Self { waiting, frames, ms, count, most, .. } = self;
        waiting.retain(|event| {
            let Some((after, _)) = event.shown.filter(|(_, s)| is_finished(*s)) else { return true };
            let passed = now.duration_since(event.at).as_secs_f32() * 1e3;
            (frames[*count % MEASURED], ms[*count % MEASURED]) = (after, passed);
            *count += 1;
            *most = (most.0.max(after), most.1.max(passed));
            false
        });
    }

    /// Nothing more will be drawn: what waits had no effect on the picture.
    pub(super) fn rest(&mut self) {
        self.waiting.retain(|e| e.shown.is_some());
    }

    /// What was measured; `None` before the first event.
    pub(super) fn measured(&self) -> Option<Measured> {
        let known = self.count.min(MEASURED);
        let (mut frames, mut ms) = (self.frames, self.ms);
        frames[..known].sort_unstable();
        ms[..known].sort_unstable_by(f32::total_cmp);
        let (median, ms) = (*frames[..known].get(known / 2)?, *ms[..known].get(known / 2)?);
        Some(Measured { events: self.count, frames: [median, self.most.0], ms: [ms, self.most.1] })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    /// A latency with one frame presented, and what it showed.
    fn started() -> (Latency, Visible) {
        let mut latency = Latency::default();
        let first = Visible::of(&super::super::first::test_state(), Thrust::default());
        latency.presented(first.clone(), Submission::default());
        (latency, first)
    }

    fn moved(v: &Visible) -> Visible {
        let pose = Pose { distance: 2.0 * v.pose.distance, ..v.pose };
        Visible { pose, goal: pose, ..v.clone() }
    }

    #[test]
    fn frames_are_counted_to_the_one_that_shows_the_event() {
        let (mut latency, first) = started();
        latency.take(Instant::now(), 1);
        latency.applied(&moved(&first));
        // The picture does not show it yet.
        latency.presented(first.clone(), Submission::default());
        latency.finished(|_| true);
        assert_eq!(latency.measured(), None);
        latency.presented(moved(&first), Submission::default());
        latency.finished(|_| false);
        assert_eq!(latency.measured(), None, "the device is not ready");
        latency.finished(|_| true);
        let measured = latency.measured().unwrap();
        // One that was in flight, one without, one with it.
        assert_eq!((measured.events, measured.frames), (1, [3, 3]));
        assert!(measured.ms[1] >= measured.ms[0] && measured.ms[0] >= 0.0);
    }

    #[test]
    fn events_without_effect_do_not_count() {
        let (mut latency, first) = started();
        latency.take(Instant::now(), 0);
        latency.applied(&first);
        latency.take(Instant::now(), 0);
        latency.applied(&moved(&first));
        latency.presented(moved(&first), Submission::default());
        latency.finished(|_| true);
        assert_eq!(latency.measured().map(|m| (m.events, m.frames)), Some((1, [1, 1])));
        latency.take(Instant::now(), 0);
        latency.applied(&first);
        latency.rest();
        latency.presented(first, Submission::default());
        latency.finished(|_| true);
        assert_eq!(latency.measured().unwrap().events, 1);
    }
}
