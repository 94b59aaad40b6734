//! Reads through texel buffers, for Mesa's software driver.
//!
//! Its loads from storage buffers go lane by lane, each through memory that it has only just written: 220 ns for four floats of
//! eight lanes with Mesa 22.3, and 50 to 84 with the version of Debian's backports. The same from a texel buffer are 15 and 18 to 36. So
//! where that driver is, the words that it gets read arrays of 32-bit numbers or vectors of four from texel buffers: what is
//! `readonly` is bound as one, what is written too is bound a second time, to be read from. Kernels know nothing of it.
//!
//! An invocation sees what it wrote itself, because the driver reads memory when it is told to; what others wrote is behind a
//! barrier, or declared as [`Access::Atomic`] and left alone.

use std::collections::{BTreeMap, BTreeSet};

use ash::vk;

use super::device::vk_error;
use super::kernel::{Access, Binding};
use super::memory::Slice;
use super::spirv::instructions;
use crate::error::Result;

/// Bytes of the largest texel.
const TEXEL_BYTES: u64 = 16;
const HEADER_WORDS: usize = 5;
const BOUND: usize = 3;
const OP_NAME: u32 = 5;
const OP_ENTRY_POINT: u32 = 15;
const OP_CAPABILITY: u32 = 17;
const OP_TYPE_INT: u32 = 21;
const OP_TYPE_FLOAT: u32 = 22;
const OP_TYPE_VECTOR: u32 = 23;
const OP_TYPE_IMAGE: u32 = 25;
const OP_TYPE_RUNTIME_ARRAY: u32 = 29;
const OP_TYPE_STRUCT: u32 = 30;
const OP_TYPE_POINTER: u32 = 32;
const OP_CONSTANT: u32 = 43;
const OP_FUNCTION: u32 = 54;
const OP_FUNCTION_CALL: u32 = 57;
const OP_VARIABLE: u32 = 59;
const OP_LOAD: u32 = 61;
const OP_STORE: u32 = 62;
const OP_COPY_MEMORY: u32 = 63;
const OP_ACCESS_CHAIN: u32 = 65;
const OP_IN_BOUNDS_ACCESS_CHAIN: u32 = 66;
const OP_DECORATE: u32 = 71;
const OP_MEMBER_DECORATE: u32 = 72;
const OP_VECTOR_EXTRACT_DYNAMIC: u32 = 77;
const OP_COMPOSITE_EXTRACT: u32 = 81;
const OP_IMAGE_READ: u32 = 98;
const CAPABILITY_IMAGE_BUFFER: u32 = 47;
const DECORATION_NON_WRITABLE: u32 = 24;
const DECORATION_BINDING: u32 = 33;
const DECORATION_DESCRIPTOR_SET: u32 = 34;
const UNIFORM_CONSTANT: u32 = 0;
const STORAGE_BUFFER: u32 = 12;
const DIM_BUFFER: u32 = 5;
/// `OpTypeImage` without a sampler.
const STORAGE: u32 = 2;

/// What an array holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Element {
    Float,
    Uint,
    FourFloats,
    FourUints,
}

impl Element {
    const ALL: [Self; 4] = [Self::Float, Self::Uint, Self::FourFloats, Self::FourUints];

    fn is_vector(self) -> bool {
        matches!(self, Self::FourFloats | Self::FourUints)
    }

    fn is_float(self) -> bool {
        matches!(self, Self::Float | Self::FourFloats)
    }

    /// `ImageFormat` of SPIR-V.
    fn image_format(self) -> u32 {
        match self {
            Self::Float => 3,
            Self::Uint => 33,
            Self::FourFloats => 1,
            Self::FourUints => 30,
        }
    }

    fn format(self) -> vk::Format {
        match self {
            Self::Float => vk::Format::R32_SFLOAT,
            Self::Uint => vk::Format::R32_UINT,
            Self::FourFloats => vk::Format::R32G32B32A32_SFLOAT,
            Self::FourUints => vk::Format::R32G32B32A32_UINT,
        }
    }
}

/// Bindings from here on are second ones, of what is written too.
const SECOND: u32 = 32;

/// Which bindings of a kernel are texel buffers.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Texels {
    /// Bits of the bindings, by element.
    of: [u64; 4],
}

impl Texels {
    /// Format of a binding's texels; `None` of a storage buffer.
    pub(super) fn format(self, binding: u32) -> Option<vk::Format> {
        let has = |e: &&Element| self.of[**e as usize].checked_shr(binding).unwrap_or(0) & 1 == 1;
        Element::ALL.iter().find(has).map(|e| e.format())
    }

    /// Second bindings.
    pub(super) fn second(self) -> impl Iterator<Item = u32> {
        (SECOND..2 * SECOND).filter(move |binding| self.has(*binding))
    }

    /// A view for each binding that is a texel buffer.
    pub(super) fn views(self, device: &ash::Device, slices: &[Slice]) -> Result<Vec<(u32, vk::BufferView)>> {
        let mut views = Vec::new();
        for (binding, slice) in (0..).zip(slices) {
            for binding in [binding, SECOND + binding] {
                let Some(format) = self.format(binding) else { continue };
                // Whole texels: a buffer ends with one, whatever of it is bound.
                let bytes = slice.bytes.next_multiple_of(TEXEL_BYTES).min(slice.buffer.bytes() - slice.start);
                let create = vk::BufferViewCreateInfo::default()
                    .buffer(slice.buffer.raw())
                    .format(format)
                    .offset(slice.start)
                    .range(bytes);
                // SAFETY: plain creation within the buffer; the caller destroys it.
                match unsafe { device.create_buffer_view(&create, None) } {
                    Ok(view) => views.push((binding, view)),
                    Err(code) => {
                        destroy(device, &views);
                        return Err(vk_error("vkCreateBufferView")(code));
                    }
                }
            }
        }
        Ok(views)
    }

    /// Whether a binding is a texel buffer.
    pub fn has(self, binding: u32) -> bool {
        self.format(binding).is_some()
    }

    /// Bindings that are texel buffers.
    pub fn count(self) -> u32 {
        self.of.iter().map(|bits| bits.count_ones()).sum()
    }

    fn with(mut self, binding: u32, element: Element) -> Self {
        self.of[element as usize] |= 1 << binding;
        self
    }
}

/// Destroys views that nothing uses any more.
pub(super) fn destroy(device: &ash::Device, views: &[(u32, vk::BufferView)]) {
    // SAFETY: promised by the caller.
    views.iter().for_each(|(_, view)| unsafe { device.destroy_buffer_view(*view, None) });
}

/// An array that is read element by element.
#[derive(Debug, Clone, Copy)]
struct Array {
    binding: u32,
    element: Element,
    /// It is bound a second time, because it is written too.
    is_written: bool,
    is_read: bool,
}

impl Array {
    /// Where its texels are bound.
    fn texels(&self) -> u32 {
        self.binding + if self.is_written { SECOND } else { 0 }
    }
}

/// Where a pointer points: an element, or a component of it.
#[derive(Debug, Clone, Copy)]
struct Place {
    variable: u32,
    index: u32,
    component: Option<u32>,
}

/// What a module declares, as far as it matters here.
#[derive(Debug, Default)]
struct Declared {
    float: Option<u32>,
    uint: Option<u32>,
    /// By component type.
    vectors: BTreeMap<u32, u32>,
    constants: BTreeMap<u32, u32>,
    arrays: BTreeMap<u32, Array>,
    places: BTreeMap<u32, Place>,
}

/// The module of a kernel with these bindings, of which it reads up to `most` as texels, the first ones; and which these are.
pub fn with_texel_reads(words: &[u32], bindings: &[Binding], most: u32) -> (Vec<u32>, Texels) {
    let declared = declared(words, bindings, most);
    let texels = declared.arrays.values().fold(Texels::default(), |all, a| all.with(a.texels(), a.element));
    if texels.count() == 0 { (words.to_vec(), texels) } else { (rewritten(words, &declared), texels) }
}

fn declared(words: &[u32], kernel: &[Binding], most: u32) -> Declared {
    let mut d = Declared::default();
    let (mut readonly, mut bindings) = (BTreeSet::new(), BTreeMap::new());
    // Types by id: what an array holds, the array in a struct of its own, and what a pointer points to.
    let (mut elements, mut held, mut wrapped, mut pointed) =
        (BTreeMap::new(), BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
    for (op, operands) in instructions(words) {
        match (op, operands) {
            (OP_MEMBER_DECORATE, [id, 0, DECORATION_NON_WRITABLE, ..]) => _ = readonly.insert(*id),
            (OP_DECORATE, [id, DECORATION_BINDING, binding]) if *binding < 32 => _ = bindings.insert(*id, *binding),
            (OP_TYPE_FLOAT, [id, 32, ..]) => {
                d.float = Some(*id);
                elements.insert(*id, Element::Float);
            }
            (OP_TYPE_INT, [id, 32, 0]) => {
                d.uint = Some(*id);
                elements.insert(*id, Element::Uint);
            }
            (OP_TYPE_VECTOR, [id, of, 4]) => {
                d.vectors.insert(*of, *id);
                match elements.get(of) {
                    Some(Element::Float) => _ = elements.insert(*id, Element::FourFloats),
                    Some(Element::Uint) => _ = elements.insert(*id, Element::FourUints),
                    _ => {}
                }
            }
            (OP_TYPE_RUNTIME_ARRAY, [id, of]) => _ = held.insert(*id, *of),
            (OP_TYPE_STRUCT, [id, only]) => _ = wrapped.insert(*id, *only),
            (OP_TYPE_POINTER, [id, STORAGE_BUFFER, to]) => _ = pointed.insert(*id, *to),
            (OP_CONSTANT, [_, id, value]) => _ = d.constants.insert(*id, *value),
            (OP_VARIABLE, [ty, id, STORAGE_BUFFER]) => {
                let block = pointed.get(ty).copied().unwrap_or_default();
                let element = wrapped.get(&block).and_then(|array| held.get(array)).and_then(|of| elements.get(of));
                if let (Some(&element), Some(&binding)) = (element, bindings.get(id)) {
                    let is_written = !readonly.contains(&block);
                    // Others than who wrote it read what is declared as atomic.
                    if is_written && kernel.get(binding as usize).is_none_or(|b| b.access != Access::Update) {
                        continue;
                    }
                    d.arrays.insert(*id, Array { binding, element, is_written, is_read: false });
                }
            }
            _ => {}
        }
    }
    keep_what_is_read(words, &mut d);
    d.arrays.retain(|_, a| a.is_read);
    let mut order: Vec<(u32, u32)> = d.arrays.iter().map(|(id, a)| (a.texels(), *id)).collect();
    order.sort_unstable();
    order.iter().skip(most as usize).for_each(|(_, id)| _ = d.arrays.remove(id));
    d.places.retain(|_, place| d.arrays.contains_key(&place.variable));
    d
}

/// Finds the places that are read or stored to, and leaves out arrays that are used in any other way.
fn keep_what_is_read(words: &[u32], d: &mut Declared) {
    for (op, operands) in instructions(words) {
        let pointers: &[u32] = match (op, operands) {
            (OP_ACCESS_CHAIN | OP_IN_BOUNDS_ACCESS_CHAIN, [_, id, base, indices @ ..]) => {
                if let Some(place) = place(d, *base, indices) {
                    d.places.insert(*id, place);
                    continue;
                }
                std::slice::from_ref(base)
            }
            (OP_LOAD, [_, _, from, ..]) if d.places.contains_key(from) => {
                let variable = d.places[from].variable;
                d.arrays.entry(variable).and_modify(|a| a.is_read = true);
                continue;
            }
            (OP_STORE, [to, ..]) if d.places.contains_key(to) => continue,
            (OP_NAME | OP_DECORATE | OP_MEMBER_DECORATE | OP_CONSTANT | OP_VARIABLE, _) => continue,
            (OP_STORE, [to, ..]) => std::slice::from_ref(to),
            (OP_COPY_MEMORY, both) => both,
            (OP_FUNCTION_CALL, [_, _, _, arguments @ ..]) => arguments,
            // Others that take a pointer have it behind their result; those without a result take none.
            (_, [_, _, first, ..]) if op > OP_VARIABLE => std::slice::from_ref(first),
            _ => continue,
        };
        for pointer in pointers {
            let variable = d.places.get(pointer).map_or(*pointer, |place| place.variable);
            d.arrays.remove(&variable);
        }
    }
}

/// What an access chain points to.
fn place(d: &Declared, base: u32, indices: &[u32]) -> Option<Place> {
    let of_place = d.places.get(&base).filter(|place| place.component.is_none());
    let place = match (of_place, indices) {
        (Some(place), [component]) => Place { component: Some(*component), ..*place },
        (None, [_, index]) => Place { variable: base, index: *index, component: None },
        (None, [_, index, component]) => Place { variable: base, index: *index, component: Some(*component) },
        _ => return None,
    };
    let array = d.arrays.get(&place.variable)?;
    (array.element.is_vector() || place.component.is_none()).then_some(place)
}

/// Ids of what is added.
struct Added {
    next: u32,
    /// By variable of an array: that of its texels.
    texels: BTreeMap<u32, u32>,
    /// By element: type of the image, of a pointer to it, and of what is read.
    types: BTreeMap<Element, [u32; 3]>,
    out: Vec<u32>,
}

impl Added {
    fn id(&mut self) -> u32 {
        self.next += 1;
        self.next - 1
    }

    fn put(&mut self, op: u32, operands: &[u32]) {
        self.out.push((operands.len() as u32 + 1) << 16 | op);
        self.out.extend_from_slice(operands);
    }
}

fn rewritten(words: &[u32], d: &Declared) -> Vec<u32> {
    let out = words[..HEADER_WORDS].to_vec();
    let mut added = Added { next: words[BOUND], texels: BTreeMap::new(), types: BTreeMap::new(), out };
    for (variable, array) in &d.arrays {
        let texels = if array.is_written { added.id() } else { *variable };
        added.texels.insert(*variable, texels);
    }
    let is_bound_once = |id: &u32| d.arrays.get(id).is_some_and(|a| !a.is_written);
    // Where what is written is stored to, the way there stays.
    let is_gone = |id: &u32| d.places.get(id).is_some_and(|place| is_bound_once(&place.variable));
    let (mut is_capable, mut is_declared) = (false, false);
    for (op, operands) in instructions(words) {
        match (op, operands) {
            (OP_CAPABILITY, _) if !is_capable => {
                is_capable = true;
                added.put(OP_CAPABILITY, &[CAPABILITY_IMAGE_BUFFER]);
                added.put(op, operands);
            }
            (OP_ENTRY_POINT, _) => {
                let second = d.arrays.iter().filter(|(_, a)| a.is_written).map(|(id, _)| added.texels[id]);
                let all: Vec<u32> = operands.iter().copied().chain(second).collect();
                added.put(op, &all);
            }
            (OP_NAME | OP_DECORATE, [id, ..]) if is_gone(id) => {}
            (OP_DECORATE, [id, DECORATION_BINDING, _]) if is_bound_once(id) => {
                added.put(op, operands);
                added.put(OP_DECORATE, &[*id, DECORATION_NON_WRITABLE]);
            }
            (OP_DECORATE, [id, DECORATION_BINDING, _]) if d.arrays.contains_key(id) => {
                added.put(op, operands);
                let texels = added.texels[id];
                added.put(OP_DECORATE, &[texels, DECORATION_BINDING, d.arrays[id].texels()]);
                added.put(OP_DECORATE, &[texels, DECORATION_DESCRIPTOR_SET, 0]);
            }
            (OP_VARIABLE, [_, id, ..]) if is_bound_once(id) => {}
            (OP_ACCESS_CHAIN | OP_IN_BOUNDS_ACCESS_CHAIN, [_, id, ..]) if is_gone(id) => {}
            (OP_LOAD, [ty, id, from, ..]) if d.places.contains_key(from) => read(&mut added, d, [*ty, *id], *from),
            (OP_FUNCTION, _) if !is_declared => {
                is_declared = true;
                declare(&mut added, d);
                added.put(op, operands);
            }
            _ => added.put(op, operands),
        }
    }
    added.out[BOUND] = added.next;
    added.out
}

/// Types and variables, behind all others.
fn declare(added: &mut Added, d: &Declared) {
    let mut vectors = d.vectors.clone();
    for (variable, array) in &d.arrays {
        if !added.types.contains_key(&array.element) {
            let scalar = if array.element.is_float() { d.float } else { d.uint }.unwrap_or_default();
            let vector = *vectors.entry(scalar).or_insert_with(|| {
                let id = added.id();
                added.put(OP_TYPE_VECTOR, &[id, scalar, 4]);
                id
            });
            let [image, pointer] = [added.id(), added.id()];
            let format = array.element.image_format();
            added.put(OP_TYPE_IMAGE, &[image, scalar, DIM_BUFFER, 0, 0, 0, STORAGE, format]);
            added.put(OP_TYPE_POINTER, &[pointer, UNIFORM_CONSTANT, image]);
            added.types.insert(array.element, [image, pointer, vector]);
        }
        let (pointer, texels) = (added.types[&array.element][1], added.texels[variable]);
        added.put(OP_VARIABLE, &[pointer, texels, UNIFORM_CONSTANT]);
    }
}

/// Reads the texel in place of a load of type `ty` into `id`.
fn read(added: &mut Added, d: &Declared, [ty, id]: [u32; 2], from: u32) {
    let place = d.places[&from];
    let element = d.arrays[&place.variable].element;
    let [image_type, _, vector] = added.types[&element];
    let (image, texels) = (added.id(), added.texels[&place.variable]);
    added.put(OP_LOAD, &[image_type, image, texels]);
    if element.is_vector() && place.component.is_none() {
        return added.put(OP_IMAGE_READ, &[vector, id, image, place.index]);
    }
    let texel = added.id();
    added.put(OP_IMAGE_READ, &[vector, texel, image, place.index]);
    match place.component.map(|c| d.constants.get(&c).copied().ok_or(c)) {
        Some(Err(component)) => added.put(OP_VECTOR_EXTRACT_DYNAMIC, &[ty, id, texel, component]),
        Some(Ok(component)) => added.put(OP_COMPOSITE_EXTRACT, &[ty, id, texel, component]),
        None => added.put(OP_COMPOSITE_EXTRACT, &[ty, id, texel, 0]),
    }
}
