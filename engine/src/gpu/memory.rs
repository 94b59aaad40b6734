//! Named buffers over `gpu-allocator`, with a byte budget; blocking uploads and downloads through staging.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme};

use super::device::{Gpu, Shared, lock, vk_error};
use crate::error::{Error, Result};

/// Bytes moved by one staging copy.
const STAGING_BYTES: u64 = 32 << 20;

/// Where a buffer lives and who touches it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Memory {
    /// Device memory; filled by [`Gpu::upload`].
    Device,
    /// Mapped; the host writes, the device reads.
    Upload,
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

    /// Writes mapped memory. The device must not be reading it (the caller waits for the submission that does).
    pub fn write(&self, offset: u64, data: &[u8]) -> Result<()> {
        let (pointer, _) = self.mapped(offset, data.len() as u64, Memory::Upload)?;
        // SAFETY: `mapped` checked the range; the memory is mapped for the allocation's life, and no Rust reference
        // to it exists.
        unsafe { std::ptr::copy_nonoverlapping(data.as_ptr(), pointer, data.len()) };
        Ok(())
    }

    /// Reads mapped memory. The device must have finished writing it and the recording must end with `host_read`.
    pub fn read(&self, offset: u64, data: &mut [u8]) -> Result<()> {
        let (pointer, _) = self.mapped(offset, data.len() as u64, Memory::Readback)?;
        // SAFETY: as in `write`.
        unsafe { std::ptr::copy_nonoverlapping(pointer, data.as_mut_ptr(), data.len()) };
        Ok(())
    }

    /// Fills mapped read-back memory from the host, so that tests and breadcrumbs start from a known state.
    pub fn write_readback(&self, offset: u64, data: &[u8]) -> Result<()> {
        let (pointer, _) = self.mapped(offset, data.len() as u64, Memory::Readback)?;
        // SAFETY: as in `write`.
        unsafe { std::ptr::copy_nonoverlapping(data.as_ptr(), pointer, data.len()) };
        Ok(())
    }

    /// Fills mapped read-back memory with zeros.
    pub(super) fn clear_readback(&self) -> Result<()> {
        let (pointer, bytes) = self.mapped(0, self.0.bytes, Memory::Readback)?;
        // SAFETY: as in `write`.
        unsafe { std::ptr::write_bytes(pointer, 0, bytes as usize) };
        Ok(())
    }

    fn mapped(&self, offset: u64, bytes: u64, expected: Memory) -> Result<(*mut u8, u64)> {
        if self.0.memory != expected {
            return Err(Error::usage(
                format!("buffer `{}`", self.0.name),
                format!("{:?}", self.0.memory),
                format!("{expected:?}"),
            ));
        }
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
        self.charge(name, bytes)?;
        let made = self.make_buffer(name, bytes, memory);
        if made.is_err() {
            self.0.memory.used.fetch_sub(bytes, Ordering::SeqCst);
        }
        made
    }

    fn charge(&self, name: &str, bytes: u64) -> Result<()> {
        let account = &self.0.memory;
        let budget = account.budget.load(Ordering::SeqCst);
        let used = account.used.fetch_add(bytes, Ordering::SeqCst);
        let injected = account.fail_at.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |n| n.checked_sub(1)) == Ok(1);
        if injected || used.checked_add(bytes).is_none_or(|total| total > budget) {
            account.used.fetch_sub(bytes, Ordering::SeqCst);
            return Err(Error::OutOfMemory {
                name: name.into(),
                need: bytes,
                free: budget.saturating_sub(used),
                budget,
            });
        }
        Ok(())
    }

    fn make_buffer(&self, name: &str, bytes: u64, memory: Memory) -> Result<Buffer> {
        let shared = &self.0;
        let create = vk::BufferCreateInfo::default().size(bytes).sharing_mode(vk::SharingMode::EXCLUSIVE).usage(
            vk::BufferUsageFlags::STORAGE_BUFFER
                | vk::BufferUsageFlags::TRANSFER_SRC
                | vk::BufferUsageFlags::TRANSFER_DST
                | vk::BufferUsageFlags::INDIRECT_BUFFER
                | vk::BufferUsageFlags::VERTEX_BUFFER
                | vk::BufferUsageFlags::INDEX_BUFFER,
        );
        let out_of_memory = || {
            let budget = shared.memory.budget.load(Ordering::SeqCst);
            let free = budget.saturating_sub(shared.memory.used.load(Ordering::SeqCst));
            Error::OutOfMemory { name: name.into(), need: bytes, free, budget }
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
            Memory::Upload => MemoryLocation::CpuToGpu,
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
        static NEXT_ID: std::sync::atomic::AtomicU64 = std::sync::atomic::AtomicU64::new(1);
        shared.memory.objects.fetch_add(1, Ordering::SeqCst);
        Ok(Buffer(Arc::new(BufferInner {
            raw,
            allocation: Some(allocation),
            name: name.into(),
            bytes,
            charged: bytes,
            id: NEXT_ID.fetch_add(1, Ordering::Relaxed),
            memory,
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

    /// Bytes allocated now, and the budget.
    pub fn memory_used(&self) -> (u64, u64) {
        (self.0.memory.used.load(Ordering::SeqCst), self.0.memory.budget.load(Ordering::SeqCst))
    }

    /// Number of live buffers.
    pub fn buffer_count(&self) -> u64 {
        self.0.memory.objects.load(Ordering::SeqCst)
    }

    /// Changes the byte budget; what is allocated already stays.
    pub fn set_byte_budget(&self, bytes: u64) {
        self.0.memory.budget.store(bytes, Ordering::SeqCst);
    }

    /// Test seam: the n-th allocation from now fails with [`Error::OutOfMemory`] (0 = never).
    pub fn inject_allocation_failure(&self, allocation: u64) {
        self.0.memory.fail_at.store(allocation, Ordering::SeqCst);
    }
}
