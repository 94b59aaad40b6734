//! Decoded pictures, ahead of their use.
//!
//! Workers decode what was announced with [`ImageLoader::prefetch`]; decoded pictures stay until the byte budget is
//! needed for others, least recently used first. A data set that fits stays decoded; a larger one streams from its files.
//! What [`ImageLoader::get`] returns depends on the files alone, never on the workers' timing.

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use super::dataset::View;
use super::pixels::Pixels;
use crate::error::{Error, Result};

/// A cache of decoded pictures with worker threads.
#[derive(Debug)]
pub struct ImageLoader {
    shared: Arc<Shared>,
    workers: Vec<JoinHandle<()>>,
}

#[derive(Debug)]
struct Shared {
    views: Arc<[View]>,
    budget: u64,
    /// Whether masks are looked at.
    for_training: bool,
    state: Mutex<State>,
    /// Signalled when there may be work, or room for it.
    work: Condvar,
    /// Signalled when a picture is done.
    done: Condvar,
}

#[derive(Debug, Default)]
struct State {
    slots: HashMap<usize, Slot>,
    /// Announced, not begun.
    queue: VecDeque<usize>,
    /// Bytes of the decoded pictures and of those being decoded.
    bytes: u64,
    clock: u64,
    closed: bool,
}

#[derive(Debug)]
enum Slot {
    /// A worker decodes it.
    Running,
    Ready {
        pixels: Arc<Pixels>,
        /// When it was last handed out.
        used: u64,
        /// Announced and not handed out yet: not given up for another announced picture.
        waited_for: bool,
    },
    /// Handed out by the next `get`, which then tries again.
    Failed(Error),
}

impl ImageLoader {
    /// A loader of `views` that keeps at most `budget_bytes` of decoded pictures, beside those that callers hold and one
    /// per thread that is being decoded. With no workers, pictures are decoded where they are asked for.
    ///
    /// # Errors
    /// [`Error::Io`] when a thread cannot be started.
    pub fn new(views: Arc<[View]>, budget_bytes: u64, workers: usize) -> Result<Self> {
        Self::begin(views, budget_bytes, workers, false)
    }

    /// The same, of pictures as training sees them ([`ImageSource::decode_for_training`](super::pixels::ImageSource)).
    ///
    /// # Errors
    /// As [`ImageLoader::new`].
    pub fn for_training(views: Arc<[View]>, budget_bytes: u64, workers: usize) -> Result<Self> {
        Self::begin(views, budget_bytes, workers, true)
    }

    fn begin(views: Arc<[View]>, budget: u64, workers: usize, for_training: bool) -> Result<Self> {
        let (work, done) = (Condvar::new(), Condvar::new());
        let shared = Arc::new(Shared { views, budget, for_training, state: Mutex::default(), work, done });
        let mut loader = Self { shared, workers: Vec::with_capacity(workers) };
        for i in 0..workers {
            let shared = Arc::clone(&loader.shared);
            let thread = std::thread::Builder::new().name(format!("decode-{i}")).spawn(move || shared.run());
            loader.workers.push(thread.map_err(|e| Error::io("image decoder".as_ref(), "start a thread", e))?);
        }
        Ok(loader)
    }

    /// The views that are loaded.
    pub fn views(&self) -> &Arc<[View]> {
        &self.shared.views
    }

    /// Announces pictures, soonest needed first. What is decoded, announced already or out of range is passed over.
    pub fn prefetch(&self, indices: &[usize]) {
        if self.workers.is_empty() {
            return;
        }
        let mut state = self.shared.lock();
        let queued = state.queue.len();
        for &index in indices {
            if let Some(Slot::Ready { waited_for, .. }) = state.slots.get_mut(&index) {
                *waited_for = true;
            } else if index < self.shared.views.len()
                && !state.slots.contains_key(&index)
                && !state.queue.contains(&index)
            {
                state.queue.push_back(index);
            }
        }
        // Workers are not woken for nothing.
        if state.queue.len() > queued {
            drop(state);
            self.shared.work.notify_all();
        }
    }

    /// Gives up a decoded picture that will not be asked for again.
    pub fn forget(&self, index: usize) {
        let mut state = self.shared.lock();
        let ready = |slot: &Slot| if let Slot::Ready { pixels, .. } = slot { Some(pixels.bytes()) } else { None };
        if let Some(bytes) = state.slots.get(&index).and_then(ready) {
            state.bytes -= bytes;
            state.slots.remove(&index);
        }
        self.shared.wake_one(&state);
    }

    /// The picture of view `index`: from memory, from the worker that is at it, or decoded here.
    ///
    /// # Errors
    /// Those of decoding, naming the file; [`Error::Usage`] for an index out of range.
    pub fn get(&self, index: usize) -> Result<Arc<Pixels>> {
        let shared = &*self.shared;
        let Some(view) = shared.views.get(index) else {
            return Err(Error::usage("view", index.to_string(), format!("less than {}", shared.views.len())));
        };
        let mut state = shared.lock();
        loop {
            match state.slots.get(&index) {
                Some(Slot::Running) => state = shared.done.wait(state).unwrap_or_else(PoisonError::into_inner),
                Some(Slot::Ready { .. }) => {
                    let pixels = state.hand_out(index);
                    shared.wake_one(&state);
                    drop(state);
                    if let Some(pixels) = pixels {
                        return Ok(pixels);
                    }
                    state = shared.lock();
                }
                Some(Slot::Failed(_)) => {
                    if let Some(Slot::Failed(error)) = state.slots.remove(&index) {
                        return Err(error);
                    }
                }
                None => break,
            }
        }
        // Not begun: decoded here rather than behind what is queued.
        state.queue.retain(|&i| i != index);
        state.slots.insert(index, Slot::Running);
        let need = view.image.decoded_bytes();
        state.bytes += need;
        state.make_room(shared.budget, true);
        drop(state);
        match shared.decode(index) {
            Ok(pixels) => Ok(shared.keep(index, pixels, false)),
            Err(error) => {
                shared.fail(index, need, None);
                Err(error)
            }
        }
    }

    /// Bytes of decoded pictures in memory.
    pub fn bytes(&self) -> u64 {
        self.shared.lock().bytes
    }
}

impl Drop for ImageLoader {
    fn drop(&mut self) {
        self.shared.lock().closed = true;
        self.shared.work.notify_all();
        for worker in self.workers.drain(..) {
            // A worker that panicked has reported it; there is nothing left to do here.
            let _ = worker.join();
        }
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A worker: takes announced pictures while there is room for them.
    fn run(&self) {
        let mut state = self.lock();
        while !state.closed {
            let Some((index, need)) = state.next_job(self) else {
                state = self.work.wait(state).unwrap_or_else(PoisonError::into_inner);
                continue;
            };
            drop(state);
            match self.decode(index) {
                Ok(pixels) => drop(self.keep(index, pixels, true)),
                Err(error) => self.fail(index, need, Some(error)),
            }
            state = self.lock();
        }
    }

    /// A decoder that panics is an error of that picture, not a `get` that waits for ever.
    fn decode(&self, index: usize) -> Result<Pixels> {
        let image = &self.views[index].image;
        let decode = || if self.for_training { image.decode_for_training() } else { image.decode() };
        std::panic::catch_unwind(decode)
            .unwrap_or_else(|_| Err(Error::corrupt(&image.path, "content", "a decoder panic", "a valid image")))
    }

    /// Keeps a decoded picture as the budget allows.
    fn keep(&self, index: usize, pixels: Pixels, waited_for: bool) -> Arc<Pixels> {
        let pixels = Arc::new(pixels);
        let mut state = self.lock();
        state.clock += 1;
        let slot = Slot::Ready { pixels: Arc::clone(&pixels), used: state.clock, waited_for };
        state.slots.insert(index, slot);
        state.make_room(self.budget, !waited_for);
        self.announce(state);
        pixels
    }

    /// Ends a failed picture; a worker leaves the error for `get`.
    fn fail(&self, index: usize, need: u64, error: Option<Error>) {
        let mut state = self.lock();
        state.bytes -= need;
        state.slots.remove(&index);
        state.slots.extend(error.map(|e| (index, Slot::Failed(e))));
        self.announce(state);
    }

    /// There may be room for a picture that waits.
    fn wake_one(&self, state: &State) {
        if !state.queue.is_empty() {
            self.work.notify_one();
        }
    }

    fn announce(&self, state: MutexGuard<'_, State>) {
        drop(state);
        self.done.notify_all();
        self.work.notify_one();
    }
}

impl State {
    /// Takes the first announced picture if it fits beside those that are waited for.
    fn next_job(&mut self, shared: &Shared) -> Option<(usize, u64)> {
        let index = *self.queue.front()?;
        let need = shared.views[index].image.decoded_bytes();
        self.bytes += need;
        self.make_room(shared.budget, false);
        if self.bytes > shared.budget {
            self.bytes -= need;
            return None;
        }
        self.queue.pop_front();
        self.slots.insert(index, Slot::Running);
        Some((index, need))
    }

    fn hand_out(&mut self, index: usize) -> Option<Arc<Pixels>> {
        self.clock += 1;
        let now = self.clock;
        match self.slots.get_mut(&index) {
            Some(Slot::Ready { pixels, used, waited_for }) => {
                (*used, *waited_for) = (now, false);
                Some(Arc::clone(pixels))
            }
            _ => None,
        }
    }

    /// Gives up pictures, least recently used first, until the budget holds; those that are waited for only if `all`.
    fn make_room(&mut self, budget: u64, all: bool) {
        while self.bytes > budget {
            let given_up = self
                .slots
                .iter()
                .filter_map(|(&index, slot)| match slot {
                    Slot::Ready { pixels, used, waited_for } if all || !waited_for => {
                        Some((*waited_for, *used, index, pixels.bytes()))
                    }
                    _ => None,
                })
                .min();
            let Some((_, _, index, bytes)) = given_up else { return };
            self.slots.remove(&index);
            self.bytes -= bytes;
        }
    }
}

#[cfg(test)]
mod tests;
