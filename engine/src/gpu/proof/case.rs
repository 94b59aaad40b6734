//! One kernel on given buffers, with sentinels around every buffer and poison in every buffer that it only writes.

use super::compare::{Mismatch, compare};
use super::{POISON, words_of};
use crate::error::{Error, Result};
use crate::gpu::interface::{Constants as _, Interface, KernelOf, into_words};
use crate::gpu::kernel::{Access, Binding, Kernel, TwinCall};
use crate::gpu::{Buffer, Gpu, Groups, Slice};

/// Bytes of sentinel before and after each bound range.
pub const SENTINEL_BYTES: usize = 4096;
const SENTINEL: u32 = 0xDEAD_BEEF;
const PAD: usize = SENTINEL_BYTES / 4;

/// Input of one comparison.
#[derive(Debug, Clone)]
pub struct KernelCase {
    /// The kernel.
    pub kernel: &'static Kernel,
    /// Specialisation constants from id 1 on.
    pub spec: Vec<u32>,
    /// Push constants.
    pub push: Vec<u8>,
    /// Words of each binding before the run (write-only buffers are poisoned).
    pub buffers: Vec<Vec<u32>>,
    /// Workgroups.
    pub groups: u32,
}

/// What both sides left in the buffers.
#[derive(Debug)]
pub struct KernelResult {
    /// The kernel.
    pub kernel: &'static Kernel,
    /// From the device.
    pub gpu: Vec<Vec<u32>>,
    /// From the twin.
    pub twin: Vec<Vec<u32>>,
}

/// A range in the middle of a buffer with sentinels on both sides.
struct Framed {
    buffer: Buffer,
    words: usize,
}

impl Framed {
    fn upload(gpu: &Gpu, name: &str, words: &[u32]) -> Result<Self> {
        let mut framed = vec![SENTINEL; PAD];
        framed.extend(words);
        framed.resize(PAD + words.len() + PAD, SENTINEL);
        let buffer = gpu.buffer_with(name, bytemuck::cast_slice(&framed))?;
        Ok(Self { buffer, words: words.len() })
    }

    fn slice(&self) -> Slice {
        self.buffer.slice(SENTINEL_BYTES as u64, 4 * self.words as u64)
    }

    /// What lies between the sentinels; the error says which of them was overwritten.
    fn download(&self, gpu: &Gpu, kernel: &Kernel) -> Result<Vec<u32>> {
        let framed = words_of(&gpu.download(&self.buffer)?);
        inner(&framed, self.words).map_err(|side| Error::Kernel {
            kernel: kernel.name.into(),
            why: format!("`{}` was written {side}", self.buffer.name()),
        })
    }
}

impl KernelCase {
    /// A case by name.
    pub fn new<I: Interface>(
        kernel: &'static KernelOf<I>,
        constants: I::Constants,
        push: I::Push,
        buffers: I::Buffers<Vec<u32>>,
        groups: u32,
    ) -> Self {
        Self {
            kernel: &kernel.kernel,
            spec: constants.to_words(),
            push: bytemuck::bytes_of(&push).to_vec(),
            buffers: into_words::<I>(buffers),
            groups,
        }
    }

    /// Runs both sides.
    ///
    /// # Errors
    /// `Kernel` when a sentinel was overwritten; `OutOfMemory`, `Vulkan`, `DeviceLost`.
    pub fn run(mut self, gpu: &Gpu) -> Result<KernelResult> {
        self.poison();
        let device = self.run_device(gpu)?;
        let subgroup_size = gpu.subgroup_size_of(self.kernel);
        Ok(self.with_twin(subgroup_size, device))
    }

    /// Poisons what is only written; empty buffers get four words, because a binding cannot be empty, but for optional ones,
    /// which are absent.
    pub fn poison(&mut self) {
        for (words, binding) in self.buffers.iter_mut().zip(self.kernel.bindings) {
            if words.is_empty() && !binding.optional {
                words.resize(4, 0);
            }
            if binding.access == Access::Write {
                words.fill(POISON);
            }
        }
    }

    /// Runs the twin on the poisoned buffers, beside what `device` made of them.
    pub fn with_twin(mut self, subgroup_size: u32, device: Vec<Vec<u32>>) -> KernelResult {
        let mut spec = vec![subgroup_size];
        spec.extend(&self.spec);
        let mut call =
            TwinCall { groups: [self.groups, 1, 1], spec: &spec, push: &self.push, buffers: &mut self.buffers };
        (self.kernel.twin)(&mut call);
        KernelResult { kernel: self.kernel, gpu: device, twin: self.buffers }
    }

    fn run_device(&self, gpu: &Gpu) -> Result<Vec<Vec<u32>>> {
        let framed = |(words, binding): (&Vec<u32>, &Binding)| {
            (!words.is_empty()).then(|| Framed::upload(gpu, binding.name, words)).transpose()
        };
        let framed: Vec<Option<Framed>> =
            self.buffers.iter().zip(self.kernel.bindings).map(framed).collect::<Result<_>>()?;
        let slices: Vec<Option<Slice>> = framed.iter().map(|f| f.as_ref().map(Framed::slice)).collect();
        let mut r = gpu.recorder(self.kernel.name);
        let groups = Groups::Direct(self.groups.into());
        r.record_dispatch(self.kernel.name, self.kernel, &self.spec, &self.push, &slices, groups)?;
        gpu.run(r)?;
        let download = |f: &Option<Framed>| f.as_ref().map_or(Ok(Vec::new()), |f| f.download(gpu, self.kernel));
        framed.iter().map(download).collect()
    }
}

/// The words between the sentinels; which of them was overwritten, if any.
fn inner(framed: &[u32], length: usize) -> std::result::Result<Vec<u32>, &'static str> {
    let end = PAD + length;
    if framed[..PAD].iter().any(|w| *w != SENTINEL) {
        return Err("before its start");
    }
    if framed[end..end + PAD].iter().any(|w| *w != SENTINEL) {
        return Err("past its end");
    }
    Ok(framed[PAD..end].to_vec())
}

impl KernelResult {
    /// See [`mismatch`](super::mismatch).
    pub fn mismatch(&self) -> Option<Mismatch> {
        compare(self.kernel, self.kernel.name, &self.gpu, &self.twin)
    }
}
