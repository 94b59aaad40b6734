//! A SPIR-V module with its tables: types, constants (specialised), names, decorations.

use std::collections::HashMap;

use rspirv::dr::{self, Instruction, Operand};
use rspirv::spirv::{BuiltIn, Decoration, ExecutionMode, Op, StorageClass};

use crate::error::{Result, unsupported};

/// Ids of SPIR-V.
pub(crate) type Id = u32;

#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Type {
    Void,
    Bool,
    Int,
    Float,
    Vector(Id, u32),
    Matrix(Id, u32),
    Array(Id, u32),
    Runtime(Id),
    Struct(Vec<Id>),
    Pointer(StorageClass, Id),
    Image(rspirv::spirv::ImageFormat),
    Function,
}

#[derive(Debug)]
pub(crate) struct Variable {
    pub(crate) id: Id,
    pub(crate) ty: Id,
    pub(crate) class: StorageClass,
    pub(crate) initial: Option<Id>,
}

#[derive(Debug)]
pub(crate) struct Function {
    pub(crate) name: String,
    pub(crate) parameters: Vec<Id>,
    /// The first one is the entry.
    pub(crate) blocks: Vec<Block>,
    pub(crate) block_of_label: HashMap<Id, usize>,
}

#[derive(Debug)]
pub(crate) struct Block {
    pub(crate) label: Id,
    pub(crate) instructions: Vec<Instruction>,
}

/// The tables.
#[derive(Debug, Default)]
pub(crate) struct Module {
    pub(crate) bound: u32,
    pub(crate) local_size: u32,
    pub(crate) entry: Id,
    pub(crate) types: HashMap<Id, Type>,
    /// Flattened words of each constant.
    pub(crate) constants: HashMap<Id, Vec<u32>>,
    pub(crate) type_of: HashMap<Id, Id>,
    pub(crate) variables: Vec<Variable>,
    pub(crate) functions: HashMap<Id, Function>,
    pub(crate) built_in: HashMap<Id, BuiltIn>,
    pub(crate) binding: HashMap<Id, u32>,
    names: HashMap<Id, String>,
    member_names: HashMap<(Id, u32), String>,
    member_offset: HashMap<(Id, u32), u32>,
    array_stride: HashMap<Id, u32>,
    read_only: HashMap<Id, ()>,
}

/// Ids that an instruction names, in order.
pub(crate) fn ids(instruction: &Instruction) -> Vec<Id> {
    instruction.operands.iter().filter_map(Operand::id_ref_any).collect()
}

/// Literal words of an instruction, in order.
pub(crate) fn literals(instruction: &Instruction) -> Vec<u32> {
    let literal = |o: &Operand| match o {
        Operand::LiteralBit32(v) | Operand::LiteralExtInstInteger(v) => Some(*v),
        _ => None,
    };
    instruction.operands.iter().filter_map(literal).collect()
}

impl Module {
    /// Reads `words`; `spec[id]` replaces the specialisation constant with that id.
    pub(crate) fn parse(words: &[u32], spec: &[u32]) -> Result<Self> {
        let source = match dr::load_words(words) {
            Ok(module) => module,
            Err(error) => return unsupported(format!("SPIR-V that cannot be parsed: {error:?}")),
        };
        let mut out = Self { bound: source.header.as_ref().map_or(0, |h| h.bound), ..Self::default() };
        for name in &source.debug_names {
            out.read_name(name);
        }
        let mut spec_of = HashMap::new();
        for annotation in &source.annotations {
            out.read_annotation(annotation, spec, &mut spec_of);
        }
        for value in &source.types_global_values {
            out.read_global(value, &spec_of)?;
        }
        let Some(entry) = source.entry_points.first() else { return unsupported("no entry point") };
        out.entry = ids(entry)[0];
        for mode in &source.execution_modes {
            if let Some(Operand::ExecutionMode(ExecutionMode::LocalSize)) = mode.operands.get(1) {
                out.local_size = literals(mode).iter().product();
            }
        }
        for function in source.functions {
            let (id, function) = out.read_function(function)?;
            out.functions.insert(id, function);
        }
        Ok(out)
    }

    fn read_name(&mut self, name: &Instruction) {
        match name.operands.as_slice() {
            [Operand::IdRef(id), Operand::LiteralString(text)] => {
                self.names.insert(*id, text.clone());
            }
            [Operand::IdRef(id), Operand::LiteralBit32(member), Operand::LiteralString(text)] => {
                self.member_names.insert((*id, *member), text.clone());
            }
            _ => {}
        }
    }

    fn read_annotation(&mut self, a: &Instruction, spec: &[u32], spec_of: &mut HashMap<Id, u32>) {
        let number = literals(a).last().copied().unwrap_or(0);
        match a.operands.as_slice() {
            [Operand::IdRef(id), Operand::Decoration(decoration), rest @ ..] => match (decoration, rest) {
                (Decoration::BuiltIn, [Operand::BuiltIn(b)]) => {
                    self.built_in.insert(*id, *b);
                }
                (Decoration::Binding, _) => {
                    self.binding.insert(*id, number);
                }
                (Decoration::ArrayStride, _) => {
                    self.array_stride.insert(*id, number);
                }
                (Decoration::SpecId, _) => {
                    if let Some(value) = spec.get(number as usize) {
                        spec_of.insert(*id, *value);
                    }
                }
                _ => {}
            },
            [Operand::IdRef(id), Operand::LiteralBit32(member), Operand::Decoration(decoration), ..] => {
                match decoration {
                    Decoration::Offset => {
                        self.member_offset.insert((*id, *member), number);
                    }
                    Decoration::NonWritable => {
                        self.read_only.insert(*id, ());
                    }
                    _ => {}
                }
            }
            _ => {}
        }
    }

    fn read_global(&mut self, g: &Instruction, spec_of: &HashMap<Id, u32>) -> Result<()> {
        let Some(id) = g.result_id else { return Ok(()) };
        if let Some(ty) = g.result_type {
            self.type_of.insert(id, ty);
        }
        let (named, numbers) = (ids(g), literals(g));
        let length = |m: &Self| m.constants.get(&named[1]).map_or(0, |c| c[0]);
        let ty = match g.class.opcode {
            Op::TypeVoid => Type::Void,
            Op::TypeBool => Type::Bool,
            Op::TypeInt if numbers[0] == 32 => Type::Int,
            Op::TypeFloat if numbers[0] == 32 => Type::Float,
            Op::TypeInt | Op::TypeFloat => return unsupported(format!("numbers of {} bits", numbers[0])),
            Op::TypeVector => Type::Vector(named[0], numbers[0]),
            Op::TypeMatrix => Type::Matrix(named[0], numbers[0]),
            Op::TypeArray => Type::Array(named[0], length(self)),
            Op::TypeRuntimeArray => Type::Runtime(named[0]),
            Op::TypeStruct => Type::Struct(named),
            Op::TypeFunction => Type::Function,
            Op::TypePointer => match g.operands[0] {
                Operand::StorageClass(class) => Type::Pointer(class, named[0]),
                _ => return unsupported("a pointer without a storage class"),
            },
            Op::TypeImage => {
                let format = g.operands.iter().find_map(|o| match o {
                    Operand::ImageFormat(f) => Some(*f),
                    _ => None,
                });
                Type::Image(format.unwrap_or(rspirv::spirv::ImageFormat::Unknown))
            }
            _ => return self.read_constant(g, id, &named, &numbers, spec_of),
        };
        self.types.insert(id, ty);
        Ok(())
    }

    fn read_constant(
        &mut self,
        g: &Instruction,
        id: Id,
        named: &[Id],
        numbers: &[u32],
        spec_of: &HashMap<Id, u32>,
    ) -> Result<()> {
        let ty = g.result_type.unwrap_or(0);
        let words = match g.class.opcode {
            Op::ConstantTrue => vec![1],
            Op::ConstantFalse => vec![0],
            Op::Constant => vec![numbers[0]],
            Op::SpecConstant => vec![spec_of.get(&id).copied().unwrap_or(numbers[0])],
            Op::SpecConstantTrue => vec![spec_of.get(&id).map_or(1, |v| u32::from(*v != 0))],
            Op::SpecConstantFalse => vec![spec_of.get(&id).map_or(0, |v| u32::from(*v != 0))],
            Op::ConstantComposite | Op::SpecConstantComposite => {
                named.iter().flat_map(|part| self.constants.get(part).cloned().unwrap_or_default()).collect()
            }
            Op::ConstantNull | Op::Undef => vec![0; self.size(ty) as usize],
            Op::Variable => {
                let Some(Type::Pointer(class, to)) = self.types.get(&ty).cloned() else {
                    return unsupported("a variable that is no pointer");
                };
                self.variables.push(Variable { id, ty: to, class, initial: named.first().copied() });
                return Ok(());
            }
            other => return unsupported(format!("Op{other:?} outside functions")),
        };
        self.constants.insert(id, words);
        Ok(())
    }

    fn read_function(&mut self, source: dr::Function) -> Result<(Id, Function)> {
        let Some(id) = source.def.as_ref().and_then(|d| d.result_id) else { return unsupported("a nameless function") };
        let mut function = Function {
            name: self.names.get(&id).map_or_else(|| format!("%{id}"), |n| n.split('(').next().unwrap_or(n).to_owned()),
            parameters: source.parameters.iter().filter_map(|p| p.result_id).collect(),
            blocks: Vec::new(),
            block_of_label: HashMap::new(),
        };
        if let Some(ty) = source.def.as_ref().and_then(|d| d.result_type) {
            self.type_of.insert(id, ty);
        }
        for p in &source.parameters {
            self.type_of.insert(p.result_id.unwrap_or(0), p.result_type.unwrap_or(0));
        }
        for block in source.blocks {
            let label = block.label.as_ref().and_then(|l| l.result_id).unwrap_or(0);
            function.block_of_label.insert(label, function.blocks.len());
            for i in &block.instructions {
                if let (Some(id), Some(ty)) = (i.result_id, i.result_type) {
                    self.type_of.insert(id, ty);
                }
            }
            function.blocks.push(Block { label, instructions: block.instructions });
        }
        Ok((id, function))
    }

    pub(crate) fn ty(&self, id: Id) -> &Type {
        self.types.get(&id).unwrap_or(&Type::Void)
    }

    /// What a pointer type points to.
    pub(crate) fn pointee(&self, pointer: Id) -> Id {
        if let Type::Pointer(_, to) = self.ty(pointer) { *to } else { 0 }
    }

    /// Scalars of a type; 0 for runtime arrays and images.
    pub(crate) fn size(&self, id: Id) -> u32 {
        match self.ty(id) {
            Type::Bool | Type::Int | Type::Float => 1,
            Type::Vector(of, n) | Type::Matrix(of, n) | Type::Array(of, n) => n * self.size(*of),
            Type::Struct(members) => members.iter().map(|m| self.size(*m)).sum(),
            _ => 0,
        }
    }

    /// Type of an element or member.
    pub(crate) fn part(&self, id: Id, index: u32) -> Id {
        match self.ty(id) {
            Type::Vector(of, _) | Type::Matrix(of, _) | Type::Array(of, _) | Type::Runtime(of) => *of,
            Type::Struct(members) => members.get(index as usize).copied().unwrap_or(0),
            _ => 0,
        }
    }

    /// Words from one element to the next; with the declared layout where there is one.
    pub(crate) fn stride(&self, id: Id, laid_out: bool) -> u32 {
        match (laid_out, self.array_stride.get(&id)) {
            (true, Some(bytes)) => bytes / 4,
            _ => self.size(self.part(id, 0)),
        }
    }

    /// Where a member or element begins, in words.
    pub(crate) fn offset(&self, id: Id, index: u32, laid_out: bool) -> u32 {
        if let Type::Struct(members) = self.ty(id) {
            return match (laid_out, self.member_offset.get(&(id, index))) {
                (true, Some(bytes)) => bytes / 4,
                _ => members[..index as usize].iter().map(|m| self.size(*m)).sum(),
            };
        }
        index * self.stride(id, laid_out)
    }

    /// Word offset of each scalar of a type.
    pub(crate) fn scalar_offsets(&self, id: Id, laid_out: bool) -> Vec<u32> {
        let parts = match self.ty(id) {
            Type::Vector(_, n) | Type::Matrix(_, n) | Type::Array(_, n) => *n,
            Type::Struct(members) => members.len() as u32,
            _ => return vec![0],
        };
        let part = |i: u32| {
            let start = self.offset(id, i, laid_out);
            self.scalar_offsets(self.part(id, i), laid_out).into_iter().map(move |o| start + o)
        };
        (0..parts).flat_map(part).collect()
    }

    /// Number of elements that an index must stay below; none for runtime arrays.
    pub(crate) fn elements(&self, id: Id) -> Option<u32> {
        match self.ty(id) {
            Type::Vector(_, n) | Type::Matrix(_, n) | Type::Array(_, n) => Some(*n),
            _ => None,
        }
    }

    /// Name of a variable; of a block: that of its first member.
    pub(crate) fn name(&self, variable: &Variable) -> String {
        let own = self.names.get(&variable.id).filter(|n| !n.is_empty());
        let member = self.member_names.get(&(variable.ty, 0));
        let block = variable.class == StorageClass::StorageBuffer || own.is_none();
        let found = if block { member.or(own) } else { own };
        found.cloned().unwrap_or_else(|| format!("%{}", variable.id))
    }

    /// Whether a block is declared `readonly`.
    pub(crate) fn is_read_only(&self, variable: &Variable) -> bool {
        self.read_only.contains_key(&variable.ty)
    }
}
