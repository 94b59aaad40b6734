//! One declaration per kernel. Pipeline, binding check, barriers, the GPU-against-twin test, the bench row and the docs
//! all follow from it.

use std::collections::BTreeMap;

/// What a kernel does with a buffer. Barriers are derived from it; `Read` must be `readonly` in the GLSL and `Write`
/// `writeonly`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// Only reads.
    Read,
    /// Only writes.
    Write,
    /// Reads and writes, each element by one invocation.
    Update,
    /// Atomic updates by many invocations.
    Atomic,
}

/// Element type of a buffer, for comparison and poisoning.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Element {
    /// 32-bit unsigned words (or a struct of them): compared bit for bit.
    U32,
    /// 32-bit floats (or vectors of them): compared within the kernel's tolerance.
    F32,
    /// A struct of several types, laid out as the binding's `layout` says.
    Struct,
    /// Not a buffer: a storage image of a host's, given when a sequence is encoded. Only written; the last binding.
    Image,
}

/// A member of a struct shared between GLSL and Rust: name and byte offset. Checked against the SPIR-V.
pub type Field = (&'static str, u32);

/// One storage buffer (or the image) of a kernel, in binding order (set 0, binding = index in [`Kernel::bindings`]).
#[derive(Debug, Clone, Copy)]
pub struct Binding {
    /// Buffer name, equal to the block's instance or block name in the GLSL; an image's own name.
    pub name: &'static str,
    /// What the kernel does with it.
    pub access: Access,
    /// Element type.
    pub element: Element,
    /// Members, when the element is a struct.
    pub layout: &'static [Field],
    /// A dispatch may leave it out; the kernel does not touch it then.
    pub optional: bool,
}

impl Binding {
    /// A buffer of plain elements.
    pub const fn new(name: &'static str, access: Access, element: Element) -> Self {
        Self { name, access, element, layout: &[], optional: false }
    }

    /// A buffer that holds one struct.
    pub const fn of_struct(name: &'static str, access: Access, layout: &'static [Field]) -> Self {
        Self { name, access, element: Element::Struct, layout, optional: false }
    }

    /// The same, which a dispatch may leave out.
    #[must_use]
    pub const fn optional(self) -> Self {
        Self { optional: true, ..self }
    }
}

/// How far the GPU may be from the twin. Integers are always compared bit for bit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tolerance {
    /// |gpu − twin| ≤ absolute + relative·|twin|.
    pub absolute: f32,
    /// See `absolute`.
    pub relative: f32,
    /// Fraction of elements that may lie outside (threshold flips).
    pub flips: f32,
}

impl Tolerance {
    /// Bit-exact.
    pub const EXACT: Self = Self { absolute: 0.0, relative: 0.0, flips: 0.0 };
}

/// Named amounts of work (`gaussians`, `visible`, `instances`, `tiles`, `pixels`, …) from which a kernel's traffic follows.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Workload(pub BTreeMap<&'static str, u64>);

impl Workload {
    /// Amount by name; 0 when absent.
    pub fn get(&self, name: &str) -> u64 {
        self.0.get(name).copied().unwrap_or(0)
    }
}

/// What a twin gets: the same bindings in the same order, as 32-bit words, the same constants, the same grid.
#[derive(Debug)]
pub struct TwinCall<'a> {
    /// Workgroups in x, y, z.
    pub groups: [u32; 3],
    /// Specialisation constants, by id (0 is always `SUBGROUP_SIZE`).
    pub spec: &'a [u32],
    /// Push constants.
    pub push: &'a [u8],
    /// One word array per binding; empty where an optional one is absent.
    pub buffers: &'a mut [Vec<u32>],
}

/// CPU twin of a kernel: plain loops with the results the kernel must have.
pub type Twin = fn(&mut TwinCall<'_>);

/// A compute kernel.
#[derive(Debug)]
pub struct Kernel {
    /// Name = stem of `glsl/<name>.comp` and `spirv_cache/<name>.spv` = label of timings and breadcrumbs.
    pub name: &'static str,
    /// One line for the docs and the bench table.
    pub doc: &'static str,
    /// Workgroup size in x (y = z = 1); the most of a kernel that has [`Self::THREADS`].
    pub local_size: u32,
    /// Names of the specialisation constants; the id is the index; 0 is `SUBGROUP_SIZE`. All are u32.
    pub spec: &'static [&'static str],
    /// Members of the push-constant block (≤ 128 bytes), empty for none.
    pub push: &'static [Field],
    /// Storage buffers, binding = index.
    pub bindings: &'static [Binding],
    /// CPU twin.
    pub twin: Twin,
    /// Brings what may be left in any order, as atomics have it, into one, in the words of each binding: both sides are arranged
    /// before they are compared.
    pub arrange: Option<fn(&mut [Vec<u32>])>,
    /// GPU-against-twin tolerance for float elements.
    pub tolerance: Tolerance,
    /// Bytes that an ideal implementation moves, for the roofline.
    pub bytes: fn(&Workload) -> u64,
    /// The committed SPIR-V.
    pub spirv: &'static [u8],
}

impl Kernel {
    /// The specialisation constant that says how many threads a workgroup has. The module is changed to that size: naga has no
    /// `LocalSizeId`.
    pub const THREADS: &'static str = "THREADS";

    /// Threads of a workgroup for these specialisation constants, from id 0 on.
    pub fn threads(&self, constants: &[u32]) -> u32 {
        let named = self.spec.iter().zip(constants).find(|(name, _)| **name == Self::THREADS);
        named.map_or(self.local_size, |(_, threads)| *threads)
    }

    /// Its bindings that are buffers; and whether it writes an image too, whose first pixel is pushed (`x`, `y`).
    pub fn buffers(&self) -> (&'static [Binding], bool) {
        match self.bindings {
            [buffers @ .., Binding { element: Element::Image, .. }] => (buffers, true),
            buffers => (buffers, false),
        }
    }
}
