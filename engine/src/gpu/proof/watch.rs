//! Looking over the shoulder of a recording: before and after each dispatch its buffers are copied for the host, which
//! gives them to the twin.

use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex};

use super::compare::{Mismatch, compare};
use super::{POISON, words_of};
use crate::error::{Error, Result};
use crate::gpu::device::lock;
use crate::gpu::kernel::{Access, Kernel, TwinCall};
use crate::gpu::operation::Grid;
use crate::gpu::{Buffer, Gpu, Memory, Recorder, Slice};

/// Bytes of a buffer that copies are kept in; a longer copy gets one of its own.
const ARENA_BYTES: u64 = 4 << 20;

/// Arguments of dispatches: poison would be two thousand million workgroups.
const INDIRECT: &str = "indirect";

/// What a dispatch that has run leaves; a recording may be one of several that are made at once and never be submitted.
const RAN: u32 = 0x5afe_5afe;

/// What the dispatches did that were recorded with [`Gpu::watched`].
#[derive(Debug, Default)]
pub struct Watch {
    seen: Mutex<Vec<Dispatch>>,
    /// The buffer that the next copy goes to, and how much of it is in use.
    arena: Mutex<Option<(Buffer, u64)>>,
    /// Buffers that a dispatch has been given, or that were filled otherwise.
    used: Mutex<BTreeSet<u64>>,
}

/// One dispatch: its arguments, and where its buffers were copied to.
#[derive(Debug)]
struct Dispatch {
    label: String,
    kernel: &'static Kernel,
    spec: Vec<u32>,
    push: Vec<u8>,
    groups: Counts,
    /// Per binding; `None` for poison.
    before: Vec<Option<Slice>>,
    /// Per binding; `None` for what is only read.
    after: Vec<Option<Slice>>,
    words: Vec<usize>,
    /// A word that is [`RAN`] once the dispatch has run.
    ran: Slice,
}

/// Workgroups in x, y, z: known, or in a copy of the indirect arguments.
#[derive(Debug)]
enum Counts {
    Known([u32; 3]),
    Copied(Slice),
}

/// What was copied before a dispatch.
pub(in crate::gpu) struct Before {
    groups: Counts,
    copies: Vec<Option<Slice>>,
}

impl Gpu {
    /// The same device, but whatever is recorded with it is watched: buffers that are first used to be
    /// written are poisoned, and those of every dispatch are kept from before and after. For small inputs: each dispatch copies all its buffers.
    pub fn watched(&self) -> (Self, Arc<Watch>) {
        let watch = Arc::new(Watch::default());
        (Self(Arc::clone(&self.0), Some(Arc::clone(&watch))), watch)
    }
}

impl Watch {
    /// Gives the input of each dispatch that has run to its twin and compares what it left. No recording has run twice.
    /// The first dispatch that differs is the one to blame: what follows works on its result.
    ///
    /// # Errors
    /// `Usage` when a copy cannot be read; `Kernel` when nothing was recorded that has run, or an input makes no sense.
    pub fn mismatch(&self) -> Result<Option<Mismatch>> {
        let seen = lock(&self.seen);
        let mut run = Vec::with_capacity(seen.len());
        for dispatch in seen.iter() {
            if read(&dispatch.ran)? == [RAN] {
                run.push(dispatch);
            }
        }
        if run.is_empty() {
            let why = format!("none of {} recorded dispatches has run", seen.len());
            return Err(Error::Kernel { kernel: "vkCmdDispatch".into(), why });
        }
        for dispatch in run {
            if let Some(mismatch) = dispatch.mismatch()? {
                return Ok(Some(mismatch));
            }
        }
        Ok(None)
    }

    /// Notes that a buffer holds something from now on; whether that is new.
    pub(in crate::gpu) fn filled(&self, buffer: u64) -> bool {
        lock(&self.used).insert(buffer)
    }

    /// Names of the kernels that were recorded, each once.
    pub fn kernels(&self) -> BTreeSet<&'static str> {
        lock(&self.seen).iter().map(|d| d.kernel.name).collect()
    }

    /// A place for a copy.
    fn keep(&self, gpu: &Gpu, bytes: u64) -> Result<Slice> {
        let mut arena = lock(&self.arena);
        let aligned = bytes.next_multiple_of(16);
        let room = arena.as_ref().is_some_and(|(buffer, used)| used + aligned <= buffer.bytes());
        if !room {
            let buffer = gpu.buffer("watched", aligned.max(ARENA_BYTES), Memory::Readback)?;
            buffer.write_readback(0, &vec![0; buffer.bytes() as usize])?;
            *arena = Some((buffer, 0));
        }
        let Some((buffer, used)) = arena.as_mut() else {
            return Err(Error::usage("watched recording", "no buffer", "one"));
        };
        let slice = buffer.slice(*used, bytes);
        *used += aligned;
        Ok(slice)
    }

    fn copy(&self, gpu: &Gpu, r: &mut Recorder, slice: &Slice) -> Result<Slice> {
        let kept = self.keep(gpu, slice.bytes)?;
        r.copy(slice, &kept)?;
        Ok(kept)
    }

    /// Records what is kept from before a dispatch.
    pub(in crate::gpu) fn before(
        &self,
        gpu: &Gpu,
        r: &mut Recorder,
        kernel: &Kernel,
        buffers: &[Option<Slice>],
        grid: &Grid,
    ) -> Result<Before> {
        let groups = match grid {
            Grid::Indirect(buffer, offset) => Counts::Copied(self.copy(gpu, r, &buffer.slice(*offset, 12))?),
            Grid::Direct(counts) => Counts::Known(*counts),
        };
        let mut copies = Vec::with_capacity(buffers.len());
        for (slice, binding) in buffers.iter().zip(kernel.bindings) {
            let Some(slice) = slice else {
                copies.push(None);
                continue;
            };
            // Of what is not fresh a kernel that only writes may leave a part as it is.
            let fresh = self.filled(slice.buffer.id());
            let poisoned = binding.access == Access::Write && fresh;
            copies.push(if poisoned && binding.name != INDIRECT {
                r.fill(slice, POISON)?;
                None
            } else {
                if poisoned {
                    r.fill(slice, 0)?;
                }
                Some(self.copy(gpu, r, slice)?)
            });
        }
        Ok(Before { groups, copies })
    }

    /// Records what is kept from after it.
    pub(in crate::gpu) fn after(
        &self,
        gpu: &Gpu,
        r: &mut Recorder,
        (label, kernel): (&str, &'static Kernel),
        (spec, push): (&[u32], &[u8]),
        buffers: &[Option<Slice>],
        before: Before,
    ) -> Result<()> {
        let mut after = Vec::with_capacity(buffers.len());
        for (slice, binding) in buffers.iter().zip(kernel.bindings) {
            let written = slice.as_ref().filter(|_| binding.access != Access::Read);
            after.push(written.map(|slice| self.copy(gpu, r, slice)).transpose()?);
        }
        let mut all = vec![gpu.subgroup_size_of(kernel)];
        all.extend(spec);
        let ran = self.keep(gpu, 4)?;
        r.fill(&ran, RAN)?;
        lock(&self.seen).push(Dispatch {
            ran,
            label: label.to_owned(),
            kernel,
            spec: all,
            push: push.to_vec(),
            groups: before.groups,
            before: before.copies,
            after,
            words: buffers.iter().map(|s| s.as_ref().map_or(0, |s| s.bytes as usize / 4)).collect(),
        });
        Ok(())
    }

    /// Where the copies are; a recording that ends makes them visible to the host.
    pub(in crate::gpu) fn buffers(&self) -> Vec<Buffer> {
        let mut found: Vec<Buffer> = Vec::new();
        for dispatch in lock(&self.seen).iter() {
            let groups = if let Counts::Copied(slice) = &dispatch.groups { Some(slice) } else { None };
            for slice in dispatch.before.iter().chain(&dispatch.after).flatten().chain(groups).chain([&dispatch.ran]) {
                if !found.iter().any(|b| b.id() == slice.buffer.id()) {
                    found.push(slice.buffer.clone());
                }
            }
        }
        found
    }
}

fn read(slice: &Slice) -> Result<Vec<u32>> {
    let mut bytes = vec![0; slice.bytes as usize];
    slice.buffer.read(slice.start, &mut bytes)?;
    Ok(words_of(&bytes))
}

impl Dispatch {
    fn mismatch(&self) -> Result<Option<Mismatch>> {
        let sides = self.before.iter().zip(&self.after).zip(&self.words);
        let (mut twin, mut device) = (Vec::new(), Vec::new());
        for ((before, after), words) in sides {
            twin.push(before.as_ref().map_or_else(|| Ok(vec![POISON; *words]), read)?);
            device.push(after.as_ref().map_or_else(|| Ok(Vec::new()), read)?);
        }
        let groups = match &self.groups {
            Counts::Known(groups) => *groups,
            Counts::Copied(slice) => {
                let words = read(slice)?;
                [words[0], words[1], words[2]]
            }
        };
        let mut call = TwinCall { groups, spec: &self.spec, push: &self.push, buffers: &mut twin };
        // What came from a device is not to be trusted: a twin may stumble over it.
        if catch_unwind(AssertUnwindSafe(|| (self.kernel.twin)(&mut call))).is_err() {
            let why = format!("dispatch `{}`: its input makes no sense", self.label);
            return Err(Error::Kernel { kernel: self.kernel.name.into(), why });
        }
        Ok(compare(self.kernel, &self.label, &device, &twin))
    }
}
