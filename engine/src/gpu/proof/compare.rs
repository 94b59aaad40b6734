//! Where a device and a twin differ.

use crate::error::Error;
use crate::gpu::kernel::{Access, Binding, Element, Kernel};

/// The first buffer of a dispatch in which a device and the twin differ by more than the kernel's tolerance.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mismatch {
    /// The kernel.
    pub kernel: &'static str,
    /// Which dispatch of it; the kernel's own name when there is only one.
    pub label: String,
    /// The buffer.
    pub buffer: &'static str,
    /// First word that differs.
    pub index: usize,
    /// What the device left there.
    pub found: u32,
    /// What the twin has.
    pub expected: u32,
    /// Words that differ.
    pub count: usize,
    /// Words of the buffer.
    pub of: usize,
    /// The words are floats.
    pub float: bool,
}

impl Mismatch {
    /// What differs, without the kernel's name.
    pub fn why(&self) -> String {
        let show = |word: u32| match self.float {
            true => format!("{} ({word:#010x})", f32::from_bits(word)),
            false => format!("{word} ({word:#010x})"),
        };
        let dispatch = if self.label == self.kernel { String::new() } else { format!("dispatch `{}`: ", self.label) };
        format!(
            "{dispatch}`{}` differs in {} of {} words, first [{}]: found {}, expected {}",
            self.buffer,
            self.count,
            self.of,
            self.index,
            show(self.found),
            show(self.expected)
        )
    }

    /// The same as an error that names the kernel.
    pub fn into_error(self) -> Error {
        Error::Kernel { kernel: self.kernel.into(), why: self.why() }
    }
}

/// Compares every buffer that the kernel writes: integers bit for bit, floats within its tolerance. What may be in any order is
/// arranged before.
pub(super) fn compare(
    kernel: &'static Kernel,
    label: &str,
    found: &[Vec<u32>],
    expected: &[Vec<u32>],
) -> Option<Mismatch> {
    let Some(arrange) = kernel.arrange else { return compare_words(kernel, label, found, expected) };
    let [mut found, mut expected] = [found.to_vec(), expected.to_vec()];
    // What is only read is as it was; a watched recording keeps no second copy of it.
    let read = kernel.bindings.iter().enumerate().filter(|(_, b)| b.access == Access::Read);
    read.for_each(|(i, _)| found[i].clone_from(&expected[i]));
    arrange(&mut found);
    arrange(&mut expected);
    compare_words(kernel, label, &found, &expected)
}

fn compare_words(kernel: &'static Kernel, label: &str, found: &[Vec<u32>], expected: &[Vec<u32>]) -> Option<Mismatch> {
    let written = kernel.bindings.iter().enumerate().filter(|(_, b)| b.access != Access::Read);
    written.into_iter().find_map(|(i, b)| compare_buffer(kernel, label, b, &found[i], &expected[i]))
}

fn compare_buffer(
    kernel: &'static Kernel,
    label: &str,
    binding: &Binding,
    found: &[u32],
    expected: &[u32],
) -> Option<Mismatch> {
    let float = binding.element == Element::F32;
    let differs = |(f, e): (&u32, &u32)| if float { !close(*f, *e, kernel) } else { f != e };
    let mut bad = found.iter().zip(expected).enumerate().filter(|(_, pair)| differs(*pair));
    let (index, (first, twin)) = bad.next()?;
    let count = 1 + bad.count();
    let allowed = if float { (kernel.tolerance.flips * found.len() as f32) as usize } else { 0 };
    let of = found.len();
    let (kernel, label) = (kernel.name, label.to_owned());
    (count > allowed).then_some(Mismatch {
        kernel,
        label,
        buffer: binding.name,
        index,
        found: *first,
        expected: *twin,
        count,
        of,
        float,
    })
}

fn close(found: u32, expected: u32, kernel: &Kernel) -> bool {
    let (f, e) = (f32::from_bits(found), f32::from_bits(expected));
    let tolerance = kernel.tolerance.absolute + kernel.tolerance.relative * e.abs();
    found == expected || (f - e).abs() <= tolerance || (f.is_nan() && e.is_nan() && found != super::POISON)
}
