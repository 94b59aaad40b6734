//! Ctrl-C and SIGTERM while something is made that must not stay half done.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Exit code of a process that Ctrl-C ended (128 + SIGINT).
pub(crate) const CODE: i32 = 130;

/// Whether the program is asked to end.
#[derive(Debug, Clone, Default)]
pub(crate) struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    /// Takes such signals from now on; the second one ends the program at once. `without` says what happens where they cannot
    /// be taken.
    pub(crate) fn watch(without: &str) -> Self {
        let interrupt = Self::default();
        let flag = Arc::clone(&interrupt.0);
        let handler = move || {
            if flag.swap(true, Ordering::Relaxed) {
                std::process::exit(CODE);
            }
        };
        if let Err(e) = ctrlc::set_handler(handler) {
            log::warn!("{without}: {e}");
        }
        interrupt
    }

    /// The next signal ends the program at once: nothing is half done any more.
    pub(crate) fn end_at_next(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    pub(crate) fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}
