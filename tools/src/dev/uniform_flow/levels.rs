//! The level of every value, variable and branch, as the least that agrees with all instructions that can be reached.

use std::collections::HashMap;

use rspirv::dr::{Instruction, Operand};
use rspirv::spirv::{Op, Word};

use super::assigned::{Assignments, assigned_once};
use super::constants::Reach;
use super::flatten::{End, Program};
use super::fold::Constant;
use super::graph::Dependence;
use super::module::{Global, Module};
use super::operations::{Level, is_impure, is_of_subgroup, of_builtin, of_subgroup_operation};

/// The result of the analysis.
pub(super) struct Levels<'a> {
    module: &'a Module,
    program: &'a Program,
    reach: &'a Reach,
    dependence: Dependence,
    /// Block in which a value is made; values of the module have none.
    made_in: HashMap<Word, usize>,
    values: HashMap<Word, Level>,
    /// Content of variables that every invocation has for itself.
    memory: HashMap<Word, Level>,
    assigned: Assignments,
    /// The variable that a pointer leads to.
    roots: HashMap<Word, Word>,
    /// Of the branch at the end of each block.
    branches: Vec<Level>,
    changed: bool,
}

impl<'a> Levels<'a> {
    pub(super) fn analyse(module: &'a Module, program: &'a Program, reach: &'a Reach) -> Self {
        let mut levels = Self {
            module,
            program,
            reach,
            dependence: Dependence::of(reach),
            made_in: HashMap::new(),
            values: HashMap::new(),
            memory: HashMap::new(),
            assigned: assigned_once(program, reach),
            roots: HashMap::new(),
            branches: vec![Level::Workgroup; program.blocks.len()],
            changed: true,
        };
        let reached: Vec<usize> = (0..program.blocks.len()).filter(|b| reach.reached[*b]).collect();
        for &block in &reached {
            for step in &program.blocks[block].steps {
                levels.introduce(block, &step.instruction);
            }
        }
        while std::mem::take(&mut levels.changed) {
            for &block in &reached {
                for step in &program.blocks[block].steps {
                    levels.step(block, &step.instruction);
                }
                if let (End::Branch(selector, _), 2..) = (&program.blocks[block].end, reach.successors[block].len()) {
                    let level = levels.at(*selector, block);
                    levels.changed |= level > levels.branches[block];
                    levels.branches[block] = level.max(levels.branches[block]);
                }
            }
        }
        levels
    }

    fn introduce(&mut self, block: usize, i: &Instruction) {
        let Some(id) = i.result_id else { return };
        self.made_in.insert(id, block);
        if matches!(i.class.opcode, Op::AccessChain | Op::InBoundsAccessChain | Op::CopyObject)
            && let Some(base) = i.operands.first().and_then(Operand::id_ref_any)
        {
            self.roots.insert(id, self.root(base));
        }
    }

    /// The variable that a pointer leads to.
    pub(super) fn root(&self, pointer: Word) -> Word {
        self.roots.get(&pointer).copied().unwrap_or(pointer)
    }

    /// Among whom the flow that reaches a block is the same.
    pub(super) fn control(&self, block: usize) -> Level {
        self.dependence.branches(block).map(|b| self.branches[b]).max().unwrap_or(Level::Workgroup)
    }

    /// Branches above `limit` that decide whether a block runs.
    pub(super) fn causes(&self, block: usize, limit: Level) -> impl Iterator<Item = usize> + '_ {
        self.dependence.branches(block).filter(move |b| self.branches[*b] > limit)
    }

    /// Level of a branch.
    pub(super) fn branch(&self, block: usize) -> Level {
        self.branches[block]
    }

    /// Level of a value where it is made.
    pub(super) fn value(&self, id: Word) -> Level {
        self.values.get(&id).copied().unwrap_or(Level::Workgroup)
    }

    /// Level of a value where it is used. Behind a loop that lanes leave at different times, or behind a condition, it also
    /// differs as they do.
    fn at(&self, id: Word, block: usize) -> Level {
        let since = self.made_in.get(&id).map_or(Level::Workgroup, |made| self.since(*made, block));
        self.value(id).max(since)
    }

    fn since(&self, from: usize, to: usize) -> Level {
        self.dependence.left_behind(from, to).map(|b| self.branches[b]).max().unwrap_or(Level::Workgroup)
    }

    fn set(&mut self, id: Word, level: Level) {
        let old = self.values.insert(id, level.max(self.value(id)));
        self.changed |= level > old.unwrap_or(Level::Workgroup);
    }

    fn step(&mut self, block: usize, i: &Instruction) {
        let operand = |n: usize| i.operands.get(n).and_then(Operand::id_ref_any);
        let of = |n: usize| operand(n).map_or(Level::Workgroup, |id| self.at(id, block));
        let all = i.operands.iter().filter_map(Operand::id_ref_any).map(|id| self.at(id, block)).max();
        let all = all.unwrap_or(Level::Workgroup);
        let level = match i.class.opcode {
            Op::Variable => Level::Workgroup,
            Op::Load => match operand(0).and_then(|p| self.assigned.get(&p)) {
                Some((stored_in, value)) => self.at(*value, *stored_in).max(self.since(*stored_in, block)),
                None => of(0).max(self.content(operand(0).unwrap_or(0), block)),
            },
            Op::Phi => self.phi(i, block),
            Op::Select if self.is_known(operand(0)) => self.chosen(i, block),
            op if is_of_subgroup(op) => of_subgroup_operation(i, of),
            op if is_impure(op) => Level::Divergent,
            _ => all,
        };
        match (i.class.opcode, i.result_id) {
            (Op::Store, _) => {
                let pointer = operand(0).unwrap_or(0);
                self.store(pointer, all.max(self.choice_to_store(pointer, block)));
            }
            (op, _) if is_impure(op) || op == Op::CopyMemory => self.store(operand(0).unwrap_or(0), Level::Divergent),
            // Some functions of GLSL hand a second result to a variable.
            (Op::ExtInst, _) => {
                let pointers = i.operands.iter().filter_map(Operand::id_ref_any).collect::<Vec<_>>();
                pointers.into_iter().for_each(|p| self.store(p, Level::Divergent));
            }
            _ => {}
        }
        if let Some(result) = i.result_id {
            let level = if self.is_known(Some(result)) { Level::Workgroup } else { level };
            self.set(result, level);
        }
    }

    /// Level of what a pointer leads to, for a load in `block` at an address that is the same for all.
    fn content(&self, pointer: Word, block: usize) -> Level {
        let root = self.root(pointer);
        match self.module.global(root) {
            Some(Global::Builtin(builtin)) => of_builtin(builtin),
            Some(Global::ReadOnly) => Level::Workgroup,
            // Subgroups that come by at different times may find different things.
            Some(Global::Shared) => self.control(block),
            Some(Global::Private) | None => self.memory.get(&root).copied().unwrap_or(Level::Workgroup),
            Some(Global::Other) => Level::Divergent,
        }
    }

    /// Branches that decide whether something is stored, beyond those that decide whether the variable is there at all.
    fn choice_to_store(&self, pointer: Word, block: usize) -> Level {
        match self.made_in.get(&self.root(pointer)) {
            Some(declared) => self.since(block, *declared),
            None => self.control(block),
        }
    }

    /// Only of variables that every invocation has for itself; what is stored elsewhere is judged where it is loaded.
    fn store(&mut self, pointer: Word, level: Level) {
        let root = self.root(pointer);
        let old = self.memory.get(&root).copied().unwrap_or(Level::Workgroup);
        if level > old {
            self.memory.insert(root, level);
            self.changed = true;
        }
    }

    /// A choice is as uniform as what is chosen from, and as the branches that choose.
    fn phi(&self, phi: &Instruction, block: usize) -> Level {
        let mut level = Level::Workgroup;
        for pair in phi.operands.chunks_exact(2) {
            let [value, Operand::LiteralBit32(parent)] = pair else { continue };
            let parent = *parent as usize;
            if self.reach.reached.get(parent).is_some_and(|r| *r) {
                let value = value.id_ref_any().map_or(Level::Workgroup, |id| self.at(id, parent));
                let own = if parent == block { Level::Workgroup } else { self.branches[parent] };
                level = level.max(value).max(own).max(self.since(parent, block));
            }
        }
        level
    }

    fn is_known(&self, id: Option<Word>) -> bool {
        id.is_some_and(|id| matches!(self.reach.value(id), Constant::Known(_)))
    }

    /// Of a selection whose condition is known, what is selected.
    fn chosen(&self, select: &Instruction, block: usize) -> Level {
        let known = select.operands[0].id_ref_any().map(|c| self.reach.value(c));
        let taken = if known == Some(Constant::Known(0)) { 2 } else { 1 };
        select.operands.get(taken).and_then(Operand::id_ref_any).map_or(Level::Workgroup, |id| self.at(id, block))
    }

    /// What a value differs by: the name of the variable or input, or the operation, that brings the difference in.
    pub(super) fn source(&self, selector: Word) -> String {
        let mut id = selector;
        let level = self.value(id);
        for _ in 0..64 {
            match self.module.name(self.program.origin(id)) {
                // What the compiler calls the copy of an argument.
                Some("param") => {}
                Some(name) => return format!("`{name}`"),
                None => {}
            }
            let Some(i) = self.instruction(id) else { break };
            if i.class.opcode != Op::Load && (is_of_subgroup(i.class.opcode) || is_impure(i.class.opcode)) {
                return format!("Op{:?}", i.class.opcode);
            }
            let mut operands = i.operands.iter().filter_map(Operand::id_ref_any);
            let next = match i.class.opcode {
                Op::Variable => self.argument(id),
                Op::Load => operands.next().map(|p| if self.value(p) >= level { p } else { self.root(p) }),
                Op::AccessChain => operands.skip(1).find(|o| self.value(*o) >= level),
                _ => operands.find(|o| self.value(*o) >= level),
            };
            let Some(next) = next else { break };
            id = next;
        }
        "an unnamed value".to_owned()
    }

    /// The least uniform value that is stored in a variable.
    fn argument(&self, variable: Word) -> Option<Word> {
        let steps = self.program.blocks.iter().flat_map(|b| &b.steps).map(|s| &s.instruction);
        let stores = steps.filter(|i| i.class.opcode == Op::Store);
        let values = stores.filter_map(|i| Some((i.operands[0].id_ref_any()?, i.operands.get(1)?.id_ref_any()?)));
        values.filter(|(to, _)| self.root(*to) == variable).map(|(_, value)| value).max_by_key(|v| self.value(*v))
    }

    fn instruction(&self, id: Word) -> Option<&Instruction> {
        let block = self.made_in.get(&id)?;
        let steps = &self.program.blocks[*block].steps;
        steps.iter().map(|s| &s.instruction).find(|i| i.result_id == Some(id))
    }
}
