//! Recorded command buffers: encoding, submission, waiting, timings, breadcrumbs.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use ash::vk;

use super::access::{Barrier, Stages};
use super::device::{Gpu, Shared, Sync2, lock, vk_error};
use super::memory::{Buffer, Memory};
use super::recorder::{Grid, Operation, Work};
use crate::error::{Error, Result};

/// A submission, in order; wait for it with [`Gpu::wait`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub struct Submission(u64);

/// Device time of one operation.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Timing {
    /// Label of the operation.
    pub label: String,
    /// Microseconds.
    pub us: f64,
}

/// A recorded command buffer with everything that it uses.
pub struct Commands {
    gpu: Arc<Shared>,
    name: String,
    operations: Vec<Operation>,
    plan: String,
    pool: vk::CommandPool,
    raw: vk::CommandBuffer,
    descriptors: vk::DescriptorPool,
    queries: vk::QueryPool,
    breadcrumbs: Option<Buffer>,
    last: Submission,
}

impl std::fmt::Debug for Commands {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Commands({}, {} operations)", self.name, self.operations.len())
    }
}

impl Commands {
    pub(super) fn encode(
        gpu: &Gpu,
        name: String,
        operations: Vec<Operation>,
        plan: String,
        (profile, begin_barrier): (bool, bool),
    ) -> Result<Self> {
        let shared = &gpu.0;
        let breadcrumbs = if shared.options.breadcrumbs {
            Some(gpu.buffer("breadcrumbs", 4 * operations.len() as u64, Memory::Readback)?)
        } else {
            None
        };
        let pool_create = vk::CommandPoolCreateInfo::default().queue_family_index(shared.family);
        // SAFETY: plain creation.
        let pool = unsafe { shared.device.create_command_pool(&pool_create, None) }
            .map_err(vk_error("vkCreateCommandPool"))?;
        let mut commands = Self {
            gpu: Arc::clone(shared),
            name,
            operations,
            plan,
            pool,
            raw: vk::CommandBuffer::null(),
            descriptors: vk::DescriptorPool::null(),
            queries: vk::QueryPool::null(),
            breadcrumbs,
            last: Submission(0),
        };
        commands.create_pools(profile)?;
        commands.record(begin_barrier)?;
        Ok(commands)
    }

    fn create_pools(&mut self, profile: bool) -> Result<()> {
        let device = &self.gpu.device;
        let allocate = vk::CommandBufferAllocateInfo::default().command_pool(self.pool).command_buffer_count(1);
        // SAFETY: plain creation; `Drop` destroys the pools.
        self.raw =
            unsafe { device.allocate_command_buffers(&allocate) }.map_err(vk_error("vkAllocateCommandBuffers"))?[0];
        let dispatches = self.dispatches() as u32;
        let buffers: u32 = self
            .operations
            .iter()
            .map(|o| if let Work::Dispatch { slices, .. } = &o.work { slices.len() as u32 } else { 0 })
            .sum();
        if dispatches > 0 {
            let sizes = [vk::DescriptorPoolSize::default()
                .ty(vk::DescriptorType::STORAGE_BUFFER)
                .descriptor_count(buffers.max(1))];
            let create = vk::DescriptorPoolCreateInfo::default().max_sets(dispatches).pool_sizes(&sizes);
            // SAFETY: as above.
            self.descriptors =
                unsafe { device.create_descriptor_pool(&create, None) }.map_err(vk_error("vkCreateDescriptorPool"))?;
        }
        if profile {
            let create = vk::QueryPoolCreateInfo::default()
                .query_type(vk::QueryType::TIMESTAMP)
                .query_count(self.operations.len() as u32 + 1);
            // SAFETY: as above.
            self.queries = unsafe { device.create_query_pool(&create, None) }.map_err(vk_error("vkCreateQueryPool"))?;
        }
        Ok(())
    }

    fn record(&mut self, begin_barrier: bool) -> Result<()> {
        let device = &self.gpu.device;
        // SAFETY: all handles used below are live and kept by `self`; ranges were checked by the recorder.
        unsafe {
            device
                .begin_command_buffer(self.raw, &vk::CommandBufferBeginInfo::default())
                .map_err(vk_error("vkBeginCommandBuffer"))?;
            if self.queries != vk::QueryPool::null() {
                device.cmd_reset_query_pool(self.raw, self.queries, 0, self.operations.len() as u32 + 1);
            }
        }
        // Earlier submissions share buffers with this one; the queue alone orders nothing.
        if begin_barrier {
            let all = Stages::COMPUTE.union(Stages::TRANSFER).union(Stages::INDIRECT);
            self.barrier(all, true, all);
        }
        self.timestamp(0);
        for index in 0..self.operations.len() {
            if let Some(Barrier { source, flush, destination, .. }) = self.operations[index].barrier.clone() {
                self.barrier(source, flush, destination);
            }
            self.breadcrumb(index);
            self.operation(index)?;
            self.timestamp(index as u32 + 1);
        }
        // SAFETY: as above.
        unsafe { self.gpu.device.end_command_buffer(self.raw) }.map_err(vk_error("vkEndCommandBuffer"))
    }

    fn barrier(&self, source: Stages, flush: bool, destination: Stages) {
        // A breadcrumb is a transfer that must not overtake the kernels before it.
        let crumb =
            if self.breadcrumbs.is_some() { vk::PipelineStageFlags2::TRANSFER } else { vk::PipelineStageFlags2::NONE };
        let mut barrier =
            vk::MemoryBarrier2::default().src_stage_mask(stages(source)).dst_stage_mask(stages(destination) | crumb);
        if flush {
            barrier = barrier.src_access_mask(writes(source)).dst_access_mask(reads(destination) | writes(destination));
        }
        let barriers = [barrier];
        let dependency = vk::DependencyInfo::default().memory_barriers(&barriers);
        // SAFETY: recording; synchronization2 is enabled.
        unsafe {
            match &self.gpu.sync2 {
                Sync2::Core => self.gpu.device.cmd_pipeline_barrier2(self.raw, &dependency),
                Sync2::Extension(loader) => loader.cmd_pipeline_barrier2(self.raw, &dependency),
            }
        }
    }

    fn timestamp(&self, query: u32) {
        if self.queries != vk::QueryPool::null() {
            // SAFETY: recording; the query exists and was reset.
            unsafe {
                self.gpu.device.cmd_write_timestamp(
                    self.raw,
                    vk::PipelineStageFlags::BOTTOM_OF_PIPE,
                    self.queries,
                    query,
                );
            }
        }
    }

    /// Word `index` becomes 1 when everything before the last barrier has finished and operation `index` may start.
    fn breadcrumb(&self, index: usize) {
        if let Some(buffer) = &self.breadcrumbs {
            // SAFETY: recording; the buffer has a word per operation.
            unsafe { self.gpu.device.cmd_fill_buffer(self.raw, buffer.raw(), 4 * index as u64, 4, 1) };
        }
    }

    fn operation(&self, index: usize) -> Result<()> {
        let device = &self.gpu.device;
        match &self.operations[index].work {
            // SAFETY: recording; ranges were checked.
            Work::Fill { slice, value } => unsafe {
                device.cmd_fill_buffer(self.raw, slice.buffer.raw(), slice.start, slice.bytes, *value);
            },
            Work::Copy { source, destination } => {
                let regions =
                    [vk::BufferCopy { src_offset: source.start, dst_offset: destination.start, size: source.bytes }];
                // SAFETY: as above.
                unsafe { device.cmd_copy_buffer(self.raw, source.buffer.raw(), destination.buffer.raw(), &regions) };
            }
            Work::Dispatch { pipeline, push, slices, grid, .. } => {
                let layouts = [pipeline.set_layout];
                let allocate =
                    vk::DescriptorSetAllocateInfo::default().descriptor_pool(self.descriptors).set_layouts(&layouts);
                // SAFETY: the pool was sized for all dispatches.
                let sets = unsafe { device.allocate_descriptor_sets(&allocate) }
                    .map_err(vk_error("vkAllocateDescriptorSets"))?;
                let infos: Vec<_> = slices
                    .iter()
                    .map(|s| vk::DescriptorBufferInfo { buffer: s.buffer.raw(), offset: s.start, range: s.bytes })
                    .collect();
                let updates: Vec<_> = infos
                    .iter()
                    .enumerate()
                    .map(|(binding, info)| {
                        vk::WriteDescriptorSet::default()
                            .dst_set(sets[0])
                            .dst_binding(binding as u32)
                            .descriptor_type(vk::DescriptorType::STORAGE_BUFFER)
                            .buffer_info(std::slice::from_ref(info))
                    })
                    .collect();
                // SAFETY: as above.
                unsafe {
                    device.update_descriptor_sets(&updates, &[]);
                    device.cmd_bind_pipeline(self.raw, vk::PipelineBindPoint::COMPUTE, pipeline.raw);
                    device.cmd_bind_descriptor_sets(
                        self.raw,
                        vk::PipelineBindPoint::COMPUTE,
                        pipeline.layout,
                        0,
                        &sets,
                        &[],
                    );
                    if !push.is_empty() {
                        device.cmd_push_constants(self.raw, pipeline.layout, vk::ShaderStageFlags::COMPUTE, 0, push);
                    }
                    match grid {
                        Grid::Direct([x, y, z]) => device.cmd_dispatch(self.raw, *x, *y, *z),
                        Grid::Indirect(buffer, offset) => device.cmd_dispatch_indirect(self.raw, buffer.raw(), *offset),
                    }
                }
            }
            Work::HostRead => {}
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

    /// Push constants of the dispatches, in the order of [`Commands::kernels`].
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

    /// The latest submission of these commands.
    pub fn submission(&self) -> Submission {
        self.last
    }

    /// Device time of each operation in the latest finished submission; empty without timestamps.
    pub fn timings(&self) -> Result<Vec<Timing>> {
        if self.queries == vk::QueryPool::null() || self.last == Submission(0) {
            return Ok(Vec::new());
        }
        let mut ticks = vec![0_u64; self.operations.len() + 1];
        let flags = vk::QueryResultFlags::TYPE_64 | vk::QueryResultFlags::WAIT;
        // SAFETY: the pool has that many queries.
        unsafe { self.gpu.device.get_query_pool_results(self.queries, 0, &mut ticks, flags) }
            .map_err(vk_error("vkGetQueryPoolResults"))?;
        let ns = self.gpu.info.capabilities.timestamp_ns;
        let named = self.operations.iter().zip(ticks.windows(2));
        Ok(named
            .map(|(o, t)| Timing { label: o.label.clone(), us: t[1].wrapping_sub(t[0]) as f64 * ns / 1e3 })
            .collect())
    }

    /// Last finished and next operation, from the breadcrumbs.
    fn trace(&self) -> (String, String) {
        let Some(buffer) = &self.breadcrumbs else {
            return ("unknown (breadcrumbs are off; set SPGS_BREADCRUMBS=1)".into(), "unknown".into());
        };
        let mut bytes = vec![0_u8; 4 * self.operations.len()];
        if buffer.read(0, &mut bytes).is_err() {
            return ("unknown".into(), "unknown".into());
        }
        let started = bytes.chunks_exact(4).take_while(|w| w[0] == 1).count();
        let name = |i: usize| self.operations.get(i).map_or("none".to_owned(), |o| o.label.clone());
        match started {
            0 => ("none".into(), name(0)),
            n => (if n > 1 { name(n - 2) } else { "none".into() }, name(n - 1)),
        }
    }

    fn device_lost(&self) -> Error {
        let (last_kernel, next_kernel) = self.trace();
        Error::DeviceLost { submission: self.last.0, label: self.name.clone(), last_kernel, next_kernel }
    }
}

impl Gpu {
    /// Submits recorded commands; several may be in flight. The same commands submitted again wait for their last run.
    pub fn submit(&self, commands: &mut Commands) -> Result<Submission> {
        let shared = &self.0;
        self.wait_for(commands)?;
        let queue = lock(&shared.queue);
        let value = shared.submissions.load(Ordering::SeqCst) + 1;
        let injected = shared.lose_at.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |n| n.checked_sub(1)) == Ok(1);
        if shared.lost.load(Ordering::SeqCst) {
            return Err(commands.device_lost());
        }
        if let Some(buffer) = &commands.breadcrumbs {
            buffer.write_readback(0, &vec![0; 4 * commands.operations.len()])?;
        }
        let buffers = [commands.raw];
        let semaphores = [shared.timeline];
        let values = [value];
        let mut timeline = vk::TimelineSemaphoreSubmitInfo::default().signal_semaphore_values(&values);
        let submit = [vk::SubmitInfo::default()
            .command_buffers(&buffers)
            .signal_semaphores(&semaphores)
            .push_next(&mut timeline)];
        // SAFETY: the command buffer is recorded and not pending; the queue is locked.
        let result = unsafe { shared.device.queue_submit(*queue, &submit, vk::Fence::null()) };
        match result {
            Ok(()) => {
                shared.submissions.store(value, Ordering::SeqCst);
                commands.last = Submission(value);
                if injected {
                    // The work runs first, so that the report is made from breadcrumbs that the device left.
                    self.wait(commands.last)?;
                    shared.lost.store(true, Ordering::SeqCst);
                    return Err(commands.device_lost());
                }
                Ok(commands.last)
            }
            Err(vk::Result::ERROR_DEVICE_LOST) => {
                shared.lost.store(true, Ordering::SeqCst);
                Err(commands.device_lost())
            }
            Err(code) => Err(vk_error("vkQueueSubmit")(code)),
        }
    }

    /// Waits for the latest submission of these commands; a lost device names the last finished kernel.
    pub fn wait_for(&self, commands: &Commands) -> Result<()> {
        self.wait(commands.last).map_err(|error| match error {
            Error::DeviceLost { .. } => commands.device_lost(),
            other => other,
        })
    }

    /// Waits for a submission. The time-out of [`super::GpuOptions`] counts from the last submission that finished, so a long
    /// queue may take as long as it needs.
    pub fn wait(&self, submission: Submission) -> Result<()> {
        if submission.0 == 0 {
            return Ok(());
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
                Err(code) => return Err(self.vulkan_error("vkWaitSemaphores", code)),
            }
        }
    }

    /// Number of the last submission that has finished.
    fn finished(&self) -> Result<u64> {
        // SAFETY: the semaphore is live.
        let value = unsafe { self.0.device.get_semaphore_counter_value(self.0.timeline) };
        value.map_err(|code| self.vulkan_error("vkGetSemaphoreCounterValue", code))
    }

    /// Whether a submission has finished.
    pub fn is_finished(&self, submission: Submission) -> Result<bool> {
        Ok(self.finished()? >= submission.0)
    }

    /// Turns a result code into an error; device loss is remembered.
    pub(super) fn vulkan_error(&self, call: &'static str, code: vk::Result) -> Error {
        if code == vk::Result::ERROR_DEVICE_LOST {
            self.0.lost.store(true, Ordering::SeqCst);
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
        let gpu = Gpu(Arc::clone(&self.gpu));
        if let Err(error) = gpu.wait(self.last) {
            log::error!("dropping `{}`: {error}", self.name);
            // Too slow is not finished: what it uses may only be freed once the device is idle or lost.
            // SAFETY: the device lives as long as `self.gpu`.
            let _ = unsafe { self.gpu.device.device_wait_idle() };
        }
        // SAFETY: not pending any more; null handles are ignored.
        unsafe {
            self.gpu.device.destroy_query_pool(self.queries, None);
            self.gpu.device.destroy_descriptor_pool(self.descriptors, None);
            self.gpu.device.destroy_command_pool(self.pool, None);
        }
    }
}

fn stages(s: Stages) -> vk::PipelineStageFlags2 {
    let mut flags = vk::PipelineStageFlags2::NONE;
    for (stage, flag) in [
        (Stages::COMPUTE, vk::PipelineStageFlags2::COMPUTE_SHADER),
        (Stages::TRANSFER, vk::PipelineStageFlags2::TRANSFER),
        (Stages::INDIRECT, vk::PipelineStageFlags2::DRAW_INDIRECT),
        (Stages::HOST, vk::PipelineStageFlags2::HOST),
    ] {
        if s.contains(stage) {
            flags |= flag;
        }
    }
    flags
}

fn writes(s: Stages) -> vk::AccessFlags2 {
    let mut flags = vk::AccessFlags2::NONE;
    if s.contains(Stages::COMPUTE) {
        flags |= vk::AccessFlags2::SHADER_STORAGE_WRITE;
    }
    if s.contains(Stages::TRANSFER) {
        flags |= vk::AccessFlags2::TRANSFER_WRITE;
    }
    flags
}

fn reads(s: Stages) -> vk::AccessFlags2 {
    let mut flags = vk::AccessFlags2::NONE;
    for (stage, flag) in [
        (Stages::COMPUTE, vk::AccessFlags2::SHADER_STORAGE_READ),
        (Stages::TRANSFER, vk::AccessFlags2::TRANSFER_READ),
        (Stages::INDIRECT, vk::AccessFlags2::INDIRECT_COMMAND_READ),
        (Stages::HOST, vk::AccessFlags2::HOST_READ),
    ] {
        if s.contains(stage) {
            flags |= flag;
        }
    }
    flags
}
