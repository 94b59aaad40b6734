//! Recorded command buffers: encoding, submission, waiting, timings, breadcrumbs.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use ash::vk;

use super::access::Use;
use super::device::{Gpu, vk_error};
use super::kernel::Kernel;
use super::memory::{Buffer, Memory};
use super::options;
use super::sequence::{Encoding, Sequence};
use super::timestamps::Timing;
use crate::error::{Error, Result};

/// A submission, in order; wait for it with [`Gpu::wait`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub struct Submission(pub(super) u64);

/// A recorded command buffer with everything that it uses.
pub struct Commands {
    sequence: Sequence,
    pool: vk::CommandPool,
    raw: vk::CommandBuffer,
    /// With timestamps, where `raw` has none; made when it is first asked for.
    timed: Option<vk::CommandBuffer>,
    on_request: bool,
    /// Whether the latest submission took timestamps.
    was_timed: bool,
    breadcrumbs: Option<Buffer>,
    /// What the host writes or reads of what they use.
    mapped: Vec<Buffer>,
    last: Submission,
}

impl std::fmt::Debug for Commands {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Commands({}, {} operations)", self.sequence.name, self.sequence.operations.len())
    }
}

impl Commands {
    /// Encodes a sequence in a command buffer of its own; `on_request`: timestamps only where a submission asks for them.
    pub(super) fn encode(sequence: Sequence, on_request: bool) -> Result<Self> {
        let shared = &sequence.gpu;
        let breadcrumbs = if shared.options.breadcrumbs {
            let bytes = 4 * sequence.operations.len() as u64;
            Some(Gpu(Arc::clone(shared), None).buffer("breadcrumbs", bytes, Memory::Readback)?)
        } else {
            None
        };
        let (pool, raw) = encode_alone(&sequence, 0, !on_request, breadcrumbs.as_ref(), &[])?;
        let mapped = sequence.mapped();
        let (timed, was_timed, last) = (None, false, Submission(0));
        Ok(Self { sequence, pool, raw, timed, on_request, was_timed, breadcrumbs, mapped, last })
    }

    /// The command buffer of a submission.
    fn buffer(&mut self, timed: bool) -> Result<vk::CommandBuffer> {
        self.was_timed = timed || !self.on_request;
        match self.timed {
            Some(raw) if timed => Ok(raw),
            None if timed && self.on_request => {
                let raw = encode_in(&self.sequence, self.pool, 0, true, self.breadcrumbs.as_ref(), &[])?;
                self.timed = Some(raw);
                Ok(raw)
            }
            _ => Ok(self.raw),
        }
    }

    /// The barrier plan.
    pub fn plan(&self) -> &str {
        self.sequence.plan()
    }

    /// Number of dispatches.
    pub fn dispatches(&self) -> usize {
        self.sequence.dispatches()
    }

    /// Number of barriers, the one at the beginning included.
    pub fn barriers(&self) -> usize {
        self.sequence.barriers()
    }

    /// Labels and kernels of the dispatches, in order.
    pub fn kernels(&self) -> Vec<(&str, &'static Kernel)> {
        self.sequence.kernels()
    }

    /// Push constants of the dispatches, in the order of [`Commands::kernels`].
    pub fn push_constants(&self) -> Vec<&[u8]> {
        self.sequence.push_constants()
    }

    pub(super) fn recorded_operations(&self) -> &[super::operation::Operation] {
        &self.sequence.operations
    }

    /// Which bytes each operation touches, for tests of the plan.
    pub fn uses(&self) -> Vec<(&str, &[Use], bool)> {
        self.sequence.uses()
    }

    /// The latest submission of these commands.
    pub fn submission(&self) -> Submission {
        self.last
    }

    /// Device time of each operation in the latest finished submission; empty without timestamps.
    pub fn timings(&self) -> Result<Vec<Timing>> {
        if self.was_timed { self.sequence.timings(0) } else { Ok(Vec::new()) }
    }

    /// [`Commands::timings`] one by one: label and microseconds. Allocates nothing.
    pub fn each_timing(&self, each: impl FnMut(&str, f64)) -> Result<()> {
        if self.was_timed { self.sequence.each_timing(0, each) } else { Ok(()) }
    }

    /// Last finished and next operation, from the breadcrumbs.
    fn trace(&self) -> (String, String) {
        let Some(buffer) = &self.breadcrumbs else {
            return ("unknown (breadcrumbs are off; set SPGS_BREADCRUMBS=1)".into(), "unknown".into());
        };
        let mut bytes = vec![0_u8; 4 * self.sequence.operations.len()];
        if buffer.read(0, &mut bytes).is_err() {
            return ("unknown".into(), "unknown".into());
        }
        let started = bytes.chunks_exact(4).take_while(|w| w[0] == 1).count();
        let name = |i: usize| self.sequence.operations.get(i).map_or("none".to_owned(), |o| o.label.clone());
        match started {
            0 => ("none".into(), name(0)),
            n => (if n > 1 { name(n - 2) } else { "none".into() }, name(n - 1)),
        }
    }

    fn timed_out(&self, seconds: f64) -> Error {
        let (last_kernel, next_kernel) = self.trace();
        Error::TimedOut { seconds, label: self.sequence.name.clone(), last_kernel, next_kernel }
    }

    fn device_lost(&self) -> Error {
        let (last_kernel, next_kernel) = self.trace();
        Error::DeviceLost { submission: self.last.0, label: self.sequence.name.clone(), last_kernel, next_kernel }
    }
}

/// A command pool with one command buffer that holds the sequence; images are left out.
fn encode_alone(
    sequence: &Sequence,
    slot: u32,
    timed: bool,
    breadcrumbs: Option<&Buffer>,
    updates: &[&[u8]],
) -> Result<(vk::CommandPool, vk::CommandBuffer)> {
    let device = &sequence.gpu.device;
    let create = vk::CommandPoolCreateInfo::default().queue_family_index(sequence.gpu.family);
    // SAFETY: plain creation.
    let pool = unsafe { device.create_command_pool(&create, None) }.map_err(vk_error("vkCreateCommandPool"))?;
    let made = encode_in(sequence, pool, slot, timed, breadcrumbs, updates);
    if made.is_err() {
        // SAFETY: never submitted.
        unsafe { device.destroy_command_pool(pool, None) };
    }
    Ok((pool, made?))
}

/// A command buffer of a pool that holds the sequence. The pool frees it.
fn encode_in(
    sequence: &Sequence,
    pool: vk::CommandPool,
    slot: u32,
    timed: bool,
    breadcrumbs: Option<&Buffer>,
    updates: &[&[u8]],
) -> Result<vk::CommandBuffer> {
    let device = &sequence.gpu.device;
    let allocate = vk::CommandBufferAllocateInfo::default().command_pool(pool).command_buffer_count(1);
    // SAFETY: nobody else uses the pool.
    let raw = unsafe { device.allocate_command_buffers(&allocate) }.map_err(vk_error("vkAllocateCommandBuffers"))?[0];
    let begin = vk::CommandBufferBeginInfo::default();
    // SAFETY: just allocated.
    unsafe { device.begin_command_buffer(raw, &begin) }.map_err(vk_error("vkBeginCommandBuffer"))?;
    let images = vec![None; sequence.images()];
    sequence.encode_with(&Encoding { raw, slot, timed, breadcrumbs, updates, images: &images })?;
    // SAFETY: recording.
    unsafe { device.end_command_buffer(raw) }.map_err(vk_error("vkEndCommandBuffer"))?;
    Ok(raw)
}

impl Gpu {
    /// Runs a sequence once on the engine's queue, without its images, and waits for it.
    pub fn execute(&self, sequence: &Sequence, slot: u32, updates: &[&[u8]]) -> Result<()> {
        let (pool, raw) = encode_alone(sequence, slot, true, None, updates)?;
        let finished = self.submit_raw(raw).and_then(|submission| self.wait(submission));
        if finished.is_err() {
            let _ = self.0.settle();
        }
        // SAFETY: not pending any more.
        unsafe { self.0.device.destroy_command_pool(pool, None) };
        finished
    }

    /// Submits a command buffer that signals the next value of the timeline.
    fn submit_raw(&self, raw: vk::CommandBuffer) -> Result<Submission> {
        let shared = &self.0;
        let queue = shared.lock_queue();
        let value = shared.submissions.load(Ordering::SeqCst) + 1;
        let (buffers, semaphores, values) = ([raw], [shared.timeline], [value]);
        let mut timeline = vk::TimelineSemaphoreSubmitInfo::default().signal_semaphore_values(&values);
        let submit = [vk::SubmitInfo::default()
            .command_buffers(&buffers)
            .signal_semaphores(&semaphores)
            .push_next(&mut timeline)];
        // SAFETY: the command buffer is recorded and not pending; the queue is locked.
        match unsafe { shared.device.queue_submit(*queue, &submit, vk::Fence::null()) } {
            Ok(()) => {
                shared.submissions.store(value, Ordering::SeqCst);
                Ok(Submission(value))
            }
            Err(code) => Err(self.vulkan_error("vkQueueSubmit", code)),
        }
    }

    /// Submits recorded commands; several may be in flight. The same commands submitted again wait for their last run.
    pub fn submit(&self, commands: &mut Commands) -> Result<Submission> {
        self.submit_either(commands, false)
    }

    /// [`Gpu::submit`] with timestamps, of commands that were recorded for them.
    pub fn submit_timed(&self, commands: &mut Commands) -> Result<Submission> {
        self.submit_either(commands, true)
    }

    fn submit_either(&self, commands: &mut Commands, timed: bool) -> Result<Submission> {
        let shared = &self.0;
        self.wait_for(commands)?;
        let injected = shared.lose_at.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |n| n.checked_sub(1)) == Ok(1);
        if shared.lost.load(Ordering::SeqCst) {
            return Err(commands.device_lost());
        }
        if let Some(buffer) = &commands.breadcrumbs {
            buffer.clear_readback()?;
        }
        let raw = commands.buffer(timed)?;
        match self.submit_raw(raw) {
            Ok(submission) => commands.last = submission,
            Err(Error::DeviceLost { .. }) => return Err(commands.device_lost()),
            Err(error) => return Err(error),
        }
        commands.mapped.iter().for_each(|buffer| buffer.used_by(commands.last));
        if injected {
            // The work runs first, so that the report is made from breadcrumbs that the device left.
            self.wait(commands.last)?;
            shared.lost.store(true, Ordering::SeqCst);
            options::note_loss();
            return Err(commands.device_lost());
        }
        Ok(commands.last)
    }

    /// Waits for the latest submission of these commands; a lost device names the last finished kernel.
    pub fn wait_for(&self, commands: &Commands) -> Result<()> {
        self.wait(commands.last).map_err(|error| match error {
            Error::DeviceLost { .. } => commands.device_lost(),
            Error::TimedOut { seconds, .. } => commands.timed_out(seconds),
            other => other,
        })
    }

    /// Waits for a submission. The time-out of [`super::GpuOptions`] counts from the last submission that finished, so a long
    /// queue may take as long as it needs.
    pub fn wait(&self, submission: Submission) -> Result<()> {
        if submission.0 == 0 {
            return Ok(());
        }
        if submission.0 == self.0.submissions.load(Ordering::SeqCst) {
            self.0.newest_waits.fetch_add(1, Ordering::SeqCst);
        }
        let semaphores = [self.0.timeline];
        let values = [submission.0];
        let wait = vk::SemaphoreWaitInfo::default().semaphores(&semaphores).values(&values);
        let timeout = (self.0.options.timeout_s.clamp(0.001, 1e6) * 1e9) as u64;
        let mut finished = self.finished()?;
        loop {
            // SAFETY: the semaphore is live.
            match unsafe { self.0.device.wait_semaphores(&wait, timeout) } {
                Ok(()) => return Ok(()),
                Err(vk::Result::TIMEOUT) if self.finished()? > finished => finished = self.finished()?,
                Err(vk::Result::TIMEOUT) => {
                    let (seconds, unknown) = (self.0.options.timeout_s, || "unknown".to_owned());
                    let label = format!("submission {}", submission.0);
                    return Err(Error::TimedOut { seconds, label, last_kernel: unknown(), next_kernel: unknown() });
                }
                Err(code) => return Err(self.vulkan_error("vkWaitSemaphores", code)),
            }
        }
    }

    /// How often the newest submission was waited for: the device had nothing else to do when it ended.
    pub fn newest_waits(&self) -> u64 {
        self.0.newest_waits.load(Ordering::SeqCst)
    }

    /// Number of the last submission that has finished.
    fn finished(&self) -> Result<u64> {
        self.0.finished().map_err(|code| self.vulkan_error("vkGetSemaphoreCounterValue", code))
    }

    /// Whether a submission has finished.
    pub fn is_finished(&self, submission: Submission) -> Result<bool> {
        Ok(self.finished()? >= submission.0)
    }

    /// Whether the device has counted all submissions, once they were waited for.
    pub(crate) fn counts_submissions(&self) -> Result<bool> {
        Ok(self.finished()? >= self.0.submissions.load(Ordering::SeqCst))
    }

    /// Turns a result code into an error; device loss is remembered.
    pub(super) fn vulkan_error(&self, call: &'static str, code: vk::Result) -> Error {
        if code == vk::Result::ERROR_DEVICE_LOST {
            self.0.lost.store(true, Ordering::SeqCst);
            options::note_loss();
            let unknown = || "unknown".to_owned();
            let submission = self.0.submissions.load(Ordering::SeqCst);
            return Error::DeviceLost {
                submission,
                label: call.into(),
                last_kernel: unknown(),
                next_kernel: unknown(),
            };
        }
        vk_error(call)(code)
    }
}

impl Drop for Commands {
    fn drop(&mut self) {
        let gpu = Gpu(Arc::clone(&self.sequence.gpu), None);
        if let Err(error) = gpu.wait(self.last) {
            log::error!("dropping `{}`: {error}", self.sequence.name);
            // Too slow is not finished: what it uses may only be freed once the device is idle or lost.
            let _ = self.sequence.gpu.settle();
        }
        // SAFETY: not pending any more; null handles are ignored.
        unsafe { self.sequence.gpu.device.destroy_command_pool(self.pool, None) };
    }
}
