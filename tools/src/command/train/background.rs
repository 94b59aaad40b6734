//! Work that a run does not wait for: files and scores, done in the order in which they were given.

use std::thread::JoinHandle;

use engine::error::{Error, Result};

/// The work that is not known to be done.
#[derive(Debug, Default)]
pub(super) struct Background {
    last: Option<JoinHandle<Result<()>>>,
}

impl Background {
    /// Does `work` after all that was given before, if that went well.
    ///
    /// # Errors
    /// [`Error::Io`] when no thread can be started.
    pub(super) fn push(&mut self, work: impl FnOnce() -> Result<()> + Send + 'static) -> Result<()> {
        let before = self.last.take();
        let thread = std::thread::Builder::new().name("background".into()).spawn(move || {
            done(before)?;
            work()
        });
        self.last = Some(thread.map_err(|e| Error::io("background work".as_ref(), "start a thread", e))?);
        Ok(())
    }

    /// Waits until all is done.
    ///
    /// # Errors
    /// The first one of the work.
    pub(super) fn join(&mut self) -> Result<()> {
        done(self.last.take())
    }
}

impl Drop for Background {
    /// A run that ends with an error still finishes its files.
    fn drop(&mut self) {
        if let Err(error) = self.join() {
            log::error!("{error}");
        }
    }
}

fn done(thread: Option<JoinHandle<Result<()>>>) -> Result<()> {
    let Some(thread) = thread else { return Ok(()) };
    thread.join().unwrap_or_else(|_| Err(Error::usage("background work", "a panic", "none")))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;
    use std::sync::{Arc, Mutex};
    use std::time::Duration;

    #[test]
    fn work_is_done_in_order_and_the_first_error_is_told() {
        let done = Arc::new(Mutex::new(Vec::new()));
        let mut background = Background::default();
        for i in 0..4_u64 {
            let done = Arc::clone(&done);
            let work = move || {
                std::thread::sleep(Duration::from_millis(20 - 5 * i));
                done.lock().unwrap().push(i);
                if i == 2 { Err(Error::usage("work", i.to_string(), "another")) } else { Ok(()) }
            };
            background.push(work).unwrap();
        }
        assert!(matches!(background.join(), Err(Error::Usage { found, .. }) if found == "2"));
        assert_eq!(*done.lock().unwrap(), [0, 1, 2], "nothing goes on after an error");
        background.join().unwrap();
    }
}
