//! Named buffers over `gpu-allocator`, with a byte budget; blocking uploads and downloads through staging.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme};

use super::commands::Submission;
use super::device::{Gpu, Shared, lock, vk_error};
use crate::error::{Error, Result};

/// Bytes moved by one staging copy.
const STAGING_BYTES: u64 = 32 << 20;

/// Where a buffer lives and who touches it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Memory {
    /// Device memory; filled by [`Gpu::upload`].
    Device,
    /// Mapped; the host writes, the device reads it once or twice (copies, vertices).
    Upload,
    /// What the host writes before each submission and many workgroups read: memory of the device that the host can write.
    /// Where there is none, it lies on the device, and each recording that reads it begins by copying what was written.
    Constants,
    /// Mapped; the device writes, the host reads.
    Readback,
}

/// A storage buffer. Cheap to clone; freed with the last clone.
#[derive(Clone)]
pub struct Buffer(Arc<BufferInner>);

struct BufferInner {
    raw: vk::Buffer,
    allocation: Option<Allocation>,
    name: String,
    bytes: u64,
    charged: u64,
    id: u64,
    memory: Memory,
    /// The last submission that uses mapped memory; 0 when that is known to have finished.
    used_until: AtomicU64,
    /// Of constants, where the host's memory is not the device's: what the host writes.
    written: Option<Buffer>,
    gpu: Arc<Shared>,
}

impl std::fmt::Debug for Buffer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Buffer({}, {} bytes)", self.0.name, self.0.bytes)
    }
}

/// A byte range of a buffer. The start must be a multiple of 256 (every device's binding alignment).
#[derive(Debug, Clone)]
pub struct Slice {
    /// The buffer.
    pub buffer: Buffer,
    /// First byte.
    pub start: u64,
    /// Length in bytes.
    pub bytes: u64,
    name: Option<&'static str>,
}

impl Slice {
    /// Name in plans: the part's own, else the buffer's.
    pub fn name(&self) -> &str {
        self.name.unwrap_or_else(|| self.buffer.name())
    }

    /// Gives a part of an arena a name of its own.
    #[must_use]
    pub fn named(mut self, name: &'static str) -> Self {
        self.name = Some(name);
        self
    }
}

impl From<&Buffer> for Slice {
    fn from(buffer: &Buffer) -> Self {
        Self { buffer: buffer.clone(), start: 0, bytes: buffer.bytes(), name: None }
    }
}

impl From<Buffer> for Slice {
    fn from(buffer: Buffer) -> Self {
        Self::from(&buffer)
    }
}

impl From<&Slice> for Slice {
    fn from(slice: &Slice) -> Self {
        slice.clone()
    }
}

impl Buffer {
    /// Name given at creation.
    pub fn name(&self) -> &str {
        &self.0.name
    }

    /// Size in bytes (as asked for, at least 16, a multiple of 16).
    pub fn bytes(&self) -> u64 {
        self.0.bytes
    }

    /// Where it lives.
    pub fn memory(&self) -> Memory {
        self.0.memory
    }

    /// All of it.
    pub fn whole(&self) -> Slice {
        Slice::from(self)
    }

    /// A range of it; one past the end is cut to the buffer.
    pub fn slice(&self, start: u64, bytes: u64) -> Slice {
        let start = start.min(self.0.bytes);
        Slice { buffer: self.clone(), start, bytes: bytes.min(self.0.bytes - start), name: None }
    }

    pub(super) fn raw(&self) -> vk::Buffer {
        self.0.raw
    }

    pub(super) fn id(&self) -> u64 {
        self.0.id
    }

    /// What the host writes of it, where that is another buffer.
    pub(super) fn written(&self) -> Option<&Self> {
        self.0.written.as_ref()
    }

    /// Whether the host reads or writes it.
    pub(super) fn is_mapped(&self) -> bool {
        self.0.memory != Memory::Device && self.0.written.is_none()
    }

    /// Whether the memory is the device's own.
    pub fn is_on_device(&self) -> bool {
        self.0
            .allocation
            .as_ref()
            .is_some_and(|a| a.memory_properties().contains(vk::MemoryPropertyFlags::DEVICE_LOCAL))
    }

    /// The host leaves mapped memory alone until this submission has finished. Submissions of the engine's own commands are
    /// told of; a host's command buffers are not.
    pub(super) fn used_by(&self, submission: Submission) {
        self.0.used_until.fetch_max(submission.0, Ordering::SeqCst);
    }

    /// Writes mapped memory.
    ///
    /// # Errors
    /// `Usage` while a submission that uses it has not finished, and for memory that is not for writing; `Limit` past its
    /// end.
    pub fn write(&self, offset: u64, data: &[u8]) -> Result<()> {
        if let Some(written) = &self.0.written {
            return written.write(offset, data);
        }
        let (pointer, _) = self.mapped(offset, data.len() as u64, &[Memory::Upload, Memory::Constants])?;
        // SAFETY: `mapped` checked the range; the memory is mapped for the allocation's life, and no Rust reference
        // to it exists.
        unsafe { std::ptr::copy_nonoverlapping(data.as_ptr(), pointer, data.len()) };
        Ok(())
    }

    /// Reads mapped memory. The recording that wrote it must end with `host_read`.
    ///
    /// # Errors
    /// As [`Buffer::write`].
    pub fn read(&self, offset: u64, data: &mut [u8]) -> Result<()> {
        let (pointer, _) = self.mapped(offset, data.len() as u64, &[Memory::Readback])?;
        // SAFETY: as in `write`.
        unsafe { std::ptr::copy_nonoverlapping(pointer, data.as_mut_ptr(), data.len()) };
        Ok(())
    }

    /// Fills mapped read-back memory from the host, so that tests and breadcrumbs start from a known state.
    pub fn write_readback(&self, offset: u64, data: &[u8]) -> Result<()> {
        let (pointer, _) = self.mapped(offset, data.len() as u64, &[Memory::Readback])?;
        // SAFETY: as in `write`.
        unsafe { std::ptr::copy_nonoverlapping(data.as_ptr(), pointer, data.len()) };
        Ok(())
    }

    /// Fills mapped read-back memory with zeros.
    pub(super) fn clear_readback(&self) -> Result<()> {
        let (pointer, bytes) = self.mapped(0, self.0.bytes, &[Memory::Readback])?;
        // SAFETY: as in `write`.
        unsafe { std::ptr::write_bytes(pointer, 0, bytes as usize) };
        Ok(())
    }

    /// Refuses what a submission still uses.
    fn check_idle(&self) -> Result<()> {
        let until = self.0.used_until.load(Ordering::SeqCst);
        if until == 0 {
            return Ok(());
        }
        // A lost device uses nothing any more; what is submitted next says that it is lost. Nor does one whose compiler alone is
        // asked: some drivers that compute nothing do not count submissions either.
        if !self.0.gpu.statistics && self.0.gpu.finished().is_ok_and(|finished| finished < until) {
            let (what, found) = (format!("buffer `{}`", self.0.name), format!("submission {until} still uses it"));
            return Err(Error::usage(what, found, "a submission that was waited for"));
        }
        // Unless it was used again meanwhile.
        let _ = self.0.used_until.compare_exchange(until, 0, Ordering::SeqCst, Ordering::SeqCst);
        Ok(())
    }

    fn mapped(&self, offset: u64, bytes: u64, expected: &[Memory]) -> Result<(*mut u8, u64)> {
        if !expected.contains(&self.0.memory) {
            return Err(Error::usage(
                format!("buffer `{}`", self.0.name),
                format!("{:?}", self.0.memory),
                format!("{expected:?}"),
            ));
        }
        self.check_idle()?;
        if offset.checked_add(bytes).is_none_or(|end| end > self.0.bytes) {
            let need = u128::from(offset) + u128::from(bytes);
            return Err(Error::Limit { what: format!("buffer `{}`", self.0.name), need, have: self.0.bytes.into() });
        }
        let base = self.0.allocation.as_ref().and_then(Allocation::mapped_ptr);
        let base =
            base.ok_or_else(|| Error::usage(format!("buffer `{}`", self.0.name), "unmapped memory", "mapped"))?;
        // SAFETY: the offset is within the mapped allocation.
        Ok((unsafe { base.as_ptr().cast::<u8>().add(offset as usize) }, bytes))
    }
}

impl Drop for BufferInner {
    fn drop(&mut self) {
        // SAFETY: recordings and submissions keep their buffers, so the device no longer uses it.
        unsafe { self.gpu.device.destroy_buffer(self.raw, None) };
        if let (Some(allocation), Some(allocator)) = (self.allocation.take(), lock(&self.gpu.allocator).as_mut())
            && let Err(error) = allocator.free(allocation)
        {
            log::error!("freeing `{}`: {error}", self.name);
        }
        self.gpu.memory.used.fetch_sub(self.charged, Ordering::SeqCst);
        self.gpu.memory.objects.fetch_sub(1, Ordering::SeqCst);
    }
}

impl Gpu {
    /// Makes a buffer. `bytes` is rounded up to 16; contents are undefined.
    pub fn buffer(&self, name: &str, bytes: u64, memory: Memory) -> Result<Buffer> {
        let bytes = bytes.max(16).next_multiple_of(16);
        let limit = self.0.info.capabilities.max_allocation_bytes;
        if bytes > limit {
            let what = format!("bytes of buffer `{name}` (maxMemoryAllocationSize)");
            return Err(Error::Limit { what, need: bytes.into(), have: limit.into() });
        }
        let buffer = self.allocate(name, bytes, memory)?;
        if memory != Memory::Constants || buffer.is_on_device() && !self.0.memory.apart.load(Ordering::SeqCst) {
            return Ok(buffer);
        }
        log::debug!("`{name}`: the host's memory, copied to the device in each recording");
        let mut on_device = self.allocate(name, bytes, Memory::Device)?;
        if let Some(inner) = Arc::get_mut(&mut on_device.0) {
            (inner.memory, inner.written) = (Memory::Constants, Some(buffer));
        }
        Ok(on_device)
    }

    fn allocate(&self, name: &str, bytes: u64, memory: Memory) -> Result<Buffer> {
        self.charge(name, bytes)?;
        let made = self.make_buffer(name, bytes, memory);
        if made.is_err() {
            self.0.memory.used.fetch_sub(bytes, Ordering::SeqCst);
        }
        made
    }

    fn make_buffer(&self, name: &str, bytes: u64, memory: Memory) -> Result<Buffer> {
        let shared = &self.0;
        let texels = if shared.info.capabilities.texel_reads > 0 {
            vk::BufferUsageFlags::STORAGE_TEXEL_BUFFER
        } else {
            vk::BufferUsageFlags::empty()
        };
        let create = vk::BufferCreateInfo::default().size(bytes).sharing_mode(vk::SharingMode::EXCLUSIVE).usage(
            texels
                | vk::BufferUsageFlags::STORAGE_BUFFER
                | vk::BufferUsageFlags::TRANSFER_SRC
                | vk::BufferUsageFlags::TRANSFER_DST
                | vk::BufferUsageFlags::INDIRECT_BUFFER
                | vk::BufferUsageFlags::VERTEX_BUFFER
                | vk::BufferUsageFlags::INDEX_BUFFER,
        );
        let out_of_memory = || {
            self.ask_budget();
            // What is asked for was charged already.
            shared.memory.used.fetch_sub(bytes, Ordering::SeqCst);
            let error = shared.memory.out_of_memory(&format!("{name}, refused by the driver"), bytes);
            shared.memory.used.fetch_add(bytes, Ordering::SeqCst);
            error
        };
        // SAFETY: plain creation.
        let raw = match unsafe { shared.device.create_buffer(&create, None) } {
            Ok(raw) => raw,
            Err(vk::Result::ERROR_OUT_OF_DEVICE_MEMORY | vk::Result::ERROR_OUT_OF_HOST_MEMORY) => {
                return Err(out_of_memory());
            }
            Err(code) => return Err(vk_error("vkCreateBuffer")(code)),
        };
        // SAFETY: `raw` is live.
        let requirements = unsafe { shared.device.get_buffer_memory_requirements(raw) };
        let location = match memory {
            Memory::Device => MemoryLocation::GpuOnly,
            Memory::Upload | Memory::Constants => MemoryLocation::CpuToGpu,
            Memory::Readback => MemoryLocation::GpuToCpu,
        };
        let describe = AllocationCreateDesc {
            name,
            requirements,
            location,
            linear: true,
            allocation_scheme: AllocationScheme::GpuAllocatorManaged,
        };
        let allocated = lock(&shared.allocator).as_mut().map(|a| a.allocate(&describe));
        let Some(Ok(allocation)) = allocated else {
            // SAFETY: unused.
            unsafe { shared.device.destroy_buffer(raw, None) };
            return Err(out_of_memory());
        };
        // SAFETY: the allocation satisfies the buffer's requirements.
        let bound = unsafe { shared.device.bind_buffer_memory(raw, allocation.memory(), allocation.offset()) };
        if let Err(code) = bound {
            // SAFETY: unused.
            unsafe { shared.device.destroy_buffer(raw, None) };
            if let Some(allocator) = lock(&shared.allocator).as_mut() {
                let _ = allocator.free(allocation);
            }
            return Err(vk_error("vkBindBufferMemory")(code));
        }
        static NEXT_ID: AtomicU64 = AtomicU64::new(1);
        shared.memory.objects.fetch_add(1, Ordering::SeqCst);
        Ok(Buffer(Arc::new(BufferInner {
            raw,
            allocation: Some(allocation),
            name: name.into(),
            bytes,
            charged: bytes,
            id: NEXT_ID.fetch_add(1, Ordering::Relaxed),
            memory,
            used_until: AtomicU64::new(0),
            written: None,
            gpu: Arc::clone(shared),
        })))
    }

    /// A device buffer with this content.
    pub fn buffer_with(&self, name: &str, data: &[u8]) -> Result<Buffer> {
        let buffer = self.buffer(name, data.len() as u64, Memory::Device)?;
        self.upload(&buffer, data)?;
        Ok(buffer)
    }

    /// Copies `data` to the start of a device buffer; blocks.
    pub fn upload(&self, buffer: &Buffer, data: &[u8]) -> Result<()> {
        if data.is_empty() {
            return Ok(());
        }
        let chunk = STAGING_BYTES.min(data.len() as u64);
        let staging = self.buffer("upload staging", chunk, Memory::Upload)?;
        for (index, part) in data.chunks(chunk as usize).enumerate() {
            staging.write(0, part)?;
            let mut recorder = self.recorder("upload");
            let start = index as u64 * chunk;
            recorder.copy(staging.slice(0, part.len() as u64), buffer.slice(start, part.len() as u64))?;
            self.run(recorder)?;
        }
        Ok(())
    }

    /// Reads a range of a device buffer; blocks.
    pub fn download(&self, slice: impl Into<Slice>) -> Result<Vec<u8>> {
        let slice = slice.into();
        let mut data = vec![0; slice.bytes as usize];
        if data.is_empty() {
            return Ok(data);
        }
        let chunk = STAGING_BYTES.min(slice.bytes);
        let staging = self.buffer("download staging", chunk, Memory::Readback)?;
        for (index, part) in data.chunks_mut(chunk as usize).enumerate() {
            let mut recorder = self.recorder("download");
            let start = slice.start + index as u64 * chunk;
            recorder.copy(slice.buffer.slice(start, part.len() as u64), staging.slice(0, part.len() as u64))?;
            recorder.host_read(&staging);
            self.run(recorder)?;
            staging.read(0, part)?;
        }
        Ok(data)
    }
}
