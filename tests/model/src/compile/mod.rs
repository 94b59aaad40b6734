//! From SPIR-V to rows and operations. Calls are inlined, so that every pointer is known but for its dynamic index; the
//! structured flow becomes operations on masks.

mod flow;
mod memory;
mod subgroup;
mod values;

use std::collections::HashMap;

use rspirv::dr::Instruction;
use rspirv::spirv::{BuiltIn, Op as SpirvOp, StorageClass};

use crate::error::{Result, unsupported};
use crate::facts::{Facts, LastUse};
use crate::module::{Function, Id, Module, Type, Variable, ids};
use crate::op::{NO_ROW, Op, Row};
use flow::Construct;

/// A storage buffer of the kernel.
#[derive(Debug, Clone)]
pub(crate) struct BufferInfo {
    pub(crate) name: String,
    pub(crate) read_only: bool,
    pub(crate) image: Option<rspirv::spirv::ImageFormat>,
}

/// Where a shared variable lies.
#[derive(Debug, Clone)]
pub(crate) struct SharedInfo {
    pub(crate) name: String,
    pub(crate) first: u32,
}

/// Rows that are the same in every run, and those that a run sets.
#[derive(Debug, Default)]
pub(crate) struct Presets {
    pub(crate) constants: Vec<(Row, u32)>,
    /// Word of the push constants.
    pub(crate) push: Vec<(Row, u32)>,
    /// First row of each built-in variable.
    pub(crate) inputs: Vec<(Row, BuiltIn)>,
    pub(crate) private: Vec<(Row, u32)>,
}

/// A kernel, ready to run.
#[derive(Debug)]
pub(crate) struct Code {
    pub(crate) ops: Vec<Op>,
    /// Function of each operation, as an index of `places`.
    pub(crate) place_of_op: Vec<u16>,
    pub(crate) places: Vec<String>,
    pub(crate) names: Vec<String>,
    pub(crate) rows: u32,
    pub(crate) frames: u16,
    pub(crate) presets: Presets,
    pub(crate) buffers: HashMap<u32, BufferInfo>,
    pub(crate) shared: Vec<SharedInfo>,
    pub(crate) shared_words: u32,
    pub(crate) local_size: u32,
}

/// A private pointer's rows, a place in memory, or an image.
#[derive(Debug, Clone)]
pub(crate) struct Pointer {
    pub(crate) target: Target,
    /// First row, or word offset.
    pub(crate) base: u32,
    /// Dynamic part, or none.
    pub(crate) at: Row,
    pub(crate) ty: Id,
    pub(crate) name: u32,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Target {
    Private,
    Shared,
    Buffer(u8),
    Image(u8),
}

#[derive(Debug, Clone)]
pub(crate) enum Value {
    Rows(Vec<Row>),
    Pointer(Pointer),
}

pub(crate) struct Compiler<'m> {
    module: &'m Module,
    facts: HashMap<Id, Facts>,
    code: Code,
    values: Vec<Option<Value>>,
    /// Loop in which a value was made, and the loops that are open now.
    loop_of: Vec<u32>,
    open_loops: Vec<u32>,
    loops: u32,
    constant_rows: HashMap<u32, Row>,
    top: Row,
    fixed: bool,
    /// Rows below hold constants, inputs and push constants.
    first_private: Row,
    scope: Scope,
    place: u16,
    frame: u16,
    barriers: HashMap<usize, u32>,
}

/// What belongs to the function that is being inlined.
#[derive(Debug, Default)]
pub(crate) struct Scope {
    function: Id,
    result: Vec<Row>,
    call_frame: Option<u16>,
    constructs: Vec<Construct>,
    /// Operations whose `to` is the end of the enclosing construct.
    skips: Vec<Vec<usize>>,
    free: Vec<Row>,
    owned: HashMap<Id, Vec<Row>>,
    /// Rows of phis, which the blocks before write.
    phis: HashMap<Id, Vec<Row>>,
}

impl Code {
    pub(crate) fn compile(module: &Module) -> Result<Self> {
        let code = Self {
            ops: Vec::new(),
            place_of_op: Vec::new(),
            places: Vec::new(),
            names: Vec::new(),
            rows: 0,
            frames: 0,
            presets: Presets::default(),
            buffers: HashMap::new(),
            shared: Vec::new(),
            shared_words: 0,
            local_size: module.local_size,
        };
        let facts = module.functions.iter().map(|(id, f)| (*id, Facts::of(module, f))).collect();
        let mut compiler = Compiler {
            module,
            facts,
            code,
            values: vec![None; module.bound as usize],
            loop_of: vec![0; module.bound as usize],
            open_loops: vec![0],
            loops: 0,
            constant_rows: HashMap::new(),
            top: 0,
            fixed: false,
            first_private: 0,
            scope: Scope::default(),
            place: 0,
            frame: 0,
            barriers: HashMap::new(),
        };
        compiler.globals()?;
        compiler.fixed = true;
        compiler.call(module.entry, &[], &[])?;
        compiler.emit(Op::End);
        Ok(compiler.code)
    }
}

impl<'m> Compiler<'m> {
    pub(crate) fn emit(&mut self, op: Op) -> usize {
        self.code.ops.push(op);
        self.code.place_of_op.push(self.place);
        self.code.ops.len() - 1
    }

    fn here(&self) -> u32 {
        self.code.ops.len() as u32
    }

    fn name(&mut self, name: String) -> u32 {
        self.code.names.push(name);
        self.code.names.len() as u32 - 1
    }

    /// Rows one after another.
    fn rows(&mut self, count: u32) -> Row {
        if count == 1
            && let Some(row) = self.scope.free.pop()
        {
            return row;
        }
        let first = self.top;
        self.top += count;
        self.code.rows = self.code.rows.max(self.top);
        first
    }

    fn constant(&mut self, word: u32) -> Result<Row> {
        if let Some(row) = self.constant_rows.get(&word) {
            return Ok(*row);
        }
        if self.fixed {
            return unsupported(format!("the constant {word} is not known"));
        }
        let row = self.rows(1);
        self.constant_rows.insert(word, row);
        self.code.presets.constants.push((row, word));
        Ok(row)
    }

    /// Constants, inputs, push constants, buffers, shared and private variables.
    fn globals(&mut self) -> Result<()> {
        // Zero, and those that packing needs.
        for word in [0, 8, 16, 24, 255, 1.0_f32.to_bits(), 255.0_f32.to_bits()] {
            self.constant(word)?;
        }
        let mut constants: Vec<_> = self.module.constants.iter().collect();
        constants.sort();
        for (id, words) in constants {
            let rows = words.iter().map(|w| self.constant(*w)).collect::<Result<Vec<_>>>()?;
            self.values[*id as usize] = Some(Value::Rows(rows));
        }
        let is_private = |v: &&Variable| v.class == StorageClass::Private;
        let (private, others): (Vec<_>, Vec<_>) = self.module.variables.iter().partition(is_private);
        for variable in &others {
            self.global(variable)?;
        }
        self.first_private = self.top;
        private.into_iter().try_for_each(|variable| self.global(variable))
    }

    fn global(&mut self, variable: &Variable) -> Result<()> {
        let size = self.module.size(variable.ty);
        let name = self.name(self.module.name(variable));
        let pointer = |target, base| Pointer { target, base, at: NO_ROW, ty: variable.ty, name };
        let made = match variable.class {
            StorageClass::Input => {
                let first = self.rows(size);
                let Some(built_in) = self.module.built_in.get(&variable.id) else {
                    return unsupported("an input that is not built in");
                };
                self.code.presets.inputs.push((first, *built_in));
                pointer(Target::Private, first)
            }
            StorageClass::PushConstant => {
                let offsets = self.module.scalar_offsets(variable.ty, true);
                let first = self.rows(offsets.len() as u32);
                self.code.presets.push.extend((first..).zip(offsets));
                pointer(Target::Private, first)
            }
            StorageClass::Private => {
                let first = self.rows(size);
                self.code.presets.private.push((first, size));
                pointer(Target::Private, first)
            }
            StorageClass::Workgroup => {
                let first = self.code.shared_words;
                self.code.shared_words += size;
                self.code.shared.push(SharedInfo { name: self.module.name(variable), first });
                pointer(Target::Shared, first)
            }
            StorageClass::StorageBuffer | StorageClass::UniformConstant => {
                let binding = self.module.binding.get(&variable.id).copied().unwrap_or(0);
                let image = if let Type::Image(format) = self.module.ty(variable.ty) { Some(*format) } else { None };
                let read_only = self.module.is_read_only(variable);
                let info = BufferInfo { name: self.module.name(variable), read_only, image };
                self.code.buffers.insert(binding, info);
                let binding = binding as u8;
                pointer(if image.is_some() { Target::Image(binding) } else { Target::Buffer(binding) }, 0)
            }
            class => return unsupported(format!("a variable of class {class:?}")),
        };
        self.values[variable.id as usize] = Some(Value::Pointer(made));
        if let Some(initial) = variable.initial {
            return unsupported(format!("an initial value %{initial} of a global variable"));
        }
        Ok(())
    }

    /// Inlines a function. `result`: rows for what it returns.
    fn call(&mut self, id: Id, arguments: &[Id], result: &[Row]) -> Result<()> {
        let module = self.module;
        let Some(function) = module.functions.get(&id) else { return unsupported(format!("no function %{id}")) };
        for (parameter, argument) in function.parameters.iter().zip(arguments) {
            self.values[*parameter as usize] = self.values[*argument as usize].clone();
            self.loop_of[*parameter as usize] = *self.open_loops.last().unwrap_or(&0);
        }
        let scope = Scope { function: id, result: result.to_vec(), ..Scope::default() };
        let outer = std::mem::replace(&mut self.scope, scope);
        let (outer_place, outer_top, outer_frame) = (self.place, self.top, self.frame);
        self.place = self.place_named(&function.name);
        self.variables(function)?;
        self.body(function)?;
        (self.place, self.top, self.frame) = (outer_place, outer_top, outer_frame);
        self.scope = outer;
        Ok(())
    }

    fn place_named(&mut self, name: &str) -> u16 {
        let known = self.code.places.iter().position(|p| p == name);
        known.unwrap_or_else(|| {
            self.code.places.push(name.to_owned());
            self.code.places.len() - 1
        }) as u16
    }

    /// Variables of a function, poisoned at each call.
    fn variables(&mut self, function: &Function) -> Result<()> {
        for i in &function.blocks[0].instructions {
            if i.class.opcode != SpirvOp::Variable {
                continue;
            }
            let id = i.result_id.unwrap_or(0);
            let ty = self.module.pointee(i.result_type.unwrap_or(0));
            let size = self.module.size(ty);
            let base = self.top;
            self.top += size;
            self.code.rows = self.code.rows.max(self.top);
            let pointer = Pointer { target: Target::Private, base, at: NO_ROW, ty, name: 0 };
            match ids(i).first() {
                None => {
                    self.emit(Op::Poison { first: base, count: size });
                }
                Some(initial) => {
                    let rows = self.operand(*initial)?;
                    self.store(&pointer, &rows)?;
                }
            }
            self.values[id as usize] = Some(Value::Pointer(pointer));
            self.loop_of[id as usize] = *self.open_loops.last().unwrap_or(&0);
        }
        Ok(())
    }

    /// Rows of a value.
    fn operand(&self, id: Id) -> Result<Vec<Row>> {
        match &self.values[id as usize] {
            Some(Value::Rows(rows)) if self.open_loops.contains(&self.loop_of[id as usize]) => Ok(rows.clone()),
            Some(Value::Rows(_)) => unsupported(format!("%{id} is used past the loop that makes it")),
            _ => unsupported(format!("%{id} is no value")),
        }
    }

    fn pointer(&self, id: Id) -> Result<Pointer> {
        match &self.values[id as usize] {
            Some(Value::Pointer(pointer)) => Ok(pointer.clone()),
            _ => unsupported(format!("%{id} is no pointer")),
        }
    }

    fn set(&mut self, id: Id, value: Value) {
        self.values[id as usize] = Some(value);
        self.loop_of[id as usize] = *self.open_loops.last().unwrap_or(&0);
    }

    /// New rows for the result of `i`, given back after its last use.
    fn result(&mut self, i: &Instruction) -> Vec<Row> {
        let count = self.module.size(i.result_type.unwrap_or(0));
        let rows: Vec<Row> = if count == 1 {
            vec![self.rows(1)]
        } else {
            let first = self.rows(count);
            (first..first + count).collect()
        };
        let id = i.result_id.unwrap_or(0);
        self.own(id, &rows);
        self.set(id, Value::Rows(rows.clone()));
        rows
    }

    /// The rows are given back after the last use of `id`; those that other blocks use stay.
    fn own(&mut self, id: Id, rows: &[Row]) {
        if self.facts[&self.scope.function].last_use.get(&id) != Some(&LastUse::Elsewhere) {
            self.scope.owned.insert(id, rows.to_vec());
        }
    }

    /// Gives back the rows of after instruction `at` of its block.
    fn release(&mut self, i: &Instruction, at: usize) {
        let last_use = &self.facts[&self.scope.function].last_use;
        let mut done: Vec<Id> = ids(i);
        done.extend(i.result_id.filter(|r| !last_use.contains_key(r)));
        // Names of its rows may end here too: whoever owns them was given the latest use of all names.
        let ended: Vec<Id> = self
            .scope
            .owned
            .keys()
            .copied()
            .filter(|id| last_use.get(id).map_or(done.contains(id), |l| *l == LastUse::At(at)))
            .collect();
        for id in ended {
            if let Some(rows) = self.scope.owned.remove(&id) {
                self.scope.free.extend(rows);
            }
        }
    }
}
