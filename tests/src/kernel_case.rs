//! Runs a kernel on the device and its CPU twin on the same input, with sentinels around every buffer and poison in
//! every buffer that the kernel only writes, and compares.

use engine::gpu::kernel::{Access, Element, Kernel, TwinCall};
use engine::gpu::{Gpu, Groups, Memory};

use crate::model::{self, Options};

/// Bytes of sentinel before and after each bound range.
pub const SENTINEL_BYTES: usize = 4096;
const SENTINEL: u32 = 0xDEAD_BEEF;
/// A quiet NaN with a recognisable payload: an element that stays so was never written.
pub const POISON: u32 = 0x7FC0_DEAD;

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
    /// From the device, or the model in its place.
    pub gpu: Vec<Vec<u32>>,
    /// From the twin.
    pub twin: Vec<Vec<u32>>,
}

impl KernelCase {
    /// Runs both sides; with `SPGS_TEST_MODEL` the executable model in place of the device ([`crate::model`]).
    ///
    /// # Panics
    /// When the device fails, a sentinel was overwritten, or the model finds an error.
    pub fn run(mut self, gpu: &Gpu) -> KernelResult {
        if let Some(options) = model::options() {
            return self.run_model(&options);
        }
        self.poison();
        let result = self.run_gpu(gpu);
        let subgroup_size = gpu.subgroup_size_of(self.kernel);
        self.with_twin(subgroup_size, result)
    }

    /// Runs the executable model and the twin.
    ///
    /// # Panics
    /// When the model finds an error.
    pub fn run_model(mut self, options: &Options) -> KernelResult {
        self.poison();
        let result = model::run(&self, options);
        self.with_twin(options.lanes, result)
    }

    fn poison(&mut self) {
        for (words, binding) in self.buffers.iter_mut().zip(self.kernel.bindings) {
            if words.is_empty() {
                words.resize(4, 0);
            }
            if binding.access == Access::Write {
                words.fill(POISON);
            }
        }
    }

    fn with_twin(mut self, subgroup_size: u32, result: Vec<Vec<u32>>) -> KernelResult {
        let mut spec = vec![subgroup_size];
        spec.extend(&self.spec);
        let mut call =
            TwinCall { groups: [self.groups, 1, 1], spec: &spec, push: &self.push, buffers: &mut self.buffers };
        (self.kernel.twin)(&mut call);
        KernelResult { gpu: result, twin: self.buffers }
    }

    fn run_gpu(&self, gpu: &Gpu) -> Vec<Vec<u32>> {
        let pad = SENTINEL_BYTES / 4;
        let mut slices = Vec::new();
        for (words, binding) in self.buffers.iter().zip(self.kernel.bindings) {
            let mut framed = vec![SENTINEL; pad];
            framed.extend(words);
            framed.resize(pad + words.len() + pad, SENTINEL);
            let bytes: &[u8] = bytemuck::cast_slice(&framed);
            let buffer = gpu.buffer(binding.name, bytes.len() as u64, Memory::Device).unwrap();
            gpu.upload(&buffer, bytes).unwrap();
            slices.push(buffer.slice(SENTINEL_BYTES as u64, 4 * words.len() as u64));
        }
        let mut recorder = gpu.recorder(self.kernel.name);
        recorder.dispatch(self.kernel, &self.spec, &self.push, &slices, Groups::Direct(self.groups.into())).unwrap();
        gpu.run(recorder).unwrap();
        let read = |slice: &engine::gpu::Slice, name: &str| {
            let bytes = gpu.download(slice.buffer.slice(0, slice.bytes + 2 * SENTINEL_BYTES as u64)).unwrap();
            let words: Vec<u32> = bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
            let end = pad + slice.bytes as usize / 4;
            assert!(words[..pad].iter().all(|w| *w == SENTINEL), "{name}: written before its start");
            assert!(words[end..].iter().all(|w| *w == SENTINEL), "{name}: written past its end");
            words[pad..end].to_vec()
        };
        slices.iter().zip(self.kernel.bindings).map(|(s, b)| read(s, b.name)).collect()
    }
}

impl KernelResult {
    /// Asserts that every buffer agrees: integers bit for bit, floats within the kernel's tolerance.
    ///
    /// # Panics
    /// When they do not.
    pub fn assert_equal(&self, kernel: &Kernel, context: &str) {
        for (i, binding) in kernel.bindings.iter().enumerate() {
            if binding.access == Access::Read {
                continue;
            }
            let (g, t) = (&self.gpu[i], &self.twin[i]);
            let exact = binding.element != Element::F32;
            let bad: Vec<usize> =
                (0..g.len()).filter(|&k| if exact { g[k] != t[k] } else { !close(g[k], t[k], kernel) }).collect();
            let allowed = if exact { 0 } else { (kernel.tolerance.flips * g.len() as f32) as usize };
            if bad.len() > allowed {
                let k = bad[0];
                let show = |w: u32| format!("{w:#x} ({})", f32::from_bits(w));
                panic!(
                    "{} {context}: `{}` differs in {} of {} words (allowed {allowed}); first [{k}]: gpu {}, twin {}",
                    kernel.name,
                    binding.name,
                    bad.len(),
                    g.len(),
                    show(g[k]),
                    show(t[k])
                );
            }
        }
    }
}

fn close(gpu: u32, twin: u32, kernel: &Kernel) -> bool {
    let (g, t) = (f32::from_bits(gpu), f32::from_bits(twin));
    let tolerance = kernel.tolerance.absolute + kernel.tolerance.relative * t.abs();
    gpu == twin || (g - t).abs() <= tolerance || (g.is_nan() && t.is_nan())
}
