//! What is known of a function before it is compiled: where each value is used last, so that its rows can be used again,
//! and which loads of private variables need no copy, because nothing is stored there while the value is in use.

use std::collections::{HashMap, HashSet};

use rspirv::dr::Instruction;
use rspirv::spirv::{Op, StorageClass};

use crate::module::{Function, Id, Module, Type, ids};

/// The last use of a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum LastUse {
    /// Instruction of its own block.
    At(usize),
    /// In another block: its rows stay to the end of the function.
    Elsewhere,
}

#[derive(Debug, Default)]
pub(crate) struct Facts {
    pub(crate) last_use: HashMap<Id, LastUse>,
    /// Loads that need no copy.
    pub(crate) alias: HashSet<Id>,
}

/// Whether the result is only another name for rows of its operands.
fn renames(op: Op) -> bool {
    matches!(
        op,
        Op::CompositeExtract
            | Op::CompositeConstruct
            | Op::CompositeInsert
            | Op::VectorShuffle
            | Op::Bitcast
            | Op::CopyObject
            | Op::AccessChain
            | Op::InBoundsAccessChain
            | Op::Transpose
            | Op::Load
    )
}

impl Facts {
    pub(crate) fn of(module: &Module, function: &Function) -> Self {
        let mut facts = Self::default();
        let mut block_of = HashMap::new();
        for (b, block) in function.blocks.iter().enumerate() {
            for result in block.instructions.iter().filter_map(|i| i.result_id) {
                block_of.insert(result, b);
            }
        }
        for (b, block) in function.blocks.iter().enumerate().rev() {
            for (at, i) in block.instructions.iter().enumerate().rev() {
                let own = i.result_id.and_then(|r| facts.last_use.get(&r).copied());
                for used in ids(i) {
                    let here = block_of.get(&used) == Some(&b) && i.class.opcode != Op::Phi;
                    let mut last = if here { LastUse::At(at) } else { LastUse::Elsewhere };
                    if renames(i.class.opcode) {
                        last = later(last, own);
                    }
                    let before = facts.last_use.get(&used).copied();
                    facts.last_use.insert(used, later(last, before));
                }
            }
        }
        for block in &function.blocks {
            facts.find_aliases(module, &block.instructions);
        }
        facts
    }

    fn find_aliases(&mut self, module: &Module, instructions: &[Instruction]) {
        let mut root_of: HashMap<Id, Id> = HashMap::new();
        for i in instructions {
            if matches!(i.class.opcode, Op::AccessChain | Op::InBoundsAccessChain) {
                let base = ids(i)[0];
                let root = root_of.get(&base).copied().unwrap_or(base);
                root_of.insert(i.result_id.unwrap_or(0), root);
            }
        }
        let root = |id: Id| root_of.get(&id).copied().unwrap_or(id);
        for (at, i) in instructions.iter().enumerate() {
            let Some(result) = i.result_id.filter(|_| i.class.opcode == Op::Load) else { continue };
            let pointer = ids(i)[0];
            let Some(LastUse::At(last)) = self.last_use.get(&result).copied() else { continue };
            let own = root(pointer);
            let stored = instructions[at + 1..=last].iter().any(|j| match j.class.opcode {
                Op::Store => is_private(module, ids(j)[0]) && root(ids(j)[0]) == own,
                Op::FunctionCall => !is_local(module, own) || ids(j)[1..].iter().any(|a| root(*a) == own),
                _ => false,
            });
            if is_private(module, pointer) && !stored {
                self.alias.insert(result);
            }
        }
    }
}

fn later(a: LastUse, b: Option<LastUse>) -> LastUse {
    match (a, b) {
        (LastUse::At(a), Some(LastUse::At(b))) => LastUse::At(a.max(b)),
        (_, Some(LastUse::Elsewhere)) | (LastUse::Elsewhere, _) => LastUse::Elsewhere,
        (a, None) => a,
    }
}

fn class_of(module: &Module, pointer: Id) -> Option<StorageClass> {
    let ty = module.type_of.get(&pointer)?;
    if let Type::Pointer(class, _) = module.ty(*ty) { Some(*class) } else { None }
}

fn is_private(module: &Module, pointer: Id) -> bool {
    matches!(class_of(module, pointer), Some(StorageClass::Function | StorageClass::Private))
}

/// A variable of the function itself: no call touches it unless it is passed. Parameters have no such promise, but GLSL
/// copies in and out.
fn is_local(module: &Module, pointer: Id) -> bool {
    class_of(module, pointer) == Some(StorageClass::Function)
}
