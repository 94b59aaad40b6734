//! Turns of the window's event loop: a frame in each while something moves, and what they allocate.

use std::sync::OnceLock;

/// Says how many allocations the program has made until now. Set before [`super::run`] by programs that count them; what
/// frames allocate is then in the report of `--json`.
pub static ALLOCATIONS: OnceLock<fn() -> usize> = OnceLock::new();

/// Host allocations, of all threads, of turns with a frame in which nothing was done to the window and its interface did not run.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Allocations {
    /// Such turns.
    pub(super) frames: u64,
    /// Of these, those that allocated.
    pub(super) allocating: u64,
    pub(super) allocations: usize,
}

/// One pass of the event loop: events, at most one frame, a wait.
#[derive(Debug, Default)]
pub(super) struct Turn {
    /// A frame is due in this turn though nobody asked for it.
    again: bool,
    drawn: bool,
    /// Something happened that is not a frame.
    eventful: bool,
    interface_runs: u64,
    counted: Option<usize>,
    allocations: Allocations,
}

impl Turn {
    pub(super) fn begin(&mut self) {
        self.drawn = false;
    }

    /// Something happened to the window.
    pub(super) fn event(&mut self) {
        self.eventful = true;
    }

    /// The next turn draws. Asking the window for a redraw instead would go through its queue, which allocates.
    pub(super) fn draw_again(&mut self, again: bool) {
        self.again = again;
    }

    /// A frame was drawn.
    pub(super) fn drew(&mut self) {
        self.drawn = true;
    }

    /// Whether a frame is to be drawn at the end of this turn.
    pub(super) fn is_due(&self) -> bool {
        self.again && !self.drawn
    }

    /// Counts what was allocated since the end of the turn before.
    pub(super) fn end(&mut self, interface_runs: u64) {
        let Some(count) = ALLOCATIONS.get() else { return };
        let now = count();
        let quiet = self.drawn && !self.eventful && interface_runs == self.interface_runs;
        if let (Some(before), true) = (self.counted, quiet) {
            let all = &mut self.allocations;
            all.frames += 1;
            all.allocating += u64::from(now > before);
            all.allocations += now - before;
        }
        (self.counted, self.interface_runs, self.eventful) = (Some(now), interface_runs, false);
    }

    /// Forgets what was counted: while a model is read, another thread allocates.
    pub(super) fn count_anew(&mut self) {
        self.allocations = Allocations::default();
    }

    /// What was counted, if the program counts.
    pub(super) fn allocations(&self) -> Option<Allocations> {
        ALLOCATIONS.get().map(|_| self.allocations)
    }
}
