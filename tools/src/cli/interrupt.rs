//! Ctrl-C and SIGTERM while something is made that must not stay half done.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use super::output;

/// Exit code of a process that Ctrl-C ended (128 + SIGINT).
pub(crate) const CODE: i32 = 130;

/// Whether the program is asked to end.
#[derive(Debug, Clone, Default)]
pub(crate) struct Interrupt {
    asked: Arc<AtomicBool>,
    /// What the signal that ends the program says.
    last_words: Arc<OnceLock<String>>,
}

impl Interrupt {
    /// Takes such signals from now on; the second one ends the program at once. `without` says what happens where they cannot
    /// be taken.
    pub(crate) fn watch(without: &str) -> Self {
        let interrupt = Self::default();
        let (asked, last_words) = (Arc::clone(&interrupt.asked), Arc::clone(&interrupt.last_words));
        let handler = move || {
            if asked.swap(true, Ordering::Relaxed) {
                last_words.get().into_iter().for_each(|words| output::error_line(words));
                std::process::exit(CODE);
            }
        };
        if let Err(e) = ctrlc::set_handler(handler) {
            log::warn!("{without}: {e}");
        }
        interrupt
    }

    /// The next signal ends the program at once, with these words, if any: nothing is half done any more.
    pub(crate) fn end_at_next(&self, last_words: Option<String>) {
        last_words.into_iter().for_each(|words| _ = self.last_words.set(words));
        self.asked.store(true, Ordering::Relaxed);
    }

    pub(crate) fn is_set(&self) -> bool {
        self.asked.load(Ordering::Relaxed)
    }
}
