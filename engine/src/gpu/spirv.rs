//! What a SPIR-V module says about itself, and whether that equals the kernel's declaration.
//!
//! Types, member offsets, bindings and specialisation constants come from `naga`; `NonWritable` / `NonReadable` come from
//! the decorations directly, because naga drops them.

use std::collections::{BTreeMap, BTreeSet};

use super::kernel::{Access, Element, Field, Kernel};
use crate::error::{Error, Result};

const OP_NAME: u32 = 5;
const OP_EXECUTION_MODE: u32 = 16;
const LOCAL_SIZE: u32 = 17;
const OP_DECORATE: u32 = 71;
const DECORATION_BUILT_IN: u32 = 11;
const WORKGROUP_SIZE: u32 = 25;
const HEADER_WORDS: usize = 5;
const OP_MEMBER_DECORATE: u32 = 72;
const DECORATION_NON_WRITABLE: u32 = 24;
const DECORATION_NON_READABLE: u32 = 25;

/// A storage buffer or image as the shader declares it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReflectedBinding {
    /// Name of the block, without the suffix `Block`, in snake case as written.
    pub block: String,
    /// Declared `readonly`.
    pub readonly: bool,
    /// Declared `writeonly`.
    pub writeonly: bool,
    /// An image.
    pub image: bool,
    /// Members of the block's struct element, when the block holds one struct: name and byte offset.
    pub members: Vec<(String, u32)>,
}

/// Interface of a compute shader.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Reflection {
    /// Storage buffers and images of set 0 by binding.
    pub bindings: BTreeMap<u32, ReflectedBinding>,
    /// Members of the push-constant block: name and byte offset.
    pub push: Vec<(String, u32)>,
    /// Size of the push-constant block in bytes.
    pub push_bytes: u32,
    /// Specialisation constants: id and name.
    pub spec: BTreeMap<u16, String>,
    /// Workgroup size.
    pub local_size: [u32; 3],
    /// Bytes of shared memory.
    pub shared_bytes: u32,
}

/// SPIR-V words of a committed module.
pub fn words(kernel: &Kernel) -> Result<Vec<u32>> {
    if !kernel.spirv.len().is_multiple_of(4) || kernel.spirv.len() < 20 {
        return Err(mismatch(kernel, format!("{} bytes are no SPIR-V module", kernel.spirv.len())));
    }
    Ok(kernel.spirv.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
}

/// The module with `threads` threads in x. The constant that compilers decorate as the workgroup size would outweigh the
/// execution mode; it loses the decoration.
pub fn with_local_size(words: &[u32], threads: u32) -> Vec<u32> {
    let (header, mut rest) = words.split_at(words.len().min(HEADER_WORDS));
    let mut out = header.to_vec();
    while let [first, ..] = rest {
        let length = ((first >> 16).max(1) as usize).min(rest.len());
        let (instruction, after) = rest.split_at(length);
        rest = after;
        match (first & 0xffff, instruction) {
            (OP_EXECUTION_MODE, [_, entry, LOCAL_SIZE, _, others @ ..]) => {
                out.extend([*first, *entry, LOCAL_SIZE, threads]);
                out.extend(others);
            }
            (OP_DECORATE, [_, _, DECORATION_BUILT_IN, WORKGROUP_SIZE]) => {}
            _ => out.extend(instruction),
        }
    }
    out
}

fn parse(kernel: &Kernel) -> Result<naga::Module> {
    let options = naga::front::spv::Options {
        adjust_coordinate_space: false,
        strict_capabilities: false,
        block_ctx_dump_prefix: None,
    };
    naga::front::spv::parse_u8_slice(kernel.spirv, &options)
        .map_err(|e| mismatch(kernel, format!("naga cannot parse it: {e}")))
}

/// Parses a kernel's SPIR-V with naga and reads its interface.
pub fn reflect(kernel: &Kernel) -> Result<Reflection> {
    let module = parse(kernel)?;
    let entry = module.entry_points.first().ok_or_else(|| mismatch(kernel, "no entry point".into()))?;
    let qualifiers = block_qualifiers(&words(kernel)?);
    let mut out = Reflection { local_size: entry.workgroup_size, ..Reflection::default() };
    for (_, constant) in module.overrides.iter() {
        if let Some(id) = constant.id {
            out.spec.insert(id, constant.name.clone().unwrap_or_default());
        }
    }
    let mut layouter = naga::proc::Layouter::default();
    layouter.update(module.to_ctx()).map_err(|e| mismatch(kernel, format!("naga layout: {e}")))?;
    for (_, global) in module.global_variables.iter() {
        let ty = &module.types[global.ty];
        match (global.space, global.binding) {
            (naga::AddressSpace::Storage { .. }, Some(at)) => {
                let block = ty.name.clone().unwrap_or_default();
                let (readonly, writeonly) = qualifiers.get(&block).copied().unwrap_or((false, false));
                let members = block_members(&module, ty);
                let name = block.strip_suffix("Block").unwrap_or(&block).to_owned();
                let found = ReflectedBinding { block: name, readonly, writeonly, image: false, members };
                out.bindings.insert(at.binding, found);
            }
            (naga::AddressSpace::Handle, Some(at)) => {
                let block = global.name.clone().unwrap_or_default();
                // naga knows it from the image's own type.
                let writeonly = matches!(
                    ty.inner,
                    naga::TypeInner::Image {
                        class: naga::ImageClass::Storage { access: naga::StorageAccess::STORE, .. },
                        ..
                    }
                );
                let found = ReflectedBinding { block, readonly: false, writeonly, image: true, members: Vec::new() };
                out.bindings.insert(at.binding, found);
            }
            (naga::AddressSpace::Immediate, _) => {
                out.push = struct_members(ty);
                if let naga::TypeInner::Struct { span, .. } = ty.inner {
                    out.push_bytes = span;
                }
            }
            (naga::AddressSpace::WorkGroup, _) => out.shared_bytes += layouter[global.ty].size,
            _ => {}
        }
    }
    Ok(out)
}

/// Checks naga's full validation (used by the tests; pipelines only need [`reflect`]).
pub fn validate(kernel: &Kernel) -> Result<()> {
    let module = parse(kernel)?;
    naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::all())
        .subgroup_stages(naga::valid::ShaderStages::all())
        .subgroup_operations(naga::valid::SubgroupOperationSet::all())
        .validate(&module)
        .map(|_| ())
        .map_err(|e| mismatch(kernel, format!("naga rejects it: {:?}", e.into_inner())))
}

/// Whether the SPIR-V's interface equals the declaration: names, order and access of bindings, struct layouts, push
/// constants, specialisation constants, workgroup size.
pub fn check(kernel: &Kernel, found: &Reflection) -> Result<()> {
    let fail = |why: String| Err(mismatch(kernel, why));
    if found.local_size != [kernel.local_size, 1, 1] {
        return fail(format!("workgroup size {:?}, declared {}", found.local_size, kernel.local_size));
    }
    if found.bindings.len() != kernel.bindings.len() {
        return fail(format!(
            "{} storage buffers and images, declared {}",
            found.bindings.len(),
            kernel.bindings.len()
        ));
    }
    for (index, declared) in kernel.bindings.iter().enumerate() {
        let Some(b) = found.bindings.get(&(index as u32)) else {
            return fail(format!("binding {index} (`{}`) is missing", declared.name));
        };
        if snake(&b.block) != declared.name {
            return fail(format!("binding {index} is `{}`, declared `{}`", snake(&b.block), declared.name));
        }
        if b.image != (declared.element == Element::Image) {
            return fail(format!("`{}`: image {}, declared {:?}", declared.name, b.image, declared.element));
        }
        let expected = (declared.access == Access::Read, declared.access == Access::Write);
        if (b.readonly, b.writeonly) != expected {
            let name = declared.name;
            return fail(format!(
                "`{name}`: (readonly, writeonly) = {:?}, declared {:?}",
                (b.readonly, b.writeonly),
                declared.access
            ));
        }
        if !declared.layout.is_empty() && !same_fields(&b.members, declared.layout) {
            return fail(format!("struct `{}`: {:?}, declared {:?}", declared.name, b.members, declared.layout));
        }
    }
    if !same_fields(&found.push, kernel.push) {
        return fail(format!("push constants {:?}, declared {:?}", found.push, kernel.push));
    }
    let declared: BTreeSet<(u16, &str)> = kernel.spec.iter().enumerate().map(|(i, n)| (i as u16, *n)).collect();
    // A constant that the code never uses may be dropped by the compiler; an undeclared one may not exist.
    if let Some((id, name)) = found.spec.iter().find(|(id, name)| !declared.contains(&(**id, name.as_str()))) {
        return fail(format!("specialisation constant {id} `{name}` is not declared"));
    }
    Ok(())
}

fn mismatch(kernel: &Kernel, why: String) -> Error {
    Error::Kernel { kernel: kernel.name.to_owned(), why }
}

fn same_fields(found: &[(String, u32)], declared: &[Field]) -> bool {
    found.len() == declared.len() && found.iter().zip(declared).all(|((n, o), d)| n == d.0 && *o == d.1)
}

/// `CamelCase` → `camel_case`; digits join the word before an underscore is written (`Sh0` → `sh_0`).
pub fn snake(name: &str) -> String {
    let mut out = String::new();
    let mut previous = '_';
    for c in name.chars() {
        let starts = c.is_ascii_uppercase() || (c.is_ascii_digit() && !previous.is_ascii_digit());
        if starts && previous != '_' {
            out.push('_');
        }
        out.push(c.to_ascii_lowercase());
        previous = c;
    }
    out
}

fn struct_members(ty: &naga::Type) -> Vec<(String, u32)> {
    match &ty.inner {
        naga::TypeInner::Struct { members, .. } => {
            members.iter().map(|m| (m.name.clone().unwrap_or_default(), m.offset)).collect()
        }
        _ => Vec::new(),
    }
}

/// Members of the struct that a block wraps (`FrameBlock { Frame frame; }`), else of the block itself.
fn block_members(module: &naga::Module, block: &naga::Type) -> Vec<(String, u32)> {
    if let naga::TypeInner::Struct { members, .. } = &block.inner
        && let [only] = members.as_slice()
        && let naga::TypeInner::Struct { .. } = module.types[only.ty].inner
    {
        return struct_members(&module.types[only.ty]);
    }
    struct_members(block)
}

/// `readonly` / `writeonly` of each named block, from `OpMemberDecorate` on its first member.
fn block_qualifiers(words: &[u32]) -> BTreeMap<String, (bool, bool)> {
    let mut names: BTreeMap<u32, String> = BTreeMap::new();
    let mut flags: BTreeMap<u32, (bool, bool)> = BTreeMap::new();
    for (op, operands) in instructions(words) {
        match (op, operands) {
            (OP_NAME, [id, text @ ..]) => {
                names.insert(*id, literal(text));
            }
            (OP_MEMBER_DECORATE, [id, 0, DECORATION_NON_WRITABLE, ..]) => flags.entry(*id).or_default().0 = true,
            (OP_MEMBER_DECORATE, [id, 0, DECORATION_NON_READABLE, ..]) => flags.entry(*id).or_default().1 = true,
            _ => {}
        }
    }
    flags.into_iter().filter_map(|(id, f)| names.get(&id).map(|n| (n.clone(), f))).collect()
}

/// The instructions of a module: operation and operands; up to where it is cut off.
pub(super) fn instructions(words: &[u32]) -> impl Iterator<Item = (u32, &[u32])> {
    let mut rest = words.get(HEADER_WORDS..).unwrap_or_default();
    std::iter::from_fn(move || {
        let length = (rest.first()? >> 16) as usize;
        let (instruction, after) = rest.split_at_checked(length)?;
        rest = after;
        instruction.split_first().map(|(first, operands)| (first & 0xffff, operands))
    })
}

fn literal(words: &[u32]) -> String {
    let bytes: Vec<u8> = words.iter().flat_map(|w| w.to_le_bytes()).take_while(|b| *b != 0).collect();
    String::from_utf8_lossy(&bytes).into_owned()
}
