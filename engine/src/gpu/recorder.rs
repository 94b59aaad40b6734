//! Recording: a plain list of operations first; then barriers are derived, and the list becomes a command buffer that
//! can be submitted again and again.

use std::fmt::Write as _;

use super::access::{HazardTracker, Stages, Use};
use super::commands::Commands;
use super::device::Gpu;
use super::interface::{Buffers as _, Constants as _, Interface, KernelOf};
use super::kernel::{Access, Binding, Kernel};
use super::memory::{Buffer, Memory, Slice};
use super::operation::{Grid, Operation, Work};
use super::schedule::{CostOf, arrange};
use super::sequence::Sequence;
use crate::error::{Error, Result};

/// Alignment of slice starts: the largest `minStorageBufferOffsetAlignment` that the specification allows.
pub const SLICE_ALIGNMENT: u64 = 256;

/// How many workgroups a dispatch runs.
#[derive(Debug, Clone)]
pub enum Groups {
    /// That many, folded into two dimensions past 65,535; the kernel decodes `workgroup_index()` and checks bounds.
    Direct(u64),
    /// `x, y, z` read by the device from this buffer at this byte offset.
    Indirect(Buffer, u64),
}

/// Dispatches whose stand-ins for absent buffers do not overlap.
const ABSENT_PARTS: u64 = 64;

/// Collects operations; [`Recorder::finish`] turns them into [`Commands`].
pub struct Recorder {
    gpu: Gpu,
    name: String,
    profile: bool,
    /// Timestamps are taken by submissions that ask for them alone.
    on_request: bool,
    tracker: HazardTracker,
    operations: Vec<Operation>,
    begin_barrier: bool,
    /// Constants that were copied to the device.
    fetched: Vec<u64>,
    /// Stands in for absent buffers that a kernel could write: a part of it for each dispatch, so that none waits for another.
    absent: Option<Buffer>,
    /// Dispatches that had a part.
    absent_parts: u64,
    /// Operations are arranged by what they cost, so that independent ones run beside each other.
    cost: Option<CostOf>,
}

impl std::fmt::Debug for Recorder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Recorder({}, {} operations)", self.name, self.operations.len())
    }
}

impl Gpu {
    /// An empty recording.
    pub fn recorder(&self, name: &str) -> Recorder {
        Recorder {
            gpu: self.clone(),
            name: name.into(),
            profile: false,
            on_request: false,
            tracker: HazardTracker::default(),
            operations: Vec::new(),
            begin_barrier: true,
            fetched: Vec::new(),
            absent: None,
            absent_parts: 0,
            cost: None,
        }
    }

    /// Finishes, submits and waits.
    pub fn run(&self, recorder: Recorder) -> Result<Commands> {
        let mut commands = recorder.finish()?;
        self.submit(&mut commands)?;
        self.wait_for(&commands)?;
        Ok(commands)
    }
}

impl Recorder {
    /// Adds a timestamp after every operation.
    #[must_use]
    pub fn with_timestamps(mut self, profile: bool) -> Self {
        self.profile = profile && self.gpu.info().capabilities.timestamp_ns > 0.0;
        self
    }

    /// The same only in submissions that ask for it ([`Gpu::submit_timed`]).
    #[must_use]
    pub fn with_timestamps_on_request(mut self, profile: bool) -> Self {
        self.on_request = true;
        self.with_timestamps(profile)
    }

    /// Has independent operations run beside each other ([`schedule`](super::schedule)): they are encoded in another order than
    /// they were recorded in, with fewer barriers and the same results. Where times are taken, each runs alone.
    #[must_use]
    pub fn with_overlap(mut self, cost: CostOf) -> Self {
        self.cost = Some(cost);
        self
    }

    /// Fills a range with a 32-bit value.
    pub fn fill(&mut self, slice: impl Into<Slice>, value: u32) -> Result<()> {
        let slice = slice.into();
        check_range(&slice, 4, "fill")?;
        let uses = vec![access(&slice, Stages::TRANSFER, true)];
        self.push(format!("fill {}", slice.buffer.name()), Work::Fill { slice, value }, uses);
        Ok(())
    }

    /// Copies a range to one of the same length.
    pub fn copy(&mut self, source: impl Into<Slice>, destination: impl Into<Slice>) -> Result<()> {
        let (source, destination) = (source.into(), destination.into());
        check_range(&source, 1, "copy")?;
        check_range(&destination, 1, "copy")?;
        if source.bytes != destination.bytes {
            let what = format!("copy {} -> {}", source.buffer.name(), destination.buffer.name());
            return Err(Error::Limit { what, need: source.bytes.into(), have: destination.bytes.into() });
        }
        let label = format!("copy {}", source.buffer.name());
        let uses = vec![access(&source, Stages::TRANSFER, false), access(&destination, Stages::TRANSFER, true)];
        self.push(label, Work::Copy { source, destination, slot_bytes: 0 }, uses);
        Ok(())
    }

    /// [`Recorder::copy`] to a ring: in slot `s` of a [`Sequence`] the destination lies `s · slot_bytes` further.
    pub fn copy_to_slot(&mut self, source: impl Into<Slice>, destination: Slice, slot_bytes: u64) -> Result<()> {
        self.copy(source, destination)?;
        if let Some(Operation { work: Work::Copy { slot_bytes: bytes, .. }, .. }) = self.operations.last_mut() {
            *bytes = slot_bytes;
        }
        Ok(())
    }

    /// Writes bytes that are given anew each time that the [`Sequence`] is encoded; in slot `s`, `s · slot_bytes` further
    /// on. The bytes are part of the command buffer: no memory of the host is read later.
    pub fn update(&mut self, slice: impl Into<Slice>, slot_bytes: u64) -> Result<()> {
        let slice = slice.into();
        check_range(&slice, 4, "update")?;
        let uses = vec![access(&slice, Stages::TRANSFER, true)];
        self.push(format!("update {}", slice.name()), Work::Update { slice, slot_bytes }, uses);
        Ok(())
    }

    /// Copies tightly packed pixels to an image that is given each time that the [`Sequence`] is encoded.
    pub fn copy_to_image(&mut self, slice: impl Into<Slice>, size: [u32; 2], pixel_bytes: u64) -> Result<()> {
        let slice = slice.into();
        check_range(&slice, 4, "copy to image")?;
        let need = u64::from(size[0]) * u64::from(size[1]) * pixel_bytes;
        if need > slice.bytes {
            let what = format!("bytes of `{}` for an image", slice.name());
            return Err(Error::Limit { what, need: need.into(), have: slice.bytes.into() });
        }
        let uses = vec![access(&slice, Stages::TRANSFER, false)];
        self.push(format!("copy {} to image", slice.name()), Work::CopyToImage { slice, size }, uses);
        Ok(())
    }

    /// Makes what the device wrote to a read-back buffer visible to the host.
    pub fn host_read(&mut self, buffer: &Buffer) {
        debug_assert_eq!(buffer.memory(), Memory::Readback, "only read-back buffers are read by the host");
        let uses = vec![access(&Slice::from(buffer), Stages::HOST, false)];
        self.push(format!("host read {}", buffer.name()), Work::HostRead, uses);
    }

    /// Runs a kernel with constants, push constants and buffers by name. An image that it writes, and its push constants then,
    /// are given each time that the [`Sequence`] is encoded.
    pub fn dispatch<I: Interface>(
        &mut self,
        kernel: &'static KernelOf<I>,
        constants: I::Constants,
        push: I::Push,
        buffers: I::Buffers<Slice>,
        groups: Groups,
    ) -> Result<()> {
        self.dispatch_labelled(kernel.name, kernel, constants, push, buffers, groups)
    }

    /// [`Recorder::dispatch`] with a label of its own in timings and plan (for a kernel that runs several times).
    pub fn dispatch_labelled<I: Interface>(
        &mut self,
        label: &str,
        kernel: &'static KernelOf<I>,
        constants: I::Constants,
        push: I::Push,
        buffers: I::Buffers<Slice>,
        groups: Groups,
    ) -> Result<()> {
        let (spec, buffers) = (constants.to_words(), buffers.into_list());
        let to_image = kernel.buffers().1;
        let push = if to_image { &[] } else { bytemuck::bytes_of(&push) };
        self.record_dispatch(label, &kernel.kernel, &spec, push, &buffers, groups)
    }

    /// A dispatch without names: `spec` holds the specialisation constants from id 1 on. Of what is absent the watch, the
    /// barriers and the checks know nothing but that a kernel could write to its stand-in.
    pub(in crate::gpu) fn record_dispatch(
        &mut self,
        label: &str,
        kernel: &'static Kernel,
        spec: &[u32],
        push: &[u8],
        buffers: &[Option<Slice>],
        groups: Groups,
    ) -> Result<()> {
        let fail = |why: String| Err(Error::Kernel { kernel: kernel.name.into(), why });
        let (bindings, to_image) = kernel.buffers();
        if buffers.len() != bindings.len() {
            return fail(format!("{} buffers given, {} declared", buffers.len(), bindings.len()));
        }
        let push_bytes = if to_image { 0 } else { kernel.push_bytes() };
        if push.len() != push_bytes as usize {
            return fail(format!("{} bytes of push constants given, {push_bytes} expected", push.len()));
        }
        let slices = self.with_stand_ins(kernel, buffers)?;
        let mut uses = Vec::with_capacity(buffers.len() + 1);
        for (slice, binding) in buffers.iter().zip(bindings).filter_map(|(slice, b)| Some((slice.as_ref()?, b))) {
            self.check_binding(slice, binding.name, kernel)?;
            uses.push(access(slice, Stages::COMPUTE, binding.access != Access::Read));
        }
        for (i, u) in uses.iter().enumerate() {
            let clash = uses[..i]
                .iter()
                .any(|v| v.buffer == u.buffer && v.start < u.end && u.start < v.end && (v.write || u.write));
            if clash {
                return fail(format!("`{}` is bound twice and written", u.name));
            }
        }
        if let Some(absent) = slices.iter().find(|s| self.absent.as_ref().is_some_and(|a| a.id() == s.buffer.id())) {
            uses.push(access(absent, Stages::COMPUTE, true));
        }
        let grid = match groups {
            Groups::Direct(count) => Grid::Direct(self.fold(kernel, count)?),
            Groups::Indirect(buffer, offset) => {
                if !offset.is_multiple_of(4) || offset + 12 > buffer.bytes() {
                    return fail(format!("indirect offset {offset} of {} bytes", buffer.bytes()));
                }
                uses.push(access(&buffer.slice(offset, 12), Stages::INDIRECT, false));
                Grid::Indirect(buffer, offset)
            }
        };
        let pipeline = self.gpu.pipeline(kernel, spec)?;
        self.fetch_constants(&slices)?;
        // A host's image cannot be looked into.
        let watch = self.gpu.1.clone().filter(|_| !to_image);
        let gpu = self.gpu.clone();
        let before = watch.as_ref().map(|w| w.before(&gpu, self, kernel, buffers, &grid)).transpose()?;
        let work =
            Work::Dispatch { kernel, constants: spec.to_vec(), pipeline, push: push.to_vec(), slices, grid, to_image };
        self.push(label.to_owned(), work, uses);
        match (watch, before) {
            (Some(watch), Some(before)) => watch.after(&gpu, self, (label, kernel), (spec, push), buffers, before),
            _ => Ok(()),
        }
    }

    /// A descriptor needs a buffer: one that the kernel only reads stands in for an absent one that it would only read, one of
    /// the recording's own for those that it could write.
    fn with_stand_ins(&mut self, kernel: &Kernel, buffers: &[Option<Slice>]) -> Result<Vec<Slice>> {
        let read =
            |(slice, binding): (&Option<Slice>, &Binding)| slice.clone().filter(|_| binding.access == Access::Read);
        let stand_in = buffers.iter().zip(kernel.bindings).find_map(read);
        let mut slices = Vec::with_capacity(buffers.len());
        for (slice, binding) in buffers.iter().zip(kernel.bindings) {
            slices.push(match (slice, &stand_in) {
                (Some(slice), _) => slice.clone(),
                (None, _) if !binding.optional => {
                    let why = format!("no `{}` given", binding.name);
                    return Err(Error::Kernel { kernel: kernel.name.into(), why });
                }
                (None, Some(stand_in)) if binding.access == Access::Read => stand_in.clone(),
                _ => self.absent()?,
            });
        }
        self.absent_parts += 1;
        Ok(slices)
    }

    /// The part of this dispatch.
    fn absent(&mut self) -> Result<Slice> {
        let absent = match self.absent.take() {
            Some(absent) => absent,
            None => self.gpu.buffer("absent", ABSENT_PARTS * SLICE_ALIGNMENT, Memory::Device)?,
        };
        let part = absent.slice(self.absent_parts % ABSENT_PARTS * SLICE_ALIGNMENT, SLICE_ALIGNMENT);
        self.absent = Some(absent);
        Ok(part)
    }

    /// Copies to the device what the host has written elsewhere of these buffers, once in a recording.
    fn fetch_constants(&mut self, buffers: &[Slice]) -> Result<()> {
        for slice in buffers {
            if let Some(written) = slice.buffer.written()
                && !self.fetched.contains(&written.id())
            {
                self.fetched.push(written.id());
                self.copy(written, &slice.buffer)?;
            }
        }
        Ok(())
    }

    fn check_binding(&self, slice: &Slice, name: &str, kernel: &Kernel) -> Result<()> {
        check_range(slice, 4, name)?;
        if !slice.start.is_multiple_of(SLICE_ALIGNMENT) {
            let why = format!("`{name}` starts at byte {}, not a multiple of {SLICE_ALIGNMENT}", slice.start);
            return Err(Error::Kernel { kernel: kernel.name.into(), why });
        }
        let limit = self.gpu.info().capabilities.max_storage_buffer_range;
        if slice.bytes > limit {
            let what = format!("bytes of `{}` in one binding (maxStorageBufferRange)", slice.buffer.name());
            return Err(Error::Limit { what, need: slice.bytes.into(), have: limit.into() });
        }
        Ok(())
    }

    /// Folds a workgroup count into x and y.
    fn fold(&self, kernel: &Kernel, count: u64) -> Result<[u32; 3]> {
        let c = &self.gpu.info().capabilities;
        let max_x = u64::from(c.max_groups_x.min(65_535));
        let y = count.div_ceil(max_x).max(1);
        if y > u64::from(c.max_groups_y.min(65_535)) {
            let have = u128::from(max_x) * u128::from(c.max_groups_y.min(65_535));
            return Err(Error::Limit { what: format!("workgroups of `{}`", kernel.name), need: count.into(), have });
        }
        Ok([count.div_ceil(y) as u32, y as u32, 1])
    }

    fn push(&mut self, label: String, work: Work, uses: Vec<Use>) {
        if let (Some(watch), false) = (&self.gpu.1, matches!(work, Work::Dispatch { .. })) {
            uses.iter().filter(|u| u.write).for_each(|u| {
                watch.filled(u.buffer);
            });
        }
        let tagged = format!("#{} {label}", self.operations.len());
        let barrier = self.tracker.step(&tagged, &uses);
        self.operations.push(Operation { label, work, uses, barrier });
    }

    /// The subgroup size that a kernel is specialised for.
    pub fn subgroup_size_of(&self, kernel: &Kernel) -> u32 {
        self.gpu.subgroup_size_of(kernel)
    }

    /// Number of operations so far.
    pub fn len(&self) -> usize {
        self.operations.len()
    }

    /// Whether nothing was recorded.
    pub fn is_empty(&self) -> bool {
        self.operations.is_empty()
    }

    /// Test seam: drops the barrier before operation `index` (or, past the last, the one at the beginning), so that tests
    /// can show that the validation layer notices. Returns whether there was one. Not with [`Recorder::with_overlap`].
    pub fn omit_barrier(&mut self, index: usize) -> bool {
        match self.operations.get_mut(index) {
            Some(operation) => operation.barrier.take().is_some(),
            None => std::mem::replace(&mut self.begin_barrier, false),
        }
    }

    /// Encodes the list with its barriers.
    ///
    /// # Errors
    /// `Usage` when something is only known at encoding ([`Recorder::update`], [`Recorder::copy_to_image`], a kernel's image).
    pub fn finish(self) -> Result<Commands> {
        let on_request = self.on_request;
        Commands::encode(self.finish_sequence(1)?, on_request)
    }

    /// The list with its barriers and descriptor sets, to be written into other command buffers, `slots` of them in flight.
    pub fn finish_sequence(mut self, slots: u32) -> Result<Sequence> {
        for kept in self.gpu.1.as_ref().map(|watch| watch.buffers()).unwrap_or_default() {
            self.host_read(&kept);
        }
        if let Some(cost) = self.cost {
            self.operations = arrange(self.operations, cost);
        }
        let plan = plan(&self.operations, self.begin_barrier);
        let how = (self.profile, self.begin_barrier, self.cost.is_some(), slots);
        Sequence::new(&self.gpu, self.name, self.operations, plan, how)
    }
}

/// The barrier plan as text: one line per operation, with the barrier before it and why.
fn plan(operations: &[Operation], begin_barrier: bool) -> String {
    let mut text = String::from("begin");
    if begin_barrier {
        text.push_str(" | barrier ALL:W->ALL because of earlier submissions");
    }
    text.push('\n');
    for (index, operation) in operations.iter().enumerate() {
        let _ = write!(text, "#{index} {}", operation.label);
        if let Some(barrier) = &operation.barrier {
            let _ = write!(text, " | barrier {}", barrier.describe());
        }
        text.push('\n');
    }
    text
}

fn access(slice: &Slice, stage: Stages, write: bool) -> Use {
    Use {
        buffer: slice.buffer.id(),
        name: slice.name().to_owned(),
        start: slice.start,
        end: slice.start + slice.bytes,
        stage,
        write,
    }
}

fn check_range(slice: &Slice, alignment: u64, what: &str) -> Result<()> {
    let bad = slice.bytes == 0 || !slice.start.is_multiple_of(alignment) || !slice.bytes.is_multiple_of(alignment);
    if bad {
        let found = format!("bytes {}..{} of `{}`", slice.start, slice.start + slice.bytes, slice.buffer.name());
        return Err(Error::usage(what, found, format!("a non-empty range in multiples of {alignment}")));
    }
    Ok(())
}
