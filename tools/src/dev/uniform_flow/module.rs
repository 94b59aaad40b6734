//! What the analysis needs to know about a module beside its code.

use std::collections::{HashMap, HashSet};

use rspirv::dr::{self, Instruction, Operand};
use rspirv::spirv::{BuiltIn, Decoration, ExecutionModel, Op, StorageClass, Word};

const HEADER_WORDS: usize = 5;

/// What a variable outside of functions is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Global {
    /// An input that the device fills.
    Builtin(BuiltIn),
    /// Memory that nobody writes: push constants, uniform and read-only buffers.
    ReadOnly,
    /// Shared memory of the workgroup.
    Shared,
    /// Each invocation's own.
    Private,
    /// Memory that others may write meanwhile, images.
    Other,
}

/// A parsed module.
pub(super) struct Module {
    raw: dr::Module,
    names: HashMap<Word, String>,
    globals: HashMap<Word, Global>,
    specialisations: HashSet<Word>,
    /// Index of the entry point among the functions.
    pub(super) entry: usize,
}

impl Module {
    pub(super) fn parse(spirv: &[u8]) -> Result<Self, String> {
        if !is_whole(spirv) {
            return Err(format!("{} bytes that are no SPIR-V or end within an instruction", spirv.len()));
        }
        let raw = dr::load_bytes(spirv).map_err(|e| e.to_string())?;
        let entry_point = raw
            .entry_points
            .iter()
            .find(|e| matches!(e.operands.first(), Some(Operand::ExecutionModel(ExecutionModel::GLCompute))));
        let id = entry_point.and_then(|e| e.operands.get(1)?.id_ref_any()).ok_or("no compute entry point")?;
        let names = raw.debug_names.iter().filter_map(name).collect();
        let mut module = Self { raw, names, globals: HashMap::new(), specialisations: HashSet::new(), entry: 0 };
        module.entry = module.function(id).ok_or("the entry point has no function")?;
        module.collect_globals();
        Ok(module)
    }

    fn collect_globals(&mut self) {
        let mut builtins = HashMap::new();
        let mut read_only = HashSet::new();
        for a in &self.raw.annotations {
            match (a.class.opcode, a.operands.as_slice()) {
                (Op::Decorate, [Operand::IdRef(id), Operand::Decoration(Decoration::BuiltIn), Operand::BuiltIn(b)]) => {
                    builtins.insert(*id, *b);
                }
                (Op::Decorate, [Operand::IdRef(id), Operand::Decoration(Decoration::NonWritable), ..]) => {
                    read_only.insert(*id);
                }
                (Op::Decorate, [Operand::IdRef(id), Operand::Decoration(Decoration::SpecId), ..]) => {
                    self.specialisations.insert(*id);
                }
                // A block declared `readonly` has it on every member; blocks here have no other mixture.
                (Op::MemberDecorate, [Operand::IdRef(id), _, Operand::Decoration(Decoration::NonWritable), ..]) => {
                    read_only.insert(*id);
                }
                _ => {}
            }
        }
        let pointees: HashMap<Word, Word> =
            self.of(Op::TypePointer).filter_map(|i| Some((i.result_id?, pointee(i)?))).collect();
        let mut globals = HashMap::new();
        for variable in self.of(Op::Variable) {
            let (Some(id), Some(pointer)) = (variable.result_id, variable.result_type) else { continue };
            let nobody_writes =
                read_only.contains(&id) || pointees.get(&pointer).is_some_and(|t| read_only.contains(t));
            let global = match (storage_class(variable), builtins.get(&id)) {
                (_, Some(builtin)) => Global::Builtin(*builtin),
                (Some(StorageClass::PushConstant | StorageClass::Uniform | StorageClass::UniformConstant), _) => {
                    Global::ReadOnly
                }
                (Some(StorageClass::StorageBuffer), _) if nobody_writes => Global::ReadOnly,
                (Some(StorageClass::Workgroup), _) => Global::Shared,
                (Some(StorageClass::Private), _) => Global::Private,
                _ => Global::Other,
            };
            globals.insert(id, global);
        }
        self.globals = globals;
    }

    /// Types, constants and variables outside of functions.
    pub(super) fn declarations(&self) -> &[Instruction] {
        &self.raw.types_global_values
    }

    fn of(&self, op: Op) -> impl Iterator<Item = &Instruction> {
        self.raw.types_global_values.iter().filter(move |i| i.class.opcode == op)
    }

    pub(super) fn functions(&self) -> &[dr::Function] {
        &self.raw.functions
    }

    /// Index of the function with this id.
    pub(super) fn function(&self, id: Word) -> Option<usize> {
        self.raw.functions.iter().position(|f| f.def.as_ref().and_then(|d| d.result_id) == Some(id))
    }

    /// Name without GLSL's parameter types.
    pub(super) fn name(&self, id: Word) -> Option<&str> {
        let name = self.names.get(&id)?.split('(').next()?;
        (!name.is_empty()).then_some(name)
    }

    /// What a variable outside of functions is; `None`: it is none.
    pub(super) fn global(&self, id: Word) -> Option<Global> {
        self.globals.get(&id).copied()
    }

    /// The specialisation constant of this name.
    pub(super) fn specialisation(&self, name: &str) -> Option<Word> {
        self.specialisations.iter().copied().find(|id| self.names.get(id).is_some_and(|n| n == name))
    }

    /// Largest id plus 1.
    pub(super) fn bound(&self) -> Word {
        self.raw.header.as_ref().map_or(0, |h| h.bound)
    }
}

/// Whether all instructions are there: the parser expects it.
fn is_whole(spirv: &[u8]) -> bool {
    let mut words = spirv.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).skip(HEADER_WORDS);
    let mut whole = spirv.len().is_multiple_of(4) && spirv.len() >= 4 * HEADER_WORDS;
    while let Some(first) = words.next().filter(|_| whole) {
        let operands = (first >> 16) as usize;
        whole = operands > 0 && words.by_ref().take(operands.saturating_sub(1)).count() + 1 == operands;
    }
    whole
}

fn name(instruction: &Instruction) -> Option<(Word, String)> {
    match (instruction.class.opcode, instruction.operands.as_slice()) {
        (Op::Name, [Operand::IdRef(id), Operand::LiteralString(text)]) => Some((*id, text.clone())),
        _ => None,
    }
}

fn pointee(pointer: &Instruction) -> Option<Word> {
    pointer.operands.get(1)?.id_ref_any()
}

fn storage_class(variable: &Instruction) -> Option<StorageClass> {
    match variable.operands.first() {
        Some(Operand::StorageClass(class)) => Some(*class),
        _ => None,
    }
}
