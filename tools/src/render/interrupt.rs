//! Ctrl-C and SIGTERM while a video is made: what is half done is taken away first.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Exit code of a program that was interrupted.
pub(super) const CODE: i32 = 130;

/// Whether the program is asked to end.
#[derive(Debug, Clone, Default)]
pub(super) struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    /// Takes such signals from now on; the second one ends the program at once.
    pub(super) fn watch() -> Self {
        let interrupt = Self::default();
        let flag = Arc::clone(&interrupt.0);
        let handler = move || {
            if flag.swap(true, Ordering::Relaxed) {
                std::process::exit(CODE);
            }
        };
        if let Err(e) = ctrlc::set_handler(handler) {
            log::debug!("Ctrl-C leaves an unfinished file: {e}");
        }
        interrupt
    }

    pub(super) fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}
