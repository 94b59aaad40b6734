//! Operations with their barriers and descriptor sets, ready to be written into a command buffer: the engine's own
//! ([`super::Commands`]) once, or a host's in every frame.

use std::collections::BTreeMap;
use std::sync::Arc;

use ash::vk;

use super::access::{Barrier, Stages};
use super::barrier::memory_barrier;
use super::device::{Gpu, Shared, Sync2, vk_error};
use super::host::{HostCommandBuffer, HostImage};
use super::memory::{Buffer, Slice};
use super::operation::{Grid, Operation, Work};
use super::pipeline::Pipeline;
use super::texels;
use super::timestamps::{Timing, ticks_between};
use crate::error::{Error, Result};

/// Images that one sequence can write.
const MAX_IMAGES: usize = 4;
/// Bytes that `vkCmdUpdateBuffer` takes at once.
const UPDATE_BYTES: usize = 65_536;

/// Recorded operations. Everything that encoding needs is made beforehand: writing them into a command buffer allocates
/// nothing.
pub struct Sequence {
    pub(super) gpu: Arc<Shared>,
    pub(super) name: String,
    pub(super) operations: Vec<Operation>,
    plan: String,
    begin_barrier: bool,
    /// Operations run beside each other, but where their times are taken.
    beside: bool,
    descriptors: vk::DescriptorPool,
    /// One per operation; null for what is no dispatch, or one to an image.
    sets: Vec<vk::DescriptorSet>,
    /// Of dispatches to images: operation, and a set per slot, written when it is encoded.
    image_sets: Vec<(usize, Vec<vk::DescriptorSet>)>,
    /// Of what dispatches read as texels.
    views: Vec<(u32, vk::BufferView)>,
    queries: vk::QueryPool,
    slots: u32,
}

impl std::fmt::Debug for Sequence {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Sequence({}, {} operations)", self.name, self.operations.len())
    }
}

/// What differs each time that a sequence is encoded.
#[derive(Clone, Copy)]
pub(super) struct Encoding<'a> {
    pub(super) raw: vk::CommandBuffer,
    pub(super) slot: u32,
    pub(super) timed: bool,
    pub(super) breadcrumbs: Option<&'a Buffer>,
    pub(super) updates: &'a [&'a [u8]],
    pub(super) images: &'a [Option<HostImage>],
}

impl Sequence {
    /// `slots`: how many encodings of it may be in flight, each with its own timestamps and its own place in buffers that
    /// are written by slot.
    pub(super) fn new(
        gpu: &Gpu,
        name: String,
        operations: Vec<Operation>,
        plan: String,
        (profile, begin_barrier, beside, slots): (bool, bool, bool, u32),
    ) -> Result<Self> {
        let mut sequence = Self {
            gpu: Arc::clone(&gpu.0),
            name,
            sets: vec![vk::DescriptorSet::null(); operations.len()],
            image_sets: Vec::new(),
            operations,
            plan,
            begin_barrier,
            beside,
            descriptors: vk::DescriptorPool::null(),
            views: Vec::new(),
            queries: vk::QueryPool::null(),
            slots: slots.max(1),
        };
        sequence.create_sets()?;
        if profile {
            let create = vk::QueryPoolCreateInfo::default()
                .query_type(vk::QueryType::TIMESTAMP)
                .query_count(sequence.slots * sequence.queries_per_slot());
            // SAFETY: plain creation; `Drop` destroys the pool.
            sequence.queries = unsafe { sequence.gpu.device.create_query_pool(&create, None) }
                .map_err(vk_error("vkCreateQueryPool"))?;
        }
        Ok(sequence)
    }

    fn queries_per_slot(&self) -> u32 {
        self.operations.len() as u32 + 1
    }

    fn create_sets(&mut self) -> Result<()> {
        // Sets and descriptors of each dispatch: one to an image has a set per slot.
        let counts = self.operations.iter().filter_map(|o| match &o.work {
            Work::Dispatch { pipeline, slices, to_image, .. } => {
                let sets = if *to_image { self.slots } else { 1 };
                Some([1, slices.len() as u32, pipeline.texels.count(), u32::from(*to_image)].map(|n| sets * n))
            }
            _ => None,
        });
        let [sets, buffers, texels, images] = counts.fold([0; 4], |a, b| std::array::from_fn(|i| a[i] + b[i]));
        if sets == 0 {
            return Ok(());
        }
        let wanted = [
            (vk::DescriptorType::STORAGE_BUFFER, buffers),
            (vk::DescriptorType::STORAGE_TEXEL_BUFFER, texels),
            (vk::DescriptorType::STORAGE_IMAGE, images),
        ];
        let size = |(ty, count)| vk::DescriptorPoolSize::default().ty(ty).descriptor_count(count);
        let sizes: Vec<_> = wanted.into_iter().filter(|(_, count)| *count > 0).map(size).collect();
        let create = vk::DescriptorPoolCreateInfo::default().max_sets(sets).pool_sizes(&sizes);
        // SAFETY: plain creation; `Drop` destroys the pool.
        self.descriptors = unsafe { self.gpu.device.create_descriptor_pool(&create, None) }
            .map_err(vk_error("vkCreateDescriptorPool"))?;
        for index in 0..self.operations.len() {
            let Work::Dispatch { pipeline, slices, to_image, .. } = &self.operations[index].work else { continue };
            let views = pipeline.texels.views(&self.gpu.device, slices)?;
            self.views.extend(&views);
            if *to_image {
                let sets = (0..self.slots).map(|_| self.create_set(pipeline, slices, &views)).collect::<Result<_>>()?;
                self.image_sets.push((index, sets));
            } else {
                self.sets[index] = self.create_set(pipeline, slices, &views)?;
            }
        }
        Ok(())
    }

    /// A set with these buffers, and these views, also in place of buffers.
    fn create_set(
        &self,
        pipeline: &Pipeline,
        slices: &[Slice],
        views: &[(u32, vk::BufferView)],
    ) -> Result<vk::DescriptorSet> {
        let layouts = [pipeline.set_layout];
        let allocate = vk::DescriptorSetAllocateInfo::default().descriptor_pool(self.descriptors).set_layouts(&layouts);
        // SAFETY: the pool was sized for all dispatches.
        let set = unsafe { self.gpu.device.allocate_descriptor_sets(&allocate) }
            .map_err(vk_error("vkAllocateDescriptorSets"))?[0];
        let infos: Vec<_> = slices
            .iter()
            .map(|s| vk::DescriptorBufferInfo { buffer: s.buffer.raw(), offset: s.start, range: s.bytes })
            .collect();
        let write = |binding: u32| vk::WriteDescriptorSet::default().dst_set(set).dst_binding(binding);
        let buffers = (0..).zip(&infos).filter(|(binding, _)| !pipeline.texels.has(*binding)).map(|(binding, info)| {
            let ty = vk::DescriptorType::STORAGE_BUFFER;
            write(binding).descriptor_type(ty).buffer_info(std::slice::from_ref(info))
        });
        let texels = views.iter().map(|(binding, view)| {
            let ty = vk::DescriptorType::STORAGE_TEXEL_BUFFER;
            write(*binding).descriptor_type(ty).texel_buffer_view(std::slice::from_ref(view))
        });
        let updates: Vec<_> = buffers.chain(texels).collect();
        // SAFETY: the set is new, the buffers are live and kept by the operation.
        unsafe { self.gpu.device.update_descriptor_sets(&updates, &[]) };
        Ok(set)
    }

    /// Writes all operations into a host's command buffer. `updates`: the bytes of each [`super::Recorder::update`], in
    /// order; `images`: where each [`super::Recorder::copy_to_image`] and each kernel that writes an image goes, in order, `None` to
    /// leave it out. `slot` may be used again once the encoding before it has finished executing.
    ///
    /// # Errors
    /// `Usage` when the lists do not fit what was recorded.
    pub fn encode(
        &self,
        commands: &HostCommandBuffer,
        slot: u32,
        updates: &[&[u8]],
        images: &[Option<HostImage>],
    ) -> Result<()> {
        self.encode_with(&Encoding { raw: commands.0, slot, timed: true, breadcrumbs: None, updates, images })
    }

    pub(super) fn encode_with(&self, to: &Encoding<'_>) -> Result<()> {
        self.check(to)?;
        let first_query = to.slot * self.queries_per_slot();
        if self.takes_times(to) {
            // SAFETY: recording; the queries of this slot are not in use any more.
            unsafe {
                let count = self.queries_per_slot();
                self.gpu.device.cmd_reset_query_pool(to.raw, self.queries, first_query, count);
            }
        }
        // Earlier submissions share buffers with this one; the queue alone orders nothing.
        let begin = self
            .begin_barrier
            .then(|| memory_barrier(Stages::OF_DEVICE, true, Stages::OF_DEVICE, to.breadcrumbs.is_some()));
        self.barriers_of(to.raw, begin, to.images, true);
        self.timestamp(to, first_query);
        let (mut updates, mut images) = (to.updates.iter(), to.images.iter());
        for (index, operation) in self.operations.iter().enumerate() {
            self.barrier_before(to, operation);
            self.breadcrumb(to, index);
            match &operation.work {
                Work::Update { slice, slot_bytes } => {
                    let bytes = updates.next().copied().unwrap_or_default();
                    self.update(to.raw, &slice.buffer, slice.start + u64::from(to.slot) * slot_bytes, bytes);
                }
                Work::CopyToImage { slice, size } => {
                    if let Some(Some(image)) = images.next() {
                        let layout = vk::ImageLayout::TRANSFER_DST_OPTIMAL;
                        let regions = [image.region(slice.start, *size)];
                        let (from, device) = (slice.buffer.raw(), &self.gpu.device);
                        // SAFETY: recording; the host vouches for the image, the recorder checked the buffer's range.
                        unsafe { device.cmd_copy_buffer_to_image(to.raw, from, image.raw, layout, &regions) };
                    }
                }
                Work::Dispatch { slices, to_image: true, .. } => {
                    if let Some(Some(image)) = images.next() {
                        let set = self.image_set(index, to.slot, slices.len() as u32, image);
                        self.operation(to, &operation.work, set, bytemuck::cast_slice(&image.offset));
                    }
                }
                work => self.operation(to, work, self.sets[index], &[]),
            }
            self.timestamp(to, first_query + index as u32 + 1);
        }
        self.barriers_of(to.raw, None, to.images, false);
        Ok(())
    }

    fn barrier_before(&self, to: &Encoding<'_>, operation: &Operation) {
        // A time belongs to one operation only where none runs beside it.
        let alone = self.beside && self.takes_times(to);
        let barrier = match &operation.barrier {
            Some(Barrier { source, flush, destination, .. }) if !alone => (*source, *flush, *destination),
            Some(Barrier { flush, .. }) => (Stages::OF_DEVICE, *flush, Stages::ALL),
            None if alone => (Stages::OF_DEVICE, false, Stages::OF_DEVICE),
            None => return,
        };
        let (source, flush, destination) = barrier;
        let barrier = memory_barrier(source, flush, destination, to.breadcrumbs.is_some());
        self.barriers_of(to.raw, Some(barrier), &[], true);
    }

    fn takes_times(&self, to: &Encoding<'_>) -> bool {
        to.timed && self.queries != vk::QueryPool::null()
    }

    fn check(&self, to: &Encoding<'_>) -> Result<()> {
        let lengths = self.operations.iter().filter_map(|o| match &o.work {
            Work::Update { slice, .. } => Some(slice.bytes),
            _ => None,
        });
        if !lengths.eq(to.updates.iter().map(|u| u.len() as u64)) {
            return Err(Error::usage("updates of a sequence", "other lengths", "those that were recorded"));
        }
        let images = self.images();
        if images != to.images.len() || images > MAX_IMAGES {
            let expected = format!("{images}, at most {MAX_IMAGES}");
            return Err(Error::usage("images of a sequence", to.images.len().to_string(), expected));
        }
        let wanted = self.operations.iter().filter_map(|o| match &o.work {
            Work::CopyToImage { .. } => Some(false),
            Work::Dispatch { to_image: true, .. } => Some(true),
            _ => None,
        });
        for (storage, image) in wanted.zip(to.images) {
            if let Some(image) = image
                && image.is_storage() != storage
            {
                let said = |storage| if storage { "one with a storage view" } else { "one without a storage view" };
                return Err(Error::usage("image of a sequence", said(!storage), said(storage)));
            }
        }
        if to.slot >= self.slots {
            return Err(Error::usage("slot of a sequence", to.slot.to_string(), format!("below {}", self.slots)));
        }
        Ok(())
    }

    /// Mapped buffers that it uses, each once.
    pub(super) fn mapped(&self) -> Vec<Buffer> {
        let all = self.operations.iter().flat_map(|o| o.work.buffers()).filter(|b| b.is_mapped());
        all.map(|b| (b.id(), b.clone())).collect::<BTreeMap<_, _>>().into_values().collect()
    }

    /// How many images it writes.
    pub(super) fn images(&self) -> usize {
        let writes = |work: &Work| matches!(work, Work::CopyToImage { .. } | Work::Dispatch { to_image: true, .. });
        self.operations.iter().filter(|o| writes(&o.work)).count()
    }

    /// One pipeline barrier: of memory, and of the images' layouts before the first operation or after the last.
    fn barriers_of(
        &self,
        raw: vk::CommandBuffer,
        memory: Option<vk::MemoryBarrier2<'static>>,
        images: &[Option<HostImage>],
        first: bool,
    ) {
        let mut barriers = [vk::ImageMemoryBarrier2::default(); MAX_IMAGES];
        let mut count = 0;
        for image in images.iter().flatten() {
            barriers[count] = image.barrier(first);
            count += 1;
        }
        if memory.is_none() && count == 0 {
            return;
        }
        let dependency =
            vk::DependencyInfo::default().memory_barriers(memory.as_slice()).image_memory_barriers(&barriers[..count]);
        // SAFETY: recording; synchronization2 is enabled.
        unsafe {
            match &self.gpu.sync2 {
                Sync2::Core => self.gpu.device.cmd_pipeline_barrier2(raw, &dependency),
                Sync2::Extension(loader) => loader.cmd_pipeline_barrier2(raw, &dependency),
            }
        }
    }

    fn timestamp(&self, to: &Encoding<'_>, query: u32) {
        if self.takes_times(to) {
            let stage = vk::PipelineStageFlags::BOTTOM_OF_PIPE;
            // SAFETY: recording; the query exists and was reset.
            unsafe { self.gpu.device.cmd_write_timestamp(to.raw, stage, self.queries, query) };
        }
    }

    /// Word `index` becomes 1 when everything before the last barrier has finished and operation `index` may start.
    fn breadcrumb(&self, to: &Encoding<'_>, index: usize) {
        if let Some(buffer) = to.breadcrumbs {
            // SAFETY: recording; the buffer has a word per operation.
            unsafe { self.gpu.device.cmd_fill_buffer(to.raw, buffer.raw(), 4 * index as u64, 4, 1) };
        }
    }

    fn update(&self, raw: vk::CommandBuffer, buffer: &Buffer, start: u64, bytes: &[u8]) {
        for (index, part) in bytes.chunks(UPDATE_BYTES).enumerate() {
            let at = start + (index * UPDATE_BYTES) as u64;
            // SAFETY: recording; the recorder checked range and alignment, `check` the length.
            unsafe { self.gpu.device.cmd_update_buffer(raw, buffer.raw(), at, part) };
        }
    }

    /// The set of a dispatch to an image, which is its last binding. The slot's earlier commands have finished.
    fn image_set(&self, index: usize, slot: u32, binding: u32, image: &HostImage) -> vk::DescriptorSet {
        let of_operation = self.image_sets.iter().find(|(operation, _)| *operation == index);
        let set = of_operation.map_or(vk::DescriptorSet::null(), |(_, sets)| sets[slot as usize]);
        let info = [vk::DescriptorImageInfo::default().image_view(image.view).image_layout(vk::ImageLayout::GENERAL)];
        let write = vk::WriteDescriptorSet::default()
            .dst_set(set)
            .dst_binding(binding)
            .descriptor_type(vk::DescriptorType::STORAGE_IMAGE)
            .image_info(&info);
        // SAFETY: the set is not in use; the host vouches for the view.
        unsafe { self.gpu.device.update_descriptor_sets(&[write], &[]) };
        set
    }

    /// `at_image`: push constants of a dispatch to an image.
    fn operation(&self, to: &Encoding<'_>, work: &Work, set: vk::DescriptorSet, at_image: &[u8]) {
        let device = &self.gpu.device;
        match work {
            // SAFETY: recording; ranges were checked.
            Work::Fill { slice, value } => unsafe {
                device.cmd_fill_buffer(to.raw, slice.buffer.raw(), slice.start, slice.bytes, *value);
            },
            Work::Copy { source, destination, slot_bytes } => {
                let dst_offset = destination.start + u64::from(to.slot) * slot_bytes;
                let regions = [vk::BufferCopy { src_offset: source.start, dst_offset, size: source.bytes }];
                // SAFETY: as above.
                unsafe { device.cmd_copy_buffer(to.raw, source.buffer.raw(), destination.buffer.raw(), &regions) };
            }
            Work::Dispatch { pipeline, push, grid, to_image, .. } => {
                let push = if *to_image { at_image } else { push.as_slice() };
                let (point, sets) = (vk::PipelineBindPoint::COMPUTE, [set]);
                // SAFETY: recording; all handles are live and kept by `self`.
                unsafe {
                    device.cmd_bind_pipeline(to.raw, point, pipeline.raw);
                    device.cmd_bind_descriptor_sets(to.raw, point, pipeline.layout, 0, &sets, &[]);
                    if !push.is_empty() {
                        device.cmd_push_constants(to.raw, pipeline.layout, vk::ShaderStageFlags::COMPUTE, 0, push);
                    }
                    match grid {
                        Grid::Direct([x, y, z]) => device.cmd_dispatch(to.raw, *x, *y, *z),
                        Grid::Indirect(buffer, offset) => device.cmd_dispatch_indirect(to.raw, buffer.raw(), *offset),
                    }
                }
            }
            Work::HostRead | Work::Update { .. } | Work::CopyToImage { .. } => {}
        }
    }

    /// Device time of each operation in the encoding of `slot`, which has finished; empty without timestamps, or when it
    /// was never executed.
    pub fn timings(&self, slot: u32) -> Result<Vec<Timing>> {
        let mut timings = Vec::new();
        self.each_timing(slot, |label, us| timings.push(Timing { label: label.to_owned(), us }))?;
        Ok(timings)
    }

    /// [`Sequence::timings`] one by one: label and microseconds. Allocates nothing.
    pub fn each_timing(&self, slot: u32, mut each: impl FnMut(&str, f64)) -> Result<()> {
        if self.queries == vk::QueryPool::null() || slot >= self.slots {
            return Ok(());
        }
        let count = self.queries_per_slot();
        let (ns, bits) = (self.gpu.info.capabilities.timestamp_ns, self.gpu.info.capabilities.timestamp_bits);
        let mut ticks = [0_u64; 64];
        // Parts of the list, each from where the last one ended.
        let mut first = 0;
        while first + 1 < count {
            let part = &mut ticks[..(count - first).min(64) as usize];
            let flags = vk::QueryResultFlags::TYPE_64;
            // SAFETY: the pool has that many queries.
            let read =
                unsafe { self.gpu.device.get_query_pool_results(self.queries, slot * count + first, part, flags) };
            match read {
                Ok(()) => {}
                Err(vk::Result::NOT_READY) => return Ok(()),
                Err(code) => return Err(vk_error("vkGetQueryPoolResults")(code)),
            }
            let named = self.operations.iter().skip(first as usize).zip(part.windows(2));
            named.for_each(|(o, t)| each(&o.label, ticks_between(t[0], t[1], bits) as f64 * ns / 1e3));
            first += part.len() as u32 - 1;
        }
        Ok(())
    }

    /// The barrier plan.
    pub fn plan(&self) -> &str {
        &self.plan
    }

    /// Number of dispatches.
    pub fn dispatches(&self) -> usize {
        self.operations.iter().filter(|o| matches!(o.work, Work::Dispatch { .. })).count()
    }

    /// Number of barriers, the one at the beginning included.
    pub fn barriers(&self) -> usize {
        1 + self.operations.iter().filter(|o| o.barrier.is_some()).count()
    }

    /// Labels and kernels of the dispatches, in order.
    pub fn kernels(&self) -> Vec<(&str, &'static super::kernel::Kernel)> {
        let kernel = |o: &'_ Operation| if let Work::Dispatch { kernel, .. } = &o.work { Some(*kernel) } else { None };
        self.operations.iter().filter_map(|o| kernel(o).map(|k| (o.label.as_str(), k))).collect()
    }

    /// Push constants of the dispatches, in the order of [`Sequence::kernels`].
    pub fn push_constants(&self) -> Vec<&[u8]> {
        let pushes = self.operations.iter().filter_map(|o| match &o.work {
            Work::Dispatch { push, .. } => Some(push.as_slice()),
            _ => None,
        });
        pushes.collect()
    }

    /// Which bytes each operation touches, for tests of the plan.
    pub fn uses(&self) -> Vec<(&str, &[super::access::Use], bool)> {
        self.operations.iter().map(|o| (o.label.as_str(), o.uses.as_slice(), o.barrier.is_some())).collect()
    }
}

impl Drop for Sequence {
    fn drop(&mut self) {
        // SAFETY: whoever encoded it has waited; null handles are ignored.
        unsafe {
            self.gpu.device.destroy_query_pool(self.queries, None);
            self.gpu.device.destroy_descriptor_pool(self.descriptors, None);
        }
        texels::destroy(&self.gpu.device, &self.views);
    }
}
